"""Estimate that each vehicle has of itself: by the agent's own filter on mocap samples, or with
given errors.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from onboard.arrays import Array, IntArray
from onboard.config.fleet import Vehicle
from onboard.estimation import kalman
from onboard.neighbours import mocap_tracker
from onboard.rollout import batch
from onboard.rollout.rows import Rows
from sitl.monte_carlo.noise import Noise
from sitl.monte_carlo.settings import ErrorClass
from sitl.monte_carlo.vehicles import TICK_S, Truth, wandered

_MOCAP_AGE_TICKS = 1


class MocapSensing:
    """Position samples at 50 Hz, one tick old, through the estimator that flies on the drone."""

    def __init__(self, errors: ErrorClass, vehicles: list[Vehicle], truth: Truth) -> None:
        params = [kalman.KalmanParams(drag_1_s=float(vehicle.drag_1_s)) for vehicle in vehicles]
        self._estimator = batch.FleetEstimator(params, truth.position_enu_m)
        self._std_m = errors.position_std_m
        self._samples: deque[Array] = deque(
            [truth.position_enu_m] * (_MOCAP_AGE_TICKS + 1), _MOCAP_AGE_TICKS + 1
        )
        rest = np.zeros_like(truth.position_enu_m)
        self._tracked = truth.position_enu_m, rest, rest

    def update(self, truth: Truth, normals: Array, thrust_frac: Array, hover_frac: Array) -> Rows:
        """Return the estimate of this tick (F, N, ...); attitude and heading are as the autopilot
        and the mocap say.

        Args:
            truth: after the last tick. normals: (F, N, 9) standard normal numbers.
            thrust_frac: (F, N) as it was sent last. hover_frac: (F, N) as the pipelines estimate
                it.
        """
        self._samples.appendleft(truth.position_enu_m + self._std_m * normals[..., 0:3])
        sample, age_s = self._samples[-1], _MOCAP_AGE_TICKS * TICK_S
        self._tracked = mocap_tracker.corrected(*self._tracked, sample, TICK_S)
        attitude = truth.quaternion_wxyz
        return self._estimator.step(
            attitude, thrust_frac, hover_frac, sample, truth.yaw_rad, age_s, TICK_S
        )

    def tracked(self) -> Rows:
        """Return the vehicles (F, N) as others see them by the poses of the mocap, which promise
        nothing.
        """
        position, velocity, acceleration = self._tracked
        rows = batch.NEIGHBOUR.rows(position.shape[:2])
        rows["position_enu_m"] = rows["predicted_position_enu_m"] = position
        rows["velocity_enu_m_s"] = rows["predicted_velocity_enu_m_s"] = rows["intent_enu_m_s"] = (
            velocity
        )
        rows["acceleration_enu_m_s2"] = acceleration
        rows["position_std_m"], rows["velocity_std_m_s"] = (
            mocap_tracker.POSITION_STD_M,
            mocap_tracker.VELOCITY_STD_M_S,
        )
        return rows

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._estimator.keep(flights)
        position, velocity, acceleration = self._tracked
        self._tracked = position[flights], velocity[flights], acceleration[flights]
        self._samples = deque([sample[flights] for sample in self._samples], _MOCAP_AGE_TICKS + 1)


class GivenErrors:
    """Truth plus errors that wander (Ornstein-Uhlenbeck, stationary from the start), such as an
    EKF's.
    """

    def __init__(self, errors: ErrorClass, noise: Noise) -> None:
        self._errors = errors
        self._position = errors.position_std_m * noise.normal[..., 0:3]
        self._velocity = errors.velocity_std_m_s * noise.normal[..., 3:6]

    def update(self, truth: Truth, normals: Array, thrust_frac: Array, hover_frac: Array) -> Rows:
        """Return the estimate of this tick, as :meth:`MocapSensing.update`."""
        e = self._errors
        self._position = wandered(
            self._position, e.position_std_m, e.position_time_s, normals[..., 0:3]
        )
        self._velocity = wandered(
            self._velocity, e.velocity_std_m_s, e.velocity_time_s, normals[..., 3:6]
        )
        states = batch.STATE.rows(truth.yaw_rad.shape)
        states["position_enu_m"] = truth.position_enu_m + self._position
        states["velocity_enu_m_s"] = truth.velocity_enu_m_s + self._velocity
        states["acceleration_enu_m_s2"], states["yaw_rad"] = (
            truth.acceleration_enu_m_s2,
            truth.yaw_rad,
        )
        states["position_std_m"], states["velocity_std_m_s"] = e.position_std_m, e.velocity_std_m_s
        return states

    def tracked(self) -> None:
        """Return nothing: no mocap sees the vehicles."""

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._position, self._velocity = self._position[flights], self._velocity[flights]


Sensing = MocapSensing | GivenErrors


def sensing(errors: ErrorClass, vehicles: list[Vehicle], truth: Truth, noise: Noise) -> Sensing:
    """The sensing of an error class, at rest at the start."""
    if errors.name == "mocap":
        return MocapSensing(errors, vehicles, truth)
    return GivenErrors(errors, noise)
