"""Links to the PX4s of several vehicles without their agents.

The vehicle's own link is used if no agent holds it, or else PX4's ground link (``direct``). On each
link PX4 answers only the program from which it has received the first message. So no other program
may use the link of an agent.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from groundstation.client.autopilot_link import AutopilotLink
from onboard.autopilot import LinkError, Version, plausible_version
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle
from onboard.px4.port_lock import PortClaim

_ANSWER_S = 4.0  # longest wait for a heartbeat of PX4
_LARGEST_BATCH = 8  # number of vehicles at a time
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(slots=True)
class VehicleLink:
    """One vehicle, and the link on which its PX4 answers; without one, ``trouble`` says why."""

    vehicle: Vehicle
    link: AutopilotLink | None = None
    is_armed: bool = False
    version: Version | None = None  # version that PX4 reports
    trouble: str = ""
    silent_links: tuple[str, ...] = ()  # sentences about links on which PX4 did not answer

    @property
    def endpoint(self) -> str:
        """The endpoint at which PX4 answers; empty if it does not."""
        if self.link is None:
            return ""
        return self.link.endpoint

    @property
    def version_text(self) -> str:
        """The reported version in words."""
        if self.version is None:
            return "an unknown version of PX4"
        dotted = ".".join(str(number) for number in self.version)
        if plausible_version(self.version):
            return f"PX4 v{dotted}"
        return f"version {dotted}, which no PX4 has"


def selected_vehicles(
    fleet: FleetConfig, vehicles: str | None, exclude: str | None
) -> list[Vehicle]:
    """Return the vehicles that a command names.

    Raises:
        ConfigError: the fleet has no such vehicle.
    """
    names = fleet.select(vehicles, exclude)
    if not names:
        raise ConfigError(
            "No vehicle is selected. Set enabled = true for one,"
            " or change --vehicles and --exclude."
        )
    return [fleet.vehicles[name] for name in names]


@contextlib.contextmanager
def opened(
    vehicles: Sequence[Vehicle], keys: Mapping[str, bytes], *, hears_all: bool = False
) -> Iterator[list[VehicleLink]]:
    """Open links to several vehicles; they are closed at the end of the block.

    Args:
        vehicles: the vehicles.
        keys: name of a vehicle that signs -> its key.
        hears_all: whether messages with any signature are received.
    """
    with contextlib.ExitStack() as stack:

        def open_one(vehicle: Vehicle) -> VehicleLink:
            return _open(vehicle, stack, keys.get(vehicle.name), hears_all=hears_all)

        yield for_each(open_one, vehicles)


def for_each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Return a function's result for each item; several calls run at a time, each in a thread."""
    with ThreadPoolExecutor(_LARGEST_BATCH) as pool:
        return list(pool.map(function, items))


def _open(
    vehicle: Vehicle, stack: contextlib.ExitStack, key: bytes | None, *, hears_all: bool
) -> VehicleLink:
    """Open the first link on which a vehicle's PX4 answers.

    Args:
        vehicle: the vehicle.
        stack: closes the link at its end.
        key: key of the vehicle's MAVLink signing; None if it does not sign.
        hears_all: whether messages with any signature are received.
    """
    is_elsewhere = is_device_of_another_computer(vehicle)
    if is_elsewhere and vehicle.direct is None:
        return VehicleLink(vehicle, trouble=_device_words(vehicle))

    # each endpoint, and whether it is the vehicle's own link, which an agent may hold
    endpoints = []
    if not is_elsewhere:
        endpoints.append((vehicle.autopilot, True))
    if vehicle.direct:
        endpoints.append((vehicle.direct, False))

    troubles: list[str] = []
    for endpoint, is_own in endpoints:
        claim = PortClaim(endpoint)
        try:
            if is_own:
                claim.take()
            link = AutopilotLink(endpoint, vehicle.system_id, is_own=is_own, key=key)
            if hears_all:
                link.sign(key)
        except (LinkError, OSError, ValueError) as error:
            claim.release()
            troubles.append(str(error))
            continue

        is_armed = link.is_armed(_ANSWER_S)
        if is_armed is None:
            link.stop()
            claim.release()
            troubles.append(_silence(link, vehicle, is_signed=key is not None))
            continue

        stack.callback(claim.release)
        stack.callback(link.stop)
        return VehicleLink(
            vehicle=vehicle,
            link=link,
            is_armed=is_armed,
            version=link.version(),
            silent_links=tuple(troubles),
        )

    if vehicle.direct is None:
        troubles.append(
            "The fleet file gives no direct endpoint: stop its agent, or set"
            f" vehicles.{vehicle.name}.direct to PX4's ground link."
        )
    else:
        troubles.append("Start PX4, or check cable and ports.")
    return VehicleLink(vehicle, trouble=" ".join(troubles))


def is_device_of_another_computer(vehicle: Vehicle) -> bool:
    """Return whether a vehicle's PX4 is connected to a serial device of another computer.

    Args:
        vehicle: the vehicle; the address of its agent is that of its computer.
    """
    return vehicle.autopilot.startswith("serial://") and not _is_this_computer(vehicle.host)


def _is_this_computer(host: str) -> bool:
    """Return whether an address is one of this computer's own."""
    try:
        first, *_ = socket.getaddrinfo(host, 0, type=socket.SOCK_DGRAM)
        family, kind, _, _, address = first
        with socket.socket(family, kind) as opened:
            opened.bind(address)  # only an address of this computer can be bound
    except OSError:
        return False
    return True


def _device_words(vehicle: Vehicle) -> str:
    device, _, _ = vehicle.autopilot.removeprefix("serial://").rpartition(":")  # without baud rate
    return (
        f"Its PX4 is at {device} of {vehicle.host}, another computer: set PX4's parameters "
        "over USB, or give a way past the companion as "
        f"vehicles.{vehicle.name}.direct (docs/deployment.md)."
    )


def _silence(link: AutopilotLink, vehicle: Vehicle, *, is_signed: bool) -> str:
    """Return a sentence about a link on which this vehicle's PX4 does not answer."""
    if link.other_system_id is not None:
        return (
            f"The PX4 at {link.endpoint} has MAVLink system id {link.other_system_id}, but the"
            f" fleet file says {vehicle.system_id}. Correct 'system_id' or the endpoint of this"
            " vehicle, or MAV_SYS_ID of this PX4."
        )

    with_key = ""
    if is_signed:
        with_key = f" that is signed with the key of {vehicle.name} (covey px4 signing says more)"
    return f"Nothing is heard from PX4 at {link.endpoint}{with_key}."
