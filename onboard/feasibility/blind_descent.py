"""Checks whether vehicles that lose their poses land before dead reckoning becomes too inaccurate.

Under the law, each vehicle brakes and sinks by its own dead reckoning. The error of the position is
0.09 m (median) two seconds after the last pose, and 0.2 to 0.6 m after three and a half seconds,
with real and with emulated PX4s (docs/px4-sitl.md, sitl/README.md). In lockstep flights with 3 s to
the ground, hardly any two vehicles came nearer than 0.70 m. With more than 4 s they may touch.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from onboard.config.fleet import FleetConfig
from onboard.config.ground import ground_at_m
from onboard.control.passing import top_m as top_of_moves_m
from onboard.control.sinking import sinking_params, sinking_s
from onboard.feasibility.finding import Finding, at_most, worst
from onboard.plain_text import capitalised
from onboard.safety.limits import POSITION_STALE_S
from onboard.tuples import Xyz

_KEPT_S = 3.0  # longest time from the last pose to the ground; a longer time is a warning
_REFUSED_S = 4.0  # a longer time is refused


def blind_descent_findings(
    fleet: FleetConfig, spots: Mapping[str, Xyz], label: str, *, are_on_paths: bool = False
) -> Iterator[Finding]:
    """Yield the finding about whether all vehicles of a constellation land soon enough without
    poses.

    A vehicle that flies alone or uses PX4's own position is not checked.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentence.
        are_on_paths: whether the positions are the highest ones of paths, above which no vehicle
            rises to pass another. Beyond every time limit the finding stays a warning, because a
            show cannot be flown lower without another design.
    """
    by_mocap = [name for name in spots if fleet.vehicles[name].mocap_required]
    if len(spots) < 2 or not by_mocap:
        return

    tops = dict(spots)
    refused_s = math.inf
    if not are_on_paths:
        refused_s = _REFUSED_S
        for name, (x, y, z) in spots.items():
            tops[name] = (x, y, top_of_moves_m(fleet, name, z))
    yield worst(_finding(fleet, name, tops[name], label, refused_s) for name in by_mocap)


def _finding(fleet: FleetConfig, name: str, top: Xyz, label: str, refused_s: float) -> Finding:
    """Return the finding about one vehicle."""
    vehicle = fleet.vehicles[name]
    x, y, top_m = top
    height_m = max(0.0, top_m - float(ground_at_m(fleet, x, y)))
    params = sinking_params(
        float(vehicle.max_acceleration_m_s2), float(vehicle.hover_thrust_frac), has_mocap=True
    )

    return at_most(
        name="descent without poses",
        where=label,
        value=POSITION_STALE_S + sinking_s(height_m, params),
        bound=_KEPT_S,
        unit="s",
        sentence=(
            f"{capitalised(label)}: when all poses stop, {name} is down from "
            f"{height_m:.1f} m after <value>; dead reckoning keeps vehicles apart for <bound>"
        ),
        remedy="Fly lower, or let vehicles that fly high keep away from the others.",
        refuse_above=refused_s,
    )
