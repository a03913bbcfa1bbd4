"""Forecast of an order: paths, smallest distance and duration. Pure.

The rollout flies the vehicles' own control code ahead, several times with different errors. A
process of its own computes it (:mod:`groundstation.orders.forecast_process`), so that nothing else
has to wait. A vehicle that moves now is computed as if it started at rest at its present position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from groundstation.orders.intents import Intent
from groundstation.orders.reachable_goals import route_length_m
from onboard.arrays import Array
from onboard.config.fleet import FleetConfig
from onboard.config.flight_space import flight_space_of
from onboard.config.pair_separation import separations_m
from onboard.rollout.closed_loop import Scenario, fleet_model, fly
from onboard.rollout.vehicle_model import Perturbation
from onboard.safety.area_room import is_breached
from onboard.tuples import Xyz
from onboard.types import TICK_S

SEEDS = (0, 1, 2, 3)  # one flight for each, with different errors
_ARRIVED_M = 0.15  # distance from a goal at which a vehicle has arrived
TAKEOFF_START_S = 3.0  # time before the climb: OFFBOARD, arming and spinning up
_PATH_POINTS = 80  # approximate number of drawn points of each path
_MANY_VEHICLES = 20  # largest fleet that is flown ahead more than once
_SPARE_S = 10.0  # time that a flight may take beyond its expected duration
_LONGEST_S = 90.0  # longest flight that is computed
_DETOUR = 4.0  # expected duration over the duration of the longest route at top speed
_CLOSER_M = 0.02  # least decrease of a distance that counts as caused by the order


@dataclass(frozen=True, slots=True)
class Leg:
    """One vehicle's straight way to its goal."""

    start_enu_m: Xyz
    goal_enu_m: Xyz
    duration_s: float = 0.0  # 0 leaves it to the vehicle's limits
    is_by_this_order: bool = True  # whether this order sends it there, and not an earlier one
    is_parked: bool = False  # whether it stands on the ground


@dataclass(frozen=True, slots=True)
class Forecast:
    """The worst of several perturbed flights."""

    # path of each vehicle; its points are at equal intervals of time
    paths_enu_m: Mapping[str, Sequence[Xyz]] = field(default_factory=dict)
    closest_m: float = math.inf  # smallest separation; infinite with fewer than two vehicles
    pair: tuple[str, str] = ("", "")  # vehicles that have this separation
    closest_s: float = 0.0  # time of this separation
    now_m: float = math.inf  # smallest separation at the start
    duration_s: float = 0.0  # time until all have arrived; infinite if a vehicle does not arrive
    outside: tuple[str, ...] = ()  # vehicles that leave the fence on the way
    # vehicles that do not arrive, with the vehicle that is nearest to each at the end
    held_up: Mapping[str, str] = field(default_factory=dict)
    flight_count: int = 0  # number of flights that were computed, each with other errors


