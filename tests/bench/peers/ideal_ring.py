"""The paper's experiment as its Proposition 1 has it: point masses that obey at once, and exact
measurements.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.avoidance.oist_paper import PlanarState, saturate_thrust
from onboard.avoidance.params import PaperParams
from onboard.config.fleet import FleetConfig
from onboard.constants import GRAVITY_M_S2
from onboard.control import backstepping, trajectory
from onboard.types import Goal
from onboard.vectors import Vec2, Vec3
from tests.bench.peers.encounter import Array, length

RING = np.array([1, 2, 0])  # the one that each avoids
PRINTED = PaperParams(
    kappa_1_1_s=2.0,
    kappa_2_1_s=2.0,
    kappa_3_1_s=1.5,
    kappa_4_1_s=1.5,
    v_perp_m_s=0.1,
    d_inf_m=0.8,
    turn_sign=1.0,
)
CENTRE_ENU_M = np.array([0.0, 1.2, 1.0])
LEG_S = 7.0


def starts_and_slots(fleet: FleetConfig) -> tuple[Array, Array]:
    """Take-off spots at flying height and the triangle's slots (3, 3)."""
    starts = np.array([vehicle.start_enu_m for vehicle in fleet.vehicles.values()])
    slots = np.array([fleet.formations["triangle"][name] for name in fleet.vehicles])
    return starts + CENTRE_ENU_M * [0.0, 0.0, 1.0], slots + CENTRE_ENU_M


def planar(position: Array, velocity: Array, acceleration: Array) -> PlanarState:
    """Horizontal motion of one vehicle, from vectors (3,)."""
    return PlanarState(
        *(Vec2(*vector[:2].tolist()) for vector in (position, velocity, acceleration))
    )


def fly(
    fleet: FleetConfig, order: Sequence[int], *, tick_s: float = 0.01, seconds: float = 14.0
) -> tuple[Array, Array, Array]:
    """Into the triangle, vehicle i to slot ``order[i]``: time (T,), positions (T, 3, 3), ring
    distances (T, 3).

    The ring's accelerations depend on each other; they are iterated to their common solution.
    """
    position, slots = starts_and_slots(fleet)
    velocity = np.zeros_like(position)
    acceleration = np.zeros_like(position)
    memories = [trajectory.initial(Vec3(*spot)) for spot in position.tolist()]
    limits = trajectory.TrajectoryParams(1.0, 1.5)
    gains = backstepping.BacksteppingParams()
    goals = [Goal(Vec3(*slot), LEG_S, 0) for slot in slots[list(order)].tolist()]
    track = []
    for _ in range(round(seconds / tick_s)):
        wanted = np.empty_like(position)
        for k in range(3):
            memories[k], setpoint = trajectory.step(memories[k], goals[k], limits, tick_s, 1.0)
            thrust = backstepping.step(
                Vec3(*position[k].tolist()), Vec3(*velocity[k].tolist()), setpoint, gains
            )
            wanted[k] = thrust.thrust_enu_m_s2
        wanted -= [0.0, 0.0, GRAVITY_M_S2]
        for _ in range(50):
            before = acceleration
            acceleration = wanted.copy()
            states = [planar(*motion) for motion in zip(position, velocity, before, strict=True)]
            for k in range(3):
                answer = saturate_thrust(
                    states[k], Vec2(*wanted[k, :2].tolist()), states[RING[k]], PRINTED
                )
                acceleration[k, :2] = answer.thrust_m_s2
            if np.abs(acceleration - before).max() < 1e-10:
                break
        track.append(position)
        position = position + tick_s * velocity + 0.5 * tick_s**2 * acceleration
        velocity = velocity + tick_s * acceleration
    positions = np.array(track)
    gaps = length((positions - positions[:, RING])[..., :2])
    t_s: Array = tick_s * np.arange(len(positions), dtype=np.float64)
    return t_s, positions, gaps
