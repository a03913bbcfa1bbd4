"""Which vehicles fly with another fleet file than this ground's, by their telemetry. Pure.

This ground takes spots, slots, distances and the list of the vehicles from its own file. So with
another file its orders mean something else to a vehicle, and a landing of all may leave vehicles in
the air.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from groundstation.fleet.state import FleetState
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig
from onboard.config.law import BUILT_IN
from onboard.plain_text import listed, plain_line


def has_other_file(telemetry: Telemetry, fleet: FleetConfig) -> bool:
    """Whether a vehicle flies with another fleet file; a law of its own is no other file.

    The hash of a fleet file covers its law. For a vehicle that flies another built-in law, the hash
    of this file with that law is compared. A user's own law that this file does not name is not
    loaded here, because a message must not make this ground import a module. So the file of such
    a vehicle is not known, and does not count as another one.

    Args:
        telemetry: of the vehicle.
        fleet: this ground's fleet file.
    """
    if telemetry.config_hash == fleet.config_hash:
        return False
    if telemetry.law == fleet.law.name:
        return True
    if telemetry.law not in BUILT_IN:
        return False
    return telemetry.config_hash != fleet.with_law(telemetry.law).config_hash


def with_other_file(
    state: FleetState, names: Iterable[str], fleet: FleetConfig, now_ns: int
) -> tuple[str, ...]:
    """Return those of these vehicles that report another fleet file; silent ones are left out.

    Args:
        state: the fleet as known now.
        names: vehicles.
        fleet: this ground's fleet file.
        now_ns: the ground's monotonic clock [ns].
    """
    compared: dict[tuple[str, str], bool] = {}  # hash and law -> result; nearly always all are one
    others = []
    for name in names:
        view = state.vehicles.get(name)  # None: disabled by the fleet file, and not heard
        if view is None or view.telemetry is None or not view.is_fresh(now_ns):
            continue

        telemetry = view.telemetry
        key = (telemetry.config_hash, telemetry.law)
        if key not in compared:
            compared[key] = has_other_file(telemetry, fleet)
        if compared[key]:
            others.append(name)
    return tuple(others)


def other_file_words(names: Sequence[str], fleet: FleetConfig) -> str:
    """Return why vehicles with another fleet file get no order to fly, and what to do.

    Args:
        names: the vehicles.
        fleet: this ground's fleet file.
    """
    fly = "flies" if len(names) == 1 else "fly"
    return (
        f"{listed(names)} {fly} with another fleet file than this ground's: spots, distances and "
        "the list of vehicles may differ. Land, hold and kill stay open. Give both the same file "
        f"and version of Covey, and start them anew; this ground's file is {fleet.path}."
    )


def unlisted_words(state: FleetState, fleet: FleetConfig, now_ns: int) -> str:
    """Return why nobody flies beside armed or flying vehicles that the fleet file lacks.

    Args:
        state: the fleet as known now, with at least one such vehicle.
        fleet: this ground's fleet file.
        now_ns: the ground's monotonic clock [ns].
    """
    names = [plain_line(view.name) for view in state.unlisted_up]
    lacked = "is" if len(names) == 1 else "are"
    sentence = (
        f"{listed(names)} {lacked} armed or in the air, and not in this ground's fleet file: no "
        "landing of all reaches it, and the others may not avoid it. Land it from a ground with "
        f"its file, or start this one with that file; this ground's is {fleet.path}."
    )
    for view, name in zip(state.unlisted_up, names, strict=True):
        if not view.is_fresh(now_ns):
            sentence += (
                f" {name} is silent now. If you see that it is down, write reset {name} in the "
                "console or on the page, or start this ground anew."
            )
    return sentence
