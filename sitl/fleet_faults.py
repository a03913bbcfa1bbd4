"""Which faults of the emulator can happen to a vehicle of a fleet file, by how it flies."""

from __future__ import annotations

from onboard.config.fleet import FleetConfig, Vehicle
from sitl.faults.catalogue import Fault, FaultError


def refuse_absent_source(fault: Fault, fleet: FleetConfig) -> None:
    """Refuse a fault of a source of positions that its vehicle does not have.

    A mocap body counts as long as anybody hears it: a vehicle that flies without a mocap may have a
    body that its neighbours watch.

    Args:
        fault: fault, checked.
        fleet: the fleet file.

    Raises:
        FaultError: the fault would break nothing.
    """
    family, _, _ = fault.name.partition("_")
    vehicle = fleet.vehicles[fault.vehicle]
    concerned = [vehicle]
    if "other" in fault.parameters:
        concerned.append(fleet.vehicles[fault.word("other")])

    if family == "mocap" and not any(each.body for each in concerned):
        raise _absent(fault, vehicle, "nobody hears a mocap body of it")
    if family == "vision":
        for each in concerned:
            if each.flies_by_satellites:
                raise _absent(fault, each, "its PX4 hears no external position")
    if family == "gps" and not _uses_satellites(vehicle):
        raise _absent(fault, vehicle, "its PX4 uses no satellites")
    if family == "base" and fleet.corrections is None:
        raise _absent(fault, vehicle, "the fleet has no corrections")
    if family in ("corrections", "rtk") and not fleet.takes_corrections(vehicle):
        raise _absent(fault, vehicle, "its receiver gets no corrections")


def _uses_satellites(vehicle: Vehicle) -> bool:
    """Return whether satellites act on the estimate of a vehicle's PX4."""
    return vehicle.flies_by_satellites or bool(vehicle.px4_params.get("EKF2_GPS_CTRL", 0))


def _absent(fault: Fault, vehicle: Vehicle, reason: str) -> FaultError:
    source = "mocap"
    if vehicle.flies_by_satellites:
        source = "satellites"
    elif vehicle.flies_by_vision:
        source = "vision"
    return FaultError(
        f"{fault.name} would break nothing: {vehicle.name} flies by {source}, and {reason}. "
        "Name another vehicle, or remove the fault."
    )
