"""Whether vehicles that lose their poses are down before their dead reckoning is worth too little.

Each of them brakes and sinks by its own reckoning, under the law. That is wrong by 0.09 m (median)
two seconds after the last pose, and by 0.2 to 0.6 m after three and a half; real PX4s and emulated
ones agree (docs/px4-sitl.md, sitl/README.md). Flights in lockstep show what it costs: with 3 s to
the ground hardly any two come below 0.70 m, with more than 4 s they may touch.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from onboard.config.fleet import FleetConfig
from onboard.control.sinking import sinking_params, sinking_s
from onboard.feasibility.finding import Finding, at_most, worst
from onboard.safety.limits import POSITION_STALE_S
from onboard.tuples import Xyz

_KEPT_S = 3.0  # from the last pose to the ground
_REFUSED_S = 4.0


def blind_descent_findings(
    fleet: FleetConfig, spots: Mapping[str, Xyz], label: str
) -> Iterator[Finding]:
    """Yield whether all of a constellation are down soon enough when poses stop.

    A vehicle that flies alone, or by PX4's own position, is not judged.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentence.
    """
    by_mocap = [name for name in spots if fleet.vehicles[name].mocap_required]
    if len(spots) < 2 or not by_mocap:
        return

    yield worst(_finding(fleet, name, spots[name], label) for name in by_mocap)


def _finding(fleet: FleetConfig, name: str, spot: Xyz, label: str) -> Finding:
    """Return the finding about one vehicle."""
    vehicle = fleet.vehicles[name]
    height_m = max(0.0, spot[2] - vehicle.start_enu_m[2])
    params = sinking_params(
        float(vehicle.max_acceleration_m_s2), float(vehicle.hover_thrust_frac), has_mocap=True
    )

    return at_most(
        name=f"descent without poses, {label}",
        value=POSITION_STALE_S + sinking_s(height_m, params),
        bound=_KEPT_S,
        unit="s",
        sentence=(
            f"{label[0].upper()}{label[1:]}: when all poses stop, {name} is down from "
            f"{height_m:.1f} m after {{value}}; dead reckoning keeps vehicles apart for {{bound}}"
        ),
        remedy="Fly lower, or let vehicles that fly high keep away from the others.",
        refuse_above=_REFUSED_S,
    )
