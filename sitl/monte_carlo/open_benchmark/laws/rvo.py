"""Reciprocal velocity obstacles: the vehicle flies the sampled velocity with the least penalty.

van den Berg, Lin, Manocha: Reciprocal Velocity Obstacles for Real-Time Multi-Agent Navigation,
ICRA 2008. The penalty of a velocity v is w / (time to collision) + |v_preferred - v|. For a vehicle
that also avoids, the time to collision is that of the velocity 2 v - v_A, where v_A is the present
velocity.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2
from sitl.monte_carlo.open_benchmark.laws.around import (
    Body,
    bodies,
    own_velocity,
    preferred_velocity,
    steered,
)

_W_M = 1.0  # w of the penalty
_AT_ONCE_S = 0.05  # time to collision with a body that is already too close
_SPEEDS = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of the top speed
_HEADINGS = 24
_ANGLE_RAD = np.arange(_HEADINGS) * (2.0 * math.pi / _HEADINGS)
_UNITS = np.stack([np.cos(_ANGLE_RAD), np.sin(_ANGLE_RAD)], axis=1)
_SAMPLES = np.concatenate([speed * _UNITS for speed in _SPEEDS])  # (S, 2)


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the thrust towards the sample with the least penalty."""
    around = bodies(inputs)
    preferred = preferred_velocity(inputs, around)
    if not around:
        return None, steered(inputs, preferred)

    samples = np.concatenate([[preferred], inputs.vehicle.max_speed_m_s * _SAMPLES])
    soonest_s = _times_to_collision_s(samples, np.array(own_velocity(inputs)), around)
    penalty = _W_M / np.maximum(soonest_s, 1e-3) + np.hypot(*(samples - preferred).T)
    best = samples[int(penalty.argmin())]
    return None, steered(inputs, Vec2(*best.tolist()))


def _times_to_collision_s(samples: Array, velocity: Array, around: list[Body]) -> Array:
    """Return for each sample (S,) the time until the first collision; infinite for none."""
    e = np.array([body.e_m for body in around])  # (K, 2)
    w = np.array([body.w_m_s for body in around])
    d = np.array([body.d_m for body in around])
    share = np.array([body.share for body in around])

    # relative velocities (S, K, 2) if this vehicle made only its share of the change
    change = samples[:, None] - velocity
    relative = w + change / share[:, None]
    # |e + t relative| = d is the quadratic equation a t^2 + 2 b t + c = 0
    a = np.einsum("skc,skc->sk", relative, relative)
    b = np.einsum("kc,skc->sk", e, relative)
    c = np.einsum("kc,kc->k", e, e) - d**2

    root_2 = b**2 - a * c
    comes_too_near = (b < 0.0) & (root_2 > 0.0)
    time_s = (-b - np.sqrt(np.maximum(root_2, 0.0))) / np.maximum(a, 1e-9)
    # a body that is already too close collides at once if it comes closer still
    is_too_near = c < 0.0
    time_s = np.where(is_too_near, _AT_ONCE_S, time_s)
    collides = comes_too_near | (is_too_near & (b < 0.0))
    return np.asarray(np.where(collides, time_s, np.inf).min(1))
