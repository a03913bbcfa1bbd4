"""What an order would lead to: everybody's paths, smallest distance and time, by the pipeline's own rollout.

Pure but for the batch's compiled kernels; a process of its own computes it
(:mod:`groundstation.orders.forecast_process`), so that
nothing else has to wait. Whoever moves is computed from a standstill where it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from groundstation.orders.grammar import Intent
from onboard.bus.schema import Vec3
from onboard.config.fleet import FleetConfig
from onboard.rollout.closed_loop import Scenario, fleet_models, fly
from onboard.rollout.vehicle_model import TICK_S, Perturbation
from onboard.types import Array

SEEDS = (0, 1, 2, 3)
ARRIVED_M = 0.15
TAKEOFF_START_S = 3.0  # OFFBOARD, arming and spinning up come before the climb
_PATH_POINTS = 80
_MANY = 20  # vehicles, above which one flight has to do
_ROOM_S, _MOST_S = 10.0, 90.0


@dataclass(frozen=True, slots=True)
class Leg:
    """One vehicle's way: from where it is to its goal, metres ENU. is_ordered: by this order, not by an earlier one."""

    start_enu_m: Vec3
    goal_enu_m: Vec3
    duration_s: float = 0.0
    is_ordered: bool = True
    is_parked: bool = False


@dataclass(frozen=True, slots=True)
class Forecast:
    """The worst of several perturbed flights.

    paths_enu_m: per vehicle, evenly in time. closest_m: smallest horizontal distance of ``pair``, at ``closest_s``;
    infinite with fewer than two vehicles. now_m: the smallest one now. duration_s: until everybody has arrived,
    infinite when somebody does not. outside: who leaves the fence on the way.
    """

    paths_enu_m: Mapping[str, Sequence[Vec3]] = field(default_factory=dict)
    closest_m: float = math.inf
    pair: tuple[str, str] = ("", "")
    closest_s: float = 0.0
    now_m: float = math.inf
    duration_s: float = 0.0
    outside: tuple[str, ...] = ()


def forecast(fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False) -> Forecast:
    """Fly the legs, several times at once with different errors, and keep the flight that came closest."""
    names = tuple(legs)
    if not any(leg.is_ordered for leg in legs.values()):
        return Forecast()
    start = np.array([legs[name].start_enu_m for name in names])
    goal = np.array([legs[name].goal_enu_m for name in names])
    longest_m = float(np.linalg.norm(goal - start, axis=-1).max())
    slowest_m_s = min(fleet.vehicles[name].max_speed_m_s for name in names)
    asked_s = max(leg.duration_s for leg in legs.values())
    params, plants = fleet_models(fleet, names)
    seeds = SEEDS if len(names) <= _MANY else SEEDS[:1]
    count = len(seeds)
    flight = fly(
        Scenario(
            np.repeat(start[None], count, axis=0),
            np.repeat(goal[None, None], count, axis=0),
            np.array([asked_s]),
            timeout_s=min(_MOST_S, _ROOM_S + max(asked_s, 4.0 * longest_m / slowest_m_s)),
            is_parked=tuple(leg.is_parked for leg in legs.values()),
        ),
        params,
        plants,
        seeds,
        perturbation=Perturbation(start_m=0.0),
        safety_distance_m=fleet.fleet.safety_distance_m,
        arrival_m=ARRIVED_M,
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
        paths_enu_m={name: [_vec3(point) for point in points[:, place]] for place, name in enumerate(names)},
        closest_m=closest_m,
        pair=pair,
        closest_s=closest_s,
        now_m=now_m,
        duration_s=arrival_s + (TAKEOFF_START_S if is_takeoff else 0.0),
        outside=tuple(name for name, out in zip(names, is_out, strict=True) if out and not legs[name].is_parked),
    )


def against(found: Forecast, intent: Intent, fleet: FleetConfig) -> tuple[str, ...]:
    """Why the order should not be sent, in sentences; empty when nothing speaks against it."""
    limit_m = fleet.fleet.safety_distance_m
    reasons = []
    if found.closest_m < limit_m and found.closest_m < found.now_m - 0.02:
        reasons.append(
            f"{' and '.join(found.pair)} would come within {found.closest_m:.2f} m, below the safety distance of "
            f"{limit_m:.2f} m. Move them one after the other, or choose another goal."
        )
    if found.outside:
        reasons.append(f"{', '.join(found.outside)} would leave the fence on the way. Choose a goal further inside.")
    if not math.isfinite(found.duration_s):
        reasons.append(
            f"Somebody would not arrive within {ARRIVED_M:g} m in time: the others are in the way. Spread the goals, "
            f"or {intent.verb} fewer vehicles at once."
        )
    return tuple(reasons)


def _closest(trace: Array, names: Sequence[str]) -> tuple[float, tuple[str, str], float]:
    """Smallest horizontal distance over a trace (T, N, 3), of whom, and when [s]."""
    first, second = np.triu_indices(len(names), 1)
    if not len(first) or not len(trace):
        return math.inf, ("", ""), 0.0
    gap_m = np.linalg.norm(trace[:, first, :2] - trace[:, second, :2], axis=-1)
    at, place = divmod(int(gap_m.argmin()), len(first))
    return float(gap_m[at, place]), (names[first[place]], names[second[place]]), at * TICK_S


def _vec3(point: Array) -> Vec3:
    x, y, z = point.tolist()
    return (x, y, z)
