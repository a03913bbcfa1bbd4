"""Findings about paths that lead through obstacles. Pure.

A vehicle on a path is steered by the law alone, which knows no way around. It slides along the
outline of a thin obstacle while its path passes on the other side, and stays behind at a wide one.
So the way around decides: where it is much longer than the path, the vehicle does not keep up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from groundstation.orders.reachable_goals import unreachable, way_m
from groundstation.paths.checks import obstacle_gaps_m, sample
from onboard.arrays import Array
from onboard.config.fleet import FleetConfig
from onboard.control.path import Path
from onboard.feasibility.finding import Finding, at_most, worst
from onboard.tuples import Xyz

# Most that the way around an obstacle is longer than the path. In lockstep flights at 0.25 m/s a
# vehicle keeps up around a pillar with a radius of 0.3 m (1.0 m longer) and around the near end of
# a wall (1.2 m). Around a pillar of 0.5 m (1.24 m longer), around a wall of 1 m by its middle
# (1.6 m) and around more it stays behind until it leaves its path.
_LONGER_M = 1.2
_SPARE_M = 0.05  # the way around begins and ends this much farther from the obstacle than needed


class _Crossing(NamedTuple):
    """A part of a path that leads through an obstacle, from free space to free space."""

    begin_enu_m: Xyz
    end_enu_m: Xyz
    length_m: float
    time_s: float  # time on the path at which it begins


def crossing_findings(
    fleet: FleetConfig, paths: Mapping[str, Path], where: str
) -> Iterator[Finding]:
    """Yield the finding about the path that leads most through an obstacle.

    Args:
        fleet: the fleet file.
        paths: paths of its vehicles.
        where: position in the mission, for the sentences.
    """
    if not fleet.obstacles:
        return

    findings = []
    flown = sample(paths)
    for index, name in enumerate(flown.names):
        for crossing in _crossings(fleet, flown.times_s, flown.values[0, :, index, :3]):
            findings.append(_crossing_finding(fleet, name, crossing, where))
    if findings:
        yield worst(findings)


def _crossings(fleet: FleetConfig, times_s: Array, positions: Array) -> Iterator[_Crossing]:
    """Yield the parts of a path that lead through obstacles.

    Args:
        fleet: the fleet file.
        times_s: times of the samples (T,).
        positions: positions of the path (T, 3) [m], ENU.
    """
    gaps_m = obstacle_gaps_m(fleet, positions)
    clear_m = 0.5 * fleet.fleet.body_diameter_m + fleet.law.obstacle_margin_m + _SPARE_M
    near = np.flatnonzero(gaps_m < clear_m)
    parts = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)

    for part in parts:
        if not part.size or gaps_m[part].min() >= 0.0:
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
        )


def _crossing_finding(fleet: FleetConfig, name: str, crossing: _Crossing, where: str) -> Finding:
    """Return the finding about one part of a path."""
    begin = crossing.begin_enu_m
    end = crossing.end_enu_m
    around_m = way_m(fleet, name, begin, end)
    sentence = (
        f"{where[0].upper()}{where[1:]}: {name}'s path leads through an obstacle from "
        f"{crossing.time_s:.1f} s on; "
    )
    refuse_above = _LONGER_M
    if unreachable(fleet, name, begin, end):
        sentence += "no way leads around it"
        refuse_above = -math.inf
    else:
        sentence += (
            "the way around is <value> longer, and a vehicle keeps up with its path if that is "
            "<relation> <bound>"
        )

    return at_most(
        name=f"path through an obstacle, {where}",
        value=max(0.0, around_m - crossing.length_m),
        bound=_LONGER_M,
        unit="m",
        sentence=sentence,
        remedy="Lead the path around the obstacle.",
        refuse_above=refuse_above,
    )
