"""What each vehicle believes of itself: the agent's own estimator on mocap samples, or an estimate with errors."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Protocol

import numpy as np

from onboard.config.fleet import Vehicle
from onboard.estimation import kalman
from onboard.rollout import batch
from onboard.types import GRAVITY_M_S2, Array, IntArray, State
from sitl.monte_carlo.noise import Noise
from sitl.monte_carlo.settings import ErrorClass
from sitl.monte_carlo.vehicles import TICK_S, Truth

_MOCAP_AGE_TICKS = 1


class Sensing(Protocol):
    """Truth in, own estimate out, both (F, N, ...)."""

    def update(self, truth: Truth, normals: Array, thrust_frac: Array, hover_frac: Array) -> State:
        """The estimate of this tick; thrust_frac (F, N) was sent last, hover_frac is the pipeline's own estimate."""

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""


def sensing(errors: ErrorClass, vehicles: list[Vehicle], truth: Truth, noise: Noise) -> Sensing:
    """The sensing of an error class, at rest at the start."""
    if errors.name == "mocap":
        return MocapSensing(errors, vehicles, truth)
    return GivenErrors(errors, noise)


class MocapSensing:
    """Position samples at 50 Hz, one tick old, through the estimator that flies on the drone."""

    def __init__(self, errors: ErrorClass, vehicles: list[Vehicle], truth: Truth) -> None:
        flights = truth.position_enu_m.shape[0]
        self._params = kalman.EstimateParams(
            drag_1_s=np.repeat(np.array([[vehicle.drag_1_s for vehicle in vehicles]]), flights, axis=0)
        )
        self._std_m = errors.position_std_m
        hovering = np.full(truth.position_enu_m.shape[:-1], GRAVITY_M_S2)
        self._memory = replace(kalman.initial(truth.position_enu_m, params=self._params), thrust_m_s2=hovering)
        self._samples: deque[Array] = deque([truth.position_enu_m] * (_MOCAP_AGE_TICKS + 1), _MOCAP_AGE_TICKS + 1)

    def update(self, truth: Truth, normals: Array, thrust_frac: Array, hover_frac: Array) -> State:
        """See :class:`Sensing`; attitude and heading come as the autopilot and the mocap have them."""
        self._samples.appendleft(truth.position_enu_m + self._std_m * normals[..., 0:3])
        self._memory = kalman.drive(
            self._memory, truth.quaternion_wxyz, thrust_frac, hover_frac, params=self._params, dt_s=TICK_S
        )
        self._memory = kalman.correct(self._memory, self._samples[-1], _MOCAP_AGE_TICKS * TICK_S, params=self._params)
        return kalman.state(self._memory, truth.yaw_rad)

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._params = replace(self._params, drag_1_s=np.asarray(self._params.drag_1_s)[flights])
        self._memory = batch.keep_flights(self._memory, flights)
        self._samples = deque([sample[flights] for sample in self._samples], _MOCAP_AGE_TICKS + 1)


class GivenErrors:
    """Truth plus errors that wander (Ornstein-Uhlenbeck, stationary from the start), such as an EKF's."""

    def __init__(self, errors: ErrorClass, noise: Noise) -> None:
        self._errors = errors
        self._position = errors.position_std_m * noise.normal[..., 0:3]
        self._velocity = errors.velocity_std_m_s * noise.normal[..., 3:6]

    def update(self, truth: Truth, normals: Array, thrust_frac: Array, hover_frac: Array) -> State:
        """See :class:`Sensing`."""
        e = self._errors
        self._position = _wander(self._position, e.position_std_m, e.position_time_s, normals[..., 0:3])
        self._velocity = _wander(self._velocity, e.velocity_std_m_s, e.velocity_time_s, normals[..., 3:6])
        shape = truth.position_enu_m.shape[:-1]
        return State(
            truth.position_enu_m + self._position,
            truth.velocity_enu_m_s + self._velocity,
            truth.acceleration_enu_m_s2,
            truth.yaw_rad,
            np.zeros(shape),
            np.full(shape, e.position_std_m),
            np.full(shape, e.velocity_std_m_s),
        )

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._position, self._velocity = self._position[flights], self._velocity[flights]


def _wander(error: Array, std: float, time_s: float, normals: Array) -> Array:
    if time_s <= 0.0:
        return std * normals
    keep = math.exp(-TICK_S / time_s)
    return keep * error + std * math.sqrt(1.0 - keep * keep) * normals
