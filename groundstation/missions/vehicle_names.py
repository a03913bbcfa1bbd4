"""Vehicles as the arguments of a Python mission name them.

An argument may be a generator, which can be read only once: after that it seems to name nobody. So
each argument becomes a text or a tuple where it enters, and everything else is computed from that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import Any, TypeVar

from groundstation.fleet.slot_owners import by_slot_owner
from groundstation.missions.argument_checks import as_mapping
from groundstation.orders.intents import Names
from onboard.config.fleet import ConfigError, FleetConfig

Value = TypeVar("Value")
ByVehicle = Mapping[str, Value] | Mapping[int, Value]  # name or index -> value

# "all", names or indices: "mav0,mav2", "0-1", or 1; or several of them, as in a list
Vehicles = str | int | Iterable[str | int]


def as_names(vehicles: Vehicles) -> Names:
    """Return vehicles that a mission names as one text, or as a tuple of texts.

    Args:
        vehicles: "all", names or indices.

    Raises:
        ConfigError: it is neither a name nor an index, nor several of them.
    """
    if isinstance(vehicles, str | Integral):
        return _as_name(vehicles)
    if not isinstance(vehicles, Iterable):
        raise _no_name(vehicles)
    return tuple(_as_name(vehicle) for vehicle in vehicles)


def by_name(values: object, fleet: FleetConfig, verb: str, what: str) -> dict[str, Any]:
    """Return values that a mission gives to vehicles, by names in the fleet file.

    Args:
        values: name or index -> value.
        fleet: the fleet file.
        verb: name of the method, for the refusal.
        what: the kind of value in words, for the refusal.

    Raises:
        ConfigError: it is no dictionary, a key names no vehicle or several, or a vehicle has more
            than one value.
    """
    values = as_mapping(values, verb, what, example=next(iter(fleet.vehicles)))
    named = [(as_names(vehicle), value) for vehicle, value in values.items()]
    return by_slot_owner(named, fleet, what)


def _as_name(vehicle: object) -> str:
    """Return a name or an index as a text."""
    if isinstance(vehicle, bool) or not isinstance(vehicle, str | Integral):
        raise _no_name(vehicle)
    return str(vehicle)


def _no_name(vehicle: object) -> ConfigError:
    """Return the refusal of what names no vehicle."""
    return ConfigError(
        f"A value of type {type(vehicle).__name__} names no vehicle. "
        'Give names or indices: "mav0,mav2", "0-1", 1, or a list of them.'
    )
