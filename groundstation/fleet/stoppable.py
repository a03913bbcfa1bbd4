"""Who flies what `pause`, `resume` and `skip` can change: a path, or the way of another vehicle."""

from __future__ import annotations

from collections.abc import Iterable

from groundstation.fleet.state import FleetState


def stoppable(state: FleetState, names: Iterable[str]) -> tuple[str, ...]:
    """Return those of these vehicles that follow a path or another vehicle, as they tell it.

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
