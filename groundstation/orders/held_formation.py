"""The present formation, which the next ``move`` of several vehicles keeps. Pure.

It consists of a name, a spacing, a rotation and a slot for each vehicle. The orders ``formation``
and ``rotate`` change it as soon as they are sent, and the paths of a formation when they are flown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from groundstation.fleet.state import FleetState
from groundstation.formations.slots import HeldFormation as HeldFormation  # orders import it here
from groundstation.formations.slots import formation_slots, stretched
from groundstation.orders.intents import Formation, Intent, Rotate
from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz


def held_after(intent: Intent, held: HeldFormation) -> HeldFormation:
    """Return the formation after an order is sent.

    Args:
        intent: the order.
        held: the formation before the order.
    """
    if isinstance(intent, Rotate):
        rotation_deg = math.remainder(held.rotation_deg + intent.angle_deg, 360.0)
        return replace(held, rotation_deg=rotation_deg)

    if isinstance(intent, Formation):
        return HeldFormation(
            name=intent.name,
            spacing_m=intent.spacing_m,
            rotation_deg=intent.rotation_deg,
            takes=intent.takes,
        )

    return held


def held_slots(fleet: FleetConfig, held: HeldFormation) -> dict[str, Xyz]:
    """Return the offsets of the vehicles in the present formation.

    Args:
        fleet: the fleet file.
        held: name, spacing and rotation of the formation, and the slot of each vehicle.

    Returns:
        Offset of each vehicle from the formation's position, metres ENU. A spare has the name of
        the vehicle that it replaces.
    """
    if held.name is None:
        return {}

    slots = slots_of(fleet, held.name, held.spacing_m, held.rotation_deg)
    if held.takes is None:
        return slots
    return {name: slots[held.takes.get(name, name)] for name in slots}


def slots_of(
    fleet: FleetConfig, formation: str, spacing_m: float | None = None, rotation_deg: float = 0.0
) -> dict[str, Xyz]:
    """Return the offsets of a formation, stretched and turned in the plane.

    Args:
        fleet: the fleet file.
        formation: name of the formation.
        spacing_m: distance [m] of the two slots that are nearest to each other; None leaves the
            formation as it is.
        rotation_deg: angle by which the formation is turned, counterclockwise.

    Returns:
        Offset of each vehicle from the formation's position, metres ENU.
    """
    return stretched(formation_slots(fleet, formation), spacing_m, rotation_deg)


def formation_position(
    slots: Mapping[str, Xyz], state: FleetState, names: Sequence[str]
) -> Xyz | None:
    """Return the position of a formation: the mean of its vehicles' positions minus their slots.

    Args:
        slots: offset of each vehicle, metres ENU.
        state: the fleet as known now.
        names: vehicles to average over.

    Returns:
        Position in metres ENU; None when no vehicle reports one.
    """
    positions = []
    for name in names:
        telemetry = state.telemetry_of(name)
        if telemetry is None or not telemetry.is_position_valid or name not in slots:
            continue

        x, y, z = telemetry.position_enu_m
        offset_x, offset_y, offset_z = slots[name]
        positions.append((x - offset_x, y - offset_y, z - offset_z))

    if not positions:
        return None
    x, y, z = (sum(axis) / len(positions) for axis in zip(*positions, strict=True))
    return (x, y, z)
