"""Who has whose place: spares that stand in for vehicles, as all tell it in telemetry. Pure.

A place is what the fleet file gives a name: a take-off spot, slots of formations, paths and steps
of missions. Mostly the vehicle of that name has it. After ``swap mav2 mav7`` the vehicle mav7 has
the place mav2; its own place stays empty.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from groundstation.fleet.state import FleetState
from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz

Value = TypeVar("Value")


def stand_ins(state: FleetState | None) -> dict[str, str]:
    """Return who stands in at which place: name of the place -> vehicle.

    Args:
        state: the fleet as known now; None: nothing is known, so nobody.
    """
    if state is None:
        return {}

    there_are = {}
    for name, view in state.vehicles.items():
        telemetry = view.telemetry
        if telemetry is None or telemetry.disabled_by:
            continue
        # what a message says may be no name of the fleet
        if telemetry.stands_in_for not in state.vehicles:
            continue
        there_are[telemetry.stands_in_for] = name
    return there_are


def out_of_service(state: FleetState) -> set[str]:
    """Return the vehicles that take part in no flight: disabled ones, and those swapped.

    Args:
        state: the fleet as known now.
    """
    out = {name for name, view in state.vehicles.items() if view.is_disabled}
    there_are = stand_ins(state)
    return out | (there_are.keys() - there_are.values())


def place_of(name: str, state: FleetState | None) -> str:
    """Return whose place a vehicle has.

    Args:
        name: name of the vehicle.
        state: the fleet as known now; None: nothing is known.
    """
    for place, vehicle in stand_ins(state).items():
        if vehicle == name:
            return place
    return name


def spot_of(name: str, fleet: FleetConfig, state: FleetState | None) -> Xyz:
    """Return the take-off spot of a vehicle [m], ENU.

    Args:
        name: name of the vehicle.
        fleet: the fleet file.
        state: the fleet as known now; None: nothing is known.
    """
    return fleet.vehicles[place_of(name, state)].start_enu_m


def vehicles_at(places: Iterable[str], state: FleetState | None) -> tuple[str, ...]:
    """Return the vehicles that have these places, each once.

    Args:
        places: names of the fleet file.
        state: the fleet as known now; None: nothing is known.
    """
    there_are = stand_ins(state)
    return tuple(dict.fromkeys(there_are.get(place, place) for place in places))


def by_vehicle(values: Mapping[str, Value], state: FleetState | None) -> dict[str, Value]:
    """Return values of places as those of the vehicles that have them.

    A vehicle that stands in for another one has that one's value; the value of its own place is
    nobody's.

    Args:
        values: place -> value.
        state: the fleet as known now; None: nothing is known.
    """
    there_are = stand_ins(state)
    taken = {there_are[place] for place in values if place in there_are}

    of_vehicles = {}
    for place, value in values.items():
        if place in there_are:
            of_vehicles[there_are[place]] = value
        elif place not in taken:
            of_vehicles[place] = value
    return of_vehicles
