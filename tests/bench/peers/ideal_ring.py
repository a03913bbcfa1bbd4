"""The paper's experiment as its Proposition 1 has it: point masses that obey at once, and exact measurements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.avoidance.oist_paper import PaperLawParams, saturate_thrust
from onboard.config.fleet import FleetConfig
from onboard.control import backstepping, trajectory
from onboard.types import GRAVITY_M_S2, Goal
from tests.bench.peers.encounter import Array, length

RING = np.array([1, 2, 0])  # the one whom each avoids
CENTRE_ENU_M, LEG_S = np.array([0.0, 1.2, 1.0]), 7.0


def starts_and_slots(fleet: FleetConfig) -> tuple[Array, Array]:
    """Take-off spots at flying height and the triangle's slots (3, 3)."""
    starts = np.array([vehicle.start_enu_m for vehicle in fleet.vehicles.values()])
    slots = np.array([fleet.formations["triangle"][name] for name in fleet.vehicles])
    return starts + CENTRE_ENU_M * [0.0, 0.0, 1.0], slots + CENTRE_ENU_M


def fly(
    fleet: FleetConfig, order: Sequence[int], *, tick_s: float = 0.01, seconds: float = 14.0
) -> tuple[Array, Array, Array]:
    """Into the triangle, vehicle i to slot ``order[i]``: time (T,), positions (T, 3, 3), ring distances (T, 3).

    The ring's accelerations depend on each other; they are iterated to their common solution.
    """
    position, slots = starts_and_slots(fleet)
    velocity, acceleration = np.zeros_like(position), np.zeros_like(position)
    memory = trajectory.initial(position)
    limits = trajectory.GuidanceParams(1.0, 1.5, 0.0)
    goal = Goal(slots[list(order)], np.full(3, LEG_S), np.zeros(3, np.int64))
    track = []
    for _ in range(round(seconds / tick_s)):
        memory, setpoint = trajectory.step(memory, goal, params=limits, dt_s=tick_s, clock_rate=np.ones(3))
        thrust = backstepping.step(position, velocity, setpoint, params=backstepping.BacksteppingParams())
        wanted = thrust.thrust_enu_m_s2 - [0.0, 0.0, GRAVITY_M_S2]
        for _ in range(50):
            before, acceleration = acceleration, wanted.copy()
            own = (position[:, :2], velocity[:, :2], wanted[:, :2])
            obstacle = (position[RING, :2], velocity[RING, :2], before[RING, :2])
            acceleration[:, :2] = saturate_thrust(*own, *obstacle, params=PaperLawParams()).thrust_xy_m_s2
            if np.abs(acceleration - before).max() < 1e-10:
                break
        track.append(position)
        position = position + tick_s * velocity + 0.5 * tick_s**2 * acceleration
        velocity = velocity + tick_s * acceleration
    positions = np.array(track)
    gaps = length((positions - positions[:, RING])[..., :2])
    t_s: Array = tick_s * np.arange(len(positions), dtype=np.float64)
    return t_s, positions, gaps
