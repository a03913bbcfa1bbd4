"""The vehicles on which `pause`, `resume` and `skip` have an effect."""

from __future__ import annotations

from collections.abc import Iterable

from groundstation.fleet.state import FleetState


def stoppable(state: FleetState, names: Iterable[str]) -> tuple[str, ...]:
    """Return those of these vehicles that report to follow a path or another vehicle.

    Args:
        state: the fleet as known now.
        names: names of vehicles.
    """
    followers = []
    for name in names:
        telemetry = state.vehicles[name].telemetry
        if telemetry is not None and (telemetry.show_id or telemetry.follows):
            followers.append(name)
    return tuple(followers)
