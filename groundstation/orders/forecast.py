"""Forecast of an order: the paths of all vehicles, their smallest distance and the time, by a rollout of the pipeline.

A process of its own computes it (:mod:`groundstation.orders.forecast_process`), so that nothing else has to wait. A
vehicle that moves is computed from a standstill where it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from groundstation.orders.grammar import Intent
from onboard.arrays import Array
from onboard.bus.schema import Vec3
from onboard.config.fleet import FleetConfig
from onboard.rollout.closed_loop import Scenario, fleet_model, fly
from onboard.rollout.vehicle_model import TICK_S, Perturbation

SEEDS = (0, 1, 2, 3)
ARRIVED_M = 0.15
TAKEOFF_START_S = 3.0  # OFFBOARD, arming and spinning up come before the climb
_PATH_POINTS = 80
_MANY = 20  # vehicles, above which one flight has to do
_ROOM_S, _MOST_S = 10.0, 90.0


@dataclass(frozen=True, slots=True)
class Leg:
    """Path of one vehicle from its present position to its goal."""

    start_enu_m: Vec3
    goal_enu_m: Vec3
    duration_s: float = 0.0
    is_ordered: bool = True  # by this order, not by an earlier one
    is_parked: bool = False


@dataclass(frozen=True, slots=True)
class Forecast:
    """The worst of several perturbed flights."""

    paths_enu_m: Mapping[str, Sequence[Vec3]] = field(default_factory=dict)  # per vehicle, evenly in time
    closest_m: float = math.inf  # smallest horizontal distance of ``pair``; infinite with fewer than two vehicles
    pair: tuple[str, str] = ("", "")
    closest_s: float = 0.0  # time of the smallest distance
    now_m: float = math.inf  # smallest horizontal distance now
    duration_s: float = 0.0  # until all have arrived; infinite when a vehicle does not
    outside: tuple[str, ...] = ()  # vehicles that leave the fence on the way


def forecast(fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False) -> Forecast:
    """Fly the legs, several times at once with different errors, and keep the flight that came closest."""
    names = tuple(legs)
    if not any(leg.is_ordered for leg in legs.values()):
        return Forecast()
    start = np.array([legs[name].start_enu_m for name in names])
    goal = np.array([legs[name].goal_enu_m for name in names])
    longest_m = float(np.linalg.norm(goal - start, axis=-1).max())
    slowest_m_s = min(fleet.vehicles[name].max_speed_m_s for name in names)
    commanded_s = max(leg.duration_s for leg in legs.values())
    seeds = SEEDS if len(names) <= _MANY else SEEDS[:1]
    count = len(seeds)
    flight = fly(
        Scenario(
            np.repeat(start[None], count, axis=0),
            np.repeat(goal[None, None], count, axis=0),
            np.array([commanded_s]),
            timeout_s=min(_MOST_S, _ROOM_S + max(commanded_s, 4.0 * longest_m / slowest_m_s)),
            is_parked=tuple(leg.is_parked for leg in legs.values()),
            arrival_m=ARRIVED_M,
        ),
        fleet_model(fleet, names),
        seeds,
        Perturbation(start_m=0.0),
        has_trace=True,
    )
    worst = int(flight.min_separation_m.argmin()) if len(names) > 1 else int(flight.arrival_s[:, 0].argmax())
    trace = flight.trace_enu_m[:, worst]
    closest_m, pair, closest_s = _closest(trace, names)
    now_m, _, _ = _closest(start[None], names)
    arrival_s = float(flight.arrival_s.max())
    fence = fleet.fleet.geofence_m
    low, high = np.array([[axis[side] for axis in (fence.x, fence.y, fence.z)] for side in (0, 1)])
    low[2] = -math.inf  # what stands on the floor is not outside
    is_out = ((trace < low) | (trace > high)).any(-1).any(0)
    step = max(1, len(trace) // _PATH_POINTS)
    points = np.concatenate([start[None], trace[::step], trace[-1:]])
    return Forecast(
        paths_enu_m={name: [_vec3(point) for point in points[:, index]] for index, name in enumerate(names)},
        closest_m=closest_m,
        pair=pair,
        closest_s=closest_s,
        now_m=now_m,
        duration_s=arrival_s + (TAKEOFF_START_S if is_takeoff else 0.0),
        outside=tuple(name for name, out in zip(names, is_out, strict=True) if out and not legs[name].is_parked),
    )


def against(expected: Forecast, intent: Intent, fleet: FleetConfig) -> tuple[str, ...]:
    """Return the reasons not to send the order, in sentences; empty when there is none."""
    limit_m = fleet.fleet.safety_distance_m
    reasons = []
    if expected.closest_m < limit_m and expected.closest_m < expected.now_m - 0.02:
        reasons.append(
            f"{' and '.join(expected.pair)} would come within {expected.closest_m:.2f} m, below the safety distance of "
            f"{limit_m:.2f} m. Move them one after the other, or choose another goal."
        )
    if expected.outside:
        reasons.append(f"{', '.join(expected.outside)} would leave the fence on the way. Choose a goal further inside.")
    if not math.isfinite(expected.duration_s):
        reasons.append(
            f"Somebody would not arrive within {ARRIVED_M:g} m in time: the others are in the way. Spread the goals, "
            f"or {intent.verb} fewer vehicles at once."
        )
    return tuple(reasons)


def _closest(trace: Array, names: Sequence[str]) -> tuple[float, tuple[str, str], float]:
    """Return the smallest horizontal distance over a trace (T, N, 3), the pair, and the time [s]."""
    first, second = np.triu_indices(len(names), 1)
    if not len(first) or not len(trace):
        return math.inf, ("", ""), 0.0
    gap_m = np.linalg.norm(trace[:, first, :2] - trace[:, second, :2], axis=-1)
    at, pair = divmod(int(gap_m.argmin()), len(first))
    return float(gap_m[at, pair]), (names[first[pair]], names[second[pair]]), at * TICK_S


def _vec3(point: Array) -> Vec3:
    x, y, z = point.tolist()
    return (x, y, z)