def forecast(
    fleet: FleetConfig,
    legs: Mapping[str, Leg],
    *,
    is_takeoff: bool = False,
    seeds: Sequence[int] = SEEDS,
) -> Forecast:
    """Fly the legs several times with different errors, and keep the worst flight.

    Args:
        fleet: the fleet file.
        legs: legs of all vehicles with a known position.
        is_takeoff: whether the time of arming and spinning up is added.
        seeds: seed of each flight; for large fleets only the first one is flown.

    Returns:
        The flight with the smallest distance.
    """
    if not any(leg.is_by_this_order for leg in legs.values()):
        return Forecast()

    names = tuple(legs)
    start_enu_m = np.array([legs[name].start_enu_m for name in names])
    goal_enu_m = np.array([legs[name].goal_enu_m for name in names])
    ordered_s = max(leg.duration_s for leg in legs.values())

    lengths_m = {
        name: route_length_m(fleet, name, leg.start_enu_m, leg.goal_enu_m)
        for name, leg in legs.items()
    }
    slowest_m_s = min(fleet.vehicles[name].max_speed_m_s for name in names)
    expected_s = max(ordered_s, _DETOUR * max(lengths_m.values()) / slowest_m_s)

    if len(names) > _MANY_VEHICLES:
        seeds = seeds[:1]
    # For S flights of N vehicles: starts (S, N, 3), one goal each (S, 1, N, 3), one duration (1,)
    scenario = Scenario(
        np.repeat(start_enu_m[None], len(seeds), axis=0),
        np.repeat(goal_enu_m[None, None], len(seeds), axis=0),
        np.array([ordered_s]),
        timeout_s=min(_LONGEST_S, _SPARE_S + expected_s),
        is_parked=tuple(leg.is_parked for leg in legs.values()),
        arrival_m=_ARRIVED_M,
    )
    flight = fly(scenario, fleet_model(fleet, names), seeds, Perturbation(start_m=0.0))

    # One vehicle has no separation: then the latest arrival is the worst flight.
    if len(names) > 1:
        worst = int(flight.min_separation_m.argmin())
    else:
        worst = int(flight.arrival_s[:, 0].argmax())
    trace_enu_m = flight.positions_enu_m(worst)

    height_share = fleet.fleet.height_share
    closest_m, pair, closest_s = _closest(trace_enu_m, names, height_share)
    now_m, _, _ = _closest(start_enu_m[None], names, height_share)

    arrival_s = flight.arrival_s[:, 0]  # (S,), when the last vehicle has arrived
    duration_s = float(arrival_s.max())
    held_up: dict[str, str] = {}
    if math.isinf(duration_s):
        held_up = _held_up(flight.trace_enu_m[-1, arrival_s.argmax()], goal_enu_m, lengths_m)

    if is_takeoff:
        duration_s += TAKEOFF_START_S

    return Forecast(
        paths_enu_m=_paths(start_enu_m, trace_enu_m, names),
        closest_m=closest_m,
        pair=pair,
        closest_s=closest_s,
        now_m=now_m,
        duration_s=duration_s,
        outside=_outside(fleet, legs, trace_enu_m),
        held_up=held_up,
        flight_count=len(seeds),
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
    reasons = []

    limit_m = fleet.fleet.safety_distance_m
    comes_closer = predicted.closest_m < predicted.now_m - _CLOSER_M
    if predicted.closest_m < limit_m and comes_closer:
        reasons.append(
            f"{' and '.join(predicted.pair)} would come within {predicted.closest_m:.2f} m, below "
            f"the safety distance of {limit_m:.2f} m. Move them one after the other, or choose "
            "another goal."
        )
    if predicted.outside:
        reasons.append(
            f"{', '.join(predicted.outside)} would leave the fence on the way. "
            "Choose a goal further inside."
        )
    if not math.isfinite(predicted.duration_s):
        reasons.append(_who_is_held_up(predicted, intent))
    return tuple(reasons)


def _who_is_held_up(predicted: Forecast, intent: Intent) -> str:
    """Return the sentence about the vehicles that would not arrive."""
    late = ", ".join(predicted.held_up) or "A vehicle"
    blocking = dict.fromkeys(predicted.held_up.values())
    others = ", ".join(blocking) or "the others"

    remedy = f"Send {late} first, or spread the goals."
    unordered = ", ".join(name for name in blocking if name not in intent.names)
    if unordered:
        remedy = f"Move {unordered} away first, or choose another goal."
    elif not predicted.held_up:
        remedy = f"Spread the goals, or {intent.verb} fewer vehicles at once."

    return (
        f"{late} would not arrive within {_ARRIVED_M:g} m in time: {others} would be in the way. "
        f"{remedy}"
    )


def _closest(
    trace_enu_m: Array, names: Sequence[str], height_share: float
) -> tuple[float, tuple[str, str], float]:
    """Return the smallest separation over a trace, its pair, and its time [s].

    The trace (T, N, 3) has the positions [m] of N vehicles at T ticks.
    """
    first, second = np.triu_indices(len(names), 1)
    if not len(first) or not len(trace_enu_m):
        return math.inf, ("", ""), 0.0

    gaps_m = separations_m(trace_enu_m[:, first] - trace_enu_m[:, second], height_share)
    tick, index = np.unravel_index(gaps_m.argmin(), gaps_m.shape)
    pair = (names[first[index]], names[second[index]])
    return float(gaps_m[tick, index]), pair, int(tick) * TICK_S


def _held_up(end_enu_m: Array, goal_enu_m: Array, lengths_m: Mapping[str, float]) -> dict[str, str]:
    """Return the vehicles that have not arrived, with the vehicle nearest to each.

    Two vehicles that block each other push each other off their goals. So of two that are nearest
    to each other, only the one with the longer route is returned.

    Args:
        end_enu_m: last positions [m] of the N vehicles, (N, 3).
        goal_enu_m: their goals [m], (N, 3).
        lengths_m: their names, with the lengths of their routes [m].
    """
    held_up: dict[str, str] = {}
    if len(lengths_m) < 2:
        return held_up

    names = tuple(lengths_m)
    from_goal_m = np.linalg.norm(end_enu_m - goal_enu_m, axis=-1)
    longest_first = sorted(
        range(len(names)), key=lambda index: lengths_m[names[index]], reverse=True
    )
    for index in longest_first:
        if from_goal_m[index] <= _ARRIVED_M:
            continue

        away_m = np.linalg.norm(end_enu_m - end_enu_m[index], axis=-1)
        away_m[index] = math.inf
        name = names[index]
        nearest = names[int(away_m.argmin())]
        if held_up.get(nearest) != name:
            held_up[name] = nearest
    return held_up


def _outside(fleet: FleetConfig, legs: Mapping[str, Leg], trace_enu_m: Array) -> tuple[str, ...]:
    """Return the vehicles that leave the fence on a trace (T, N, 3)."""
    west, east = fleet.fleet.geofence_m.x
    south, north = fleet.fleet.geofence_m.y
    _, ceiling = fleet.fleet.geofence_m.z
    # No lower limit, because vehicles that stand on the floor are inside.
    low = np.array([west, south, -math.inf])
    high = np.array([east, north, ceiling])
    is_outside = np.any((trace_enu_m < low) | (trace_enu_m > high), axis=(0, 2))
    is_outside |= is_breached(flight_space_of(fleet).areas, trace_enu_m).any(axis=0)

    return tuple(
        name
        for name, leaves in zip(legs, is_outside.tolist(), strict=True)
        if leaves and not legs[name].is_parked
    )


def _paths(
    start_enu_m: Array, trace_enu_m: Array, names: Sequence[str]
) -> dict[str, Sequence[Xyz]]:
    """Return the path of each vehicle, as a few points of a trace (T, N, 3)."""
    step = max(1, len(trace_enu_m) // _PATH_POINTS)
    points = np.concatenate([start_enu_m[None], trace_enu_m[::step], trace_enu_m[-1:]])

    paths: dict[str, Sequence[Xyz]] = {}
    for index, name in enumerate(names):
        paths[name] = [_xyz(point) for point in points[:, index]]
    return paths


def _xyz(point: Array) -> Xyz:
    x, y, z = point.tolist()
    return (x, y, z)
