"""The slot owner of each vehicle, by the reports of spares that replace others. Pure.

A fleet file and a mission assign a take-off spot, slots of formations, paths and steps to the name
of a vehicle. The slot owner of a vehicle is the name whose spot, slots, paths and steps it uses;
normally its own. After ``swap mav2 mav7`` the slot owner of mav7 is mav2, and the spot, slots and
paths of mav7 are unused.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.tuples import Xyz

Value = TypeVar("Value")
# A spare on the ground that has been silent for longer than this, while the vehicle that it
# replaced reports that it is its own slot owner, has been replaced by it.
_SILENT_NS = 2_000_000_000


def stand_ins(state: FleetState | None) -> dict[str, str]:
    """Return the vehicles that stand in for others: slot owner -> vehicle.

    A spare whose agent has died may have been replaced since, by another spare or by the slot owner
    itself. Its last report still names the slot owner, so the newest report counts.

    Args:
        state: the fleet as known now; None: nothing is known, so the result is empty.
    """
    if state is None:
        return {}

    vehicle_by_owner: dict[str, str] = {}
    for name, view in state.vehicles.items():
        telemetry = view.telemetry
        if telemetry is None or telemetry.disabled_by:
            continue
        # This is also false for an empty name, and for a name that is not of this fleet.
        owner = telemetry.stands_in_for
        if owner not in state.vehicles:
            continue
        other = vehicle_by_owner.get(owner)
        if other is None or view.received_ns >= state.vehicles[other].received_ns:
            vehicle_by_owner[owner] = name

    for owner, name in tuple(vehicle_by_owner.items()):
        owner_view = state.vehicles[owner]
        spare_view = state.vehicles[name]
        silent_ns = owner_view.received_ns - spare_view.received_ns
        is_gone = silent_ns > _SILENT_NS and not spare_view.is_airborne
        if _is_own_slot_owner(owner_view) and is_gone:
            del vehicle_by_owner[owner]
    return vehicle_by_owner


def _is_own_slot_owner(view: VehicleView) -> bool:
    """Whether a vehicle reports that it is in service and stands in for nobody."""
    telemetry = view.telemetry
    return telemetry is not None and not telemetry.disabled_by and not telemetry.stands_in_for


def out_of_service(state: FleetState) -> set[str]:
    """Return the vehicles that take part in no flight.

    They are disabled, or another vehicle has the spot and slots that they had, their own or those
    of a vehicle for which they stood in.

    Args:
        state: the fleet as known now.
    """
    disabled = {name for name, view in state.vehicles.items() if view.is_disabled}
    vehicle_by_owner = stand_ins(state)
    replaced = set(vehicle_by_owner)
    for name, view in state.vehicles.items():
        if view.telemetry is not None and view.telemetry.stands_in_for in state.vehicles:
            replaced.add(name)
    standing_in = set(vehicle_by_owner.values())
    return disabled | (replaced - standing_in)


def unused_slot_owners(state: FleetState) -> set[str]:
    """Return the names whose spot, slots and paths no vehicle uses.

    The vehicle with such a name is out of service, or stands in for another one.

    Args:
        state: the fleet as known now.
    """
    vehicle_by_owner = stand_ins(state)
    standing_in = set(vehicle_by_owner.values())
    return (out_of_service(state) | standing_in) - vehicle_by_owner.keys()


def slot_owner_of(name: str, state: FleetState | None) -> str:
    """Return the name whose spot, slots and paths a vehicle uses; mostly its own.

    Args:
        name: name of the vehicle.
        state: the fleet as known now; None: nothing is known.
    """
    for owner, vehicle in stand_ins(state).items():
        if vehicle == name:
            return owner
    return name


def spot_of(name: str, fleet: FleetConfig, state: FleetState | None) -> Xyz:
    """Return the take-off spot of a vehicle [m], ENU.

    Args:
        name: name of the vehicle.
        fleet: the fleet file.
        state: the fleet as known now; None: nothing is known.
    """
    return fleet.vehicles[slot_owner_of(name, state)].start_enu_m


def vehicles_of_slots(owners: Iterable[str], state: FleetState | None) -> tuple[str, ...]:
    """Return the vehicles that use the slots of these names, each once.

    Args:
        owners: names in the fleet file.
        state: the fleet as known now; None: nothing is known.
    """
    vehicle_by_owner = stand_ins(state)
    vehicles = [vehicle_by_owner.get(owner, owner) for owner in owners]
    return tuple(dict.fromkeys(vehicles))  # without repetitions, in the same order


def by_slot_owner(
    values: Iterable[tuple[str | tuple[str, ...], Value]], fleet: FleetConfig, what: str
) -> dict[str, Value]:
    """Return values that are given by name or by index, as slot owner -> value.

    Args:
        values: name or index of a slot owner, and its value, as a mission gives them.
        fleet: the fleet file.
        what: the kind of value in words, for the refusal.

    Raises:
        ConfigError: a name or an index is of no vehicle or of several, or a vehicle has more than
            one value.
    """
    value_by_owner: dict[str, Value] = {}
    for key, value in values:
        names = fleet.select(key)
        if len(names) != 1:
            words = key if isinstance(key, str) else ", ".join(key)
            raise ConfigError(
                f"'{words}' names {len(names)} vehicles for one {what}. Give each vehicle its own."
            )
        (name,) = names
        if name in value_by_owner:
            raise ConfigError(f"{name} has more than one {what}. Give each vehicle one.")
        value_by_owner[name] = value
    return value_by_owner


def by_vehicle(values: Mapping[str, Value], state: FleetState | None) -> dict[str, Value]:
    """Return values of slot owners as values of the vehicles that use their slots.

    A vehicle that stands in for another one gets the value of that one. The value of its own name
    is dropped.

    Args:
        values: slot owner -> value.
        state: the fleet as known now; None: nothing is known.
    """
    vehicle_by_owner = stand_ins(state)
    standing_in = {vehicle_by_owner[owner] for owner in values if owner in vehicle_by_owner}

    vehicle_values = {}
    for owner, value in values.items():
        if owner in vehicle_by_owner:
            vehicle_values[vehicle_by_owner[owner]] = value
        elif owner not in standing_in:
            vehicle_values[owner] = value
    return vehicle_values
