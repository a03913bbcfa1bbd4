"""Forecast of an order: all vehicles' paths, smallest distance and time, by the rollout of the
control code.

Pure. A process of its own computes it (:mod:`groundstation.orders.forecast_process`), so that
nothing else has to wait. A vehicle that moves is computed from a standstill at its present
position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from groundstation.orders.intents import Intent
from onboard.arrays import Array
from onboard.bus.schema import Vec3
from onboard.config.fleet import FleetConfig
from onboard.config.pair_separation import separations_m
from onboard.rollout.closed_loop import Scenario, fleet_model, fly
from onboard.rollout.vehicle_model import Perturbation
from onboard.types import TICK_S

SEEDS = (0, 1, 2, 3)
ARRIVED_M = 0.15
TAKEOFF_START_S = 3.0  # OFFBOARD, arming and spinning up come before the climb
_PATH_POINTS = 80
_MANY = 20  # vehicles, above which one flight has to do
_ROOM_S, _MOST_S = 10.0, 90.0


@dataclass(frozen=True, slots=True)
class Leg:
    """One vehicle's straight way to its goal."""

    start_enu_m: Vec3
    goal_enu_m: Vec3
    duration_s: float = 0.0  # 0 leaves it to the vehicle's limits
    is_ordered: bool = True  # by this order, not by an earlier one
    is_parked: bool = False  # stands on the ground


@dataclass(frozen=True, slots=True)
class Forecast:
    """The worst of several perturbed flights."""

    # per vehicle, evenly in time
    paths_enu_m: Mapping[str, Sequence[Vec3]] = field(default_factory=dict)
    closest_m: float = math.inf  # smallest separation; infinite with fewer than two vehicles
    pair: tuple[str, str] = ("", "")  # that comes so close
    closest_s: float = 0.0  # time of it
    now_m: float = math.inf  # smallest separation now
    duration_s: float = 0.0  # until all have arrived; infinite when one does not
    outside: tuple[str, ...] = ()  # vehicles that leave the fence on the way


def forecast(fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False) -> Forecast:
    """Fly the legs several times with different errors, and keep the flight with the smallest
    distance.

    Args:
        fleet: the fleet file.
        legs: of all vehicles with a known position.
        is_takeoff: add the time that arming and spinning up take.

    Returns:
        The worst of the flights.
    """
    names = tuple(legs)
    if not any(leg.is_ordered for leg in legs.values()):
        return Forecast()
    start = np.array([legs[name].start_enu_m for name in names])
    goal = np.array([legs[name].goal_enu_m for name in names])
    longest_m = float(np.linalg.norm(goal - start, axis=-1).max())
    slowest_m_s = min(fleet.vehicles[name].max_speed_m_s for name in names)
    ordered_s = max(leg.duration_s for leg in legs.values())
    seeds = SEEDS if len(names) <= _MANY else SEEDS[:1]
    count = len(seeds)
    flight = fly(
        Scenario(
            np.repeat(start[None], count, axis=0),
            np.repeat(goal[None, None], count, axis=0),
            np.array([ordered_s]),
            timeout_s=min(_MOST_S, _ROOM_S + max(ordered_s, 4.0 * longest_m / slowest_m_s)),
            is_parked=tuple(leg.is_parked for leg in legs.values()),
            arrival_m=ARRIVED_M,
        ),
        fleet_model(fleet, names),
        seeds,
        Perturbation(start_m=0.0),
    )
    worst = (
        int(flight.min_separation_m.argmin())
        if len(names) > 1
        else int(flight.arrival_s[:, 0].argmax())
    )
    trace = flight.trace_enu_m[:, worst]
    closest_m, pair, closest_s = _closest(trace, names, fleet.fleet.height_share)
    now_m, _, _ = _closest(start[None], names, fleet.fleet.height_share)
    arrival_s = float(flight.arrival_s.max())
    fence = fleet.fleet.geofence_m
    low, high = np.array([[axis[side] for axis in (fence.x, fence.y, fence.z)] for side in (0, 1)])
    low[2] = -math.inf  # what stands on the floor is not outside
    is_out = ((trace < low) | (trace > high)).any(-1).any(0)
    step = max(1, len(trace) // _PATH_POINTS)
    points = np.concatenate([start[None], trace[::step], trace[-1:]])
    return Forecast(
        paths_enu_m={
            name: [_vec3(point) for point in points[:, index]] for index, name in enumerate(names)
        },
        closest_m=closest_m,
        pair=pair,
        closest_s=closest_s,
        now_m=now_m,
        duration_s=arrival_s + (TAKEOFF_START_S if is_takeoff else 0.0),
        outside=tuple(
            name
            for name, out in zip(names, is_out, strict=True)
            if out and not legs[name].is_parked
        ),
    )


def objections(predicted: Forecast, intent: Intent, fleet: FleetConfig) -> tuple[str, ...]:
    """Return reasons not to send an order.

    Args:
        predicted: the order's forecast.
        intent: the order.
        fleet: the fleet file.

    Returns:
        Sentences; none when the forecast gives no reason.
    """
    limit_m = fleet.fleet.safety_distance_m
    reasons = []
    if predicted.closest_m < limit_m and predicted.closest_m < predicted.now_m - 0.02:
        reasons.append(
            f"{' and '.join(predicted.pair)} would come within {predicted.closest_m:.2f} m, below the safety distance "
            f"of {limit_m:.2f} m. Move them one after the other, or choose another goal."
        )
    if predicted.outside:
        reasons.append(
            f"{', '.join(predicted.outside)} would leave the fence on the way. Choose a goal further inside."
        )
    if not math.isfinite(predicted.duration_s):
        reasons.append(
            f"A vehicle would not arrive within {ARRIVED_M:g} m in time: the others block it. Spread the goals, "
            f"or {intent.verb} fewer vehicles at once."
        )
    return tuple(reasons)


def _closest(
    trace: Array, names: Sequence[str], height_share: float
) -> tuple[float, tuple[str, str], float]:
    """Smallest separation over a trace (T, N, 3), its pair, and its time [s]."""
    first, second = np.triu_indices(len(names), 1)
    if not len(first) or not len(trace):
        return math.inf, ("", ""), 0.0
    gap_m = separations_m(trace[:, first] - trace[:, second], height_share)
    step, index = divmod(int(gap_m.argmin()), len(first))
    return float(gap_m[step, index]), (names[first[index]], names[second[index]]), step * TICK_S


def _vec3(point: Array) -> Vec3:
    x, y, z = point.tolist()
    return (x, y, z)
