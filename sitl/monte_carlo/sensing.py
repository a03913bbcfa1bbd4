"""The estimate that each vehicle has of its own state.

It comes from the agent's own filter and simulated mocap poses, or it is the truth plus given
errors. Arrays hold F flights of N vehicles.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from onboard.arrays import Array, IntArray
from onboard.config.fleet import Vehicle
from onboard.config.wind_limit import largest_push_m_s2
from onboard.estimation import kalman
from onboard.neighbours import mocap_tracker
from onboard.rollout import batch, layouts
from onboard.rollout.rows import Rows
from sitl.monte_carlo.campaign_settings import ErrorClass
from sitl.monte_carlo.noise import FlightNoise
from sitl.monte_carlo.vehicles import TICK_S, TrueMotions
from sitl.physics.wind import wandered

_MOCAP_AGE_TICKS = 1


class MocapSensing:
    """Mocap positions at 50 Hz, one tick old, which feed the estimator that flies on the drone."""

    def __init__(self, errors: ErrorClass, vehicles: list[Vehicle], truth: TrueMotions) -> None:
        params = [
            kalman.KalmanParams(
                drag_1_s=float(vehicle.drag_1_s),
                gust_time_s=kalman.gust_time_s(vehicle.lag_s),
                max_bias_m_s2=kalman.largest_bias_m_s2(largest_push_m_s2(vehicle)),
            )
            for vehicle in vehicles
        ]
        position = truth.position_enu_m
        self._estimator = batch.FleetEstimator(params, position)
        self._std_m = errors.position_std_m

        length = _MOCAP_AGE_TICKS + 1
        self._samples: deque[Array] = deque([position] * length, length)  # the newest first

        # Position, velocity and acceleration, (F, N, 3) each. The mocap has tracked everything
        # before the flight begins, also an intruder that is already flying.
        self._tracked = (position, truth.velocity_enu_m_s, np.zeros_like(position))

    def update(
        self, truth: TrueMotions, normals: Array, thrust_frac: Array, hover_frac: Array
    ) -> Rows:
        """Return the estimate of this tick (F, N, ...).

        Attitude and heading have no errors here.

        Args:
            truth: true motion after the last tick.
            normals: standard normal numbers (F, N, 9).
            thrust_frac: thrust (F, N) that was sent last.
            hover_frac: hover thrust (F, N) that the pipelines estimate.
        """
        self._samples.appendleft(truth.position_enu_m + self._std_m * normals[..., 0:3])
        sample = self._samples[-1]
        self._tracked = mocap_tracker.corrected(*self._tracked, sample, TICK_S)

        return self._estimator.step(
            truth.quaternion_wxyz,
            thrust_frac,
            hover_frac,
            sample,
            truth.yaw_rad,
            _MOCAP_AGE_TICKS * TICK_S,
            TICK_S,
        )

    def tracked(self) -> Rows:
        """Return the vehicles (F, N) as others see them from mocap poses.

        Poses contain no prediction and no intent, so the measured motion takes their place.
        """
        position, velocity, acceleration = self._tracked
        rows = layouts.NEIGHBOUR.rows(position.shape[:2])
        rows["position_enu_m"] = position
        rows["predicted_position_enu_m"] = position
        rows["velocity_enu_m_s"] = velocity
        rows["predicted_velocity_enu_m_s"] = velocity
        rows["intent_enu_m_s"] = velocity
        rows["acceleration_enu_m_s2"] = acceleration
        rows["position_std_m"] = mocap_tracker.POSITION_STD_M
        rows["velocity_std_m_s"] = mocap_tracker.VELOCITY_STD_M_S
        return rows

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._estimator.keep(flights)
        position, velocity, acceleration = self._tracked
        self._tracked = (position[flights], velocity[flights], acceleration[flights])
        self._samples = deque([sample[flights] for sample in self._samples], _MOCAP_AGE_TICKS + 1)


class GivenErrors:
    """Truth plus errors that change slowly, such as those of an EKF.

    The errors of position and velocity are Ornstein-Uhlenbeck processes, stationary from the start.
    That of the acceleration is constant, as a bias of the accelerometer or the attitude causes it.
    """

    def __init__(self, errors: ErrorClass, noise: FlightNoise) -> None:
        self._errors = errors
        self._position = errors.position_std_m * noise.normal[..., 0:3]  # error (F, N, 3)
        self._velocity = errors.velocity_std_m_s * noise.normal[..., 3:6]  # error (F, N, 3)
        # constant error (F, N, 3)
        self._acceleration = errors.acceleration_std_m_s2 * noise.acceleration

    def update(
        self, truth: TrueMotions, normals: Array, thrust_frac: Array, hover_frac: Array
    ) -> Rows:
        """Return the estimate of this tick, as :meth:`MocapSensing.update`."""
        errors = self._errors
        self._position = wandered(
            self._position,
            errors.position_std_m,
            errors.position_time_s,
            TICK_S,
            normals[..., 0:3],
        )
        self._velocity = wandered(
            self._velocity,
            errors.velocity_std_m_s,
            errors.velocity_time_s,
            TICK_S,
            normals[..., 3:6],
        )

        states = layouts.STATE.rows(truth.yaw_rad.shape)
        states["position_enu_m"] = truth.position_enu_m + self._position
        states["velocity_enu_m_s"] = truth.velocity_enu_m_s + self._velocity
        states["acceleration_enu_m_s2"] = truth.acceleration_enu_m_s2 + self._acceleration
        states["yaw_rad"] = truth.yaw_rad
        states["position_std_m"] = errors.position_std_m
        states["velocity_std_m_s"] = errors.velocity_std_m_s
        return states

    def tracked(self) -> None:
        """Return None: no mocap sees the vehicles."""

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._position = self._position[flights]
        self._velocity = self._velocity[flights]
        self._acceleration = self._acceleration[flights]


Sensing = MocapSensing | GivenErrors


def sensing(
    errors: ErrorClass, vehicles: list[Vehicle], truth: TrueMotions, noise: FlightNoise
) -> Sensing:
    """Return the sensing of an error class, for vehicles at rest at their starts."""
    if errors.name == "mocap":
        return MocapSensing(errors, vehicles, truth)
    return GivenErrors(errors, noise)
