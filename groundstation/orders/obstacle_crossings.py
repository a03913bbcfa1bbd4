"""Findings about paths that lead through obstacles. Pure.

On a path no router leads the vehicle: only the law keeps it away from obstacles, and the law finds
no route. The vehicle slides along the outline of a thin obstacle while its path passes on the other
side, and stays behind at a wide one. So the detour decides: where the route around the obstacle is
much longer than the path, the vehicle does not keep up.

Where a path comes out of an obstacle near the point at which it went in, the time inside decides,
too. The vehicle waits outside, farther behind than it may be, and leaves its path when its time to
catch up is used up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from groundstation.orders.reachable_goals import reach_refusal, route_length_m
from groundstation.paths.checks import obstacle_clearances_m, path_findings, refusals, sample
from onboard.arrays import Array
from onboard.config.fleet import FleetConfig
from onboard.control.path import Path
from onboard.feasibility.finding import Finding, at_most, worst
from onboard.flight.path_flight import BEHIND_M, CATCH_UP_LIMIT_S, CAUGHT_UP_M, SLOWEST_RATE
from onboard.plain_text import capitalised
from onboard.tuples import Xyz

# Largest difference between the route around an obstacle and the path. In lockstep flights at
# 0.25 m/s a vehicle keeps up around a pillar with a radius of 0.3 m (1.0 m longer) and around the
# near end of a wall (1.2 m). Around a pillar of 0.5 m (1.24 m longer), around a wall of 1 m by its
# middle (1.6 m) and around more it stays behind until it leaves its path.
_LONGEST_DETOUR_M = 1.2
_SPARE_M = 0.05  # the route begins and ends this much farther from the obstacle than needed
# Longest time on the path for which a vehicle may be too far behind. In flight it is
# CATCH_UP_LIMIT_S, in which the clock of the path runs at the slowest rate.
_BEHIND_S = SLOWEST_RATE * CATCH_UP_LIMIT_S


class _Crossing(NamedTuple):
    """A part of a path that leads through an obstacle, from free space to free space."""

    begin_enu_m: Xyz
    end_enu_m: Xyz
    length_m: float
    time_s: float  # time on the path at which it begins
    behind_s: float  # time on the path for which the obstacle keeps the vehicle too far behind


def crossing_findings(
    fleet: FleetConfig, paths: Mapping[str, Path], where: str
) -> Iterator[Finding]:
    """Yield the findings about the paths that lead most and longest through an obstacle.

    Args:
        fleet: the fleet file.
        paths: paths of its vehicles.
        where: position in the mission, for the sentences.
    """
    if not fleet.obstacles:
        return

    detours = []
    times = []
    flown = sample(paths)
    for index, name in enumerate(flown.names):
        for crossing in _crossings(fleet, flown.times_s, flown.values[0, :, index, :3]):
            detours.append(_detour_finding(fleet, name, crossing, where))
            times.append(_time_finding(name, crossing, where))
    if detours:
        yield worst(detours)
        yield worst(times)


def path_refusals(fleet: FleetConfig, paths: Mapping[str, Path], where: str) -> list[str]:
    """Return the sentences that say why paths cannot be flown, the worst first; empty if they can.

    Args:
        fleet: the fleet file.
        paths: paths of its vehicles.
        where: position in the mission, for the sentences.
    """
    findings = path_findings(fleet, paths, where)
    return refusals([*findings, *crossing_findings(fleet, paths, where)])


def _crossings(fleet: FleetConfig, times_s: Array, positions: Array) -> Iterator[_Crossing]:
    """Yield the parts of a path that lead through obstacles.

    Args:
        fleet: the fleet file.
        times_s: times of the samples (T,).
        positions: positions of the path (T, 3) [m], ENU.
    """
    to_obstacle_m = obstacle_clearances_m(fleet, positions)
    needed_m = 0.5 * fleet.fleet.body_diameter_m + fleet.law.obstacle_margin_m
    near = np.flatnonzero(to_obstacle_m < needed_m + _SPARE_M)
    parts = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)

    for part in parts:
        if not part.size or to_obstacle_m[part].min() >= 0.0:
            continue
        first = max(0, part[0] - 1)
        last = min(len(positions) - 1, part[-1] + 1)
        steps_m = np.diff(positions[first : last + 1], axis=0)
        begin_x, begin_y, begin_z = positions[first].tolist()
        end_x, end_y, end_z = positions[last].tolist()
        yield _Crossing(
            begin_enu_m=(begin_x, begin_y, begin_z),
            end_enu_m=(end_x, end_y, end_z),
            length_m=float(np.sqrt((steps_m**2).sum(-1)).sum()),
            time_s=float(times_s[first]),
            behind_s=_samples_behind(needed_m - to_obstacle_m[part])
            * float(times_s[1] - times_s[0]),
        )


def _samples_behind(lags_m: Array) -> int:
    """Return the number of samples at which a vehicle is too far behind its path.

    Args:
        lags_m: smallest distance of the path from where the vehicle can be, at each sample.
    """
    count = 0
    is_lagging = False
    for lag_m in lags_m.tolist():  # as PathFlight in onboard/flight/path_flight.py does
        limit_m = CAUGHT_UP_M if is_lagging else BEHIND_M
        is_lagging = lag_m > limit_m
        count += is_lagging
    return count


def _detour_finding(fleet: FleetConfig, name: str, crossing: _Crossing, where: str) -> Finding:
    """Return the finding about the detour around the obstacle of one part of a path."""
    begin = crossing.begin_enu_m
    end = crossing.end_enu_m
    around_m = route_length_m(fleet, name, begin, end)
    sentence = _crossing_words(name, crossing, where)
    refuse_above = _LONGEST_DETOUR_M
    if reach_refusal(fleet, name, begin, end):
        sentence += "no route leads around it"
        refuse_above = -math.inf
    else:
        sentence += (
            "the route around it is <value> longer, and a vehicle keeps up with its path if that "
            "is <relation> <bound>"
        )

    return at_most(
        name="path through an obstacle",
        where=where,
        value=max(0.0, around_m - crossing.length_m),
        bound=_LONGEST_DETOUR_M,
        unit="m",
        sentence=sentence,
        remedy="Lead the path around the obstacle.",
        refuse_above=refuse_above,
    )


def _time_finding(name: str, crossing: _Crossing, where: str) -> Finding:
    """Return the finding about the time that one part of a path stays deep inside an obstacle."""
    return at_most(
        name="path inside an obstacle",
        where=where,
        value=crossing.behind_s,
        bound=_BEHIND_S,
        unit="s",
        sentence=f"{_crossing_words(name, crossing, where)}the obstacle keeps the vehicle more "
        f"than {BEHIND_M:g} m behind for <value>, and a vehicle keeps up with its path if that is "
        "<relation> <bound>",
        remedy="Lead the path around the obstacle.",
    )


def _crossing_words(name: str, crossing: _Crossing, where: str) -> str:
    """Return the words that say which path leads through an obstacle, and when."""
    return (
        f"{capitalised(where)}: {name}'s path leads through an obstacle from "
        f"{crossing.time_s:.1f} s on; "
    )
