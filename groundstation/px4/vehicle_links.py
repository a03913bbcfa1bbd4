"""Each vehicle's PX4 past its agent: the link that answers, and the same work done for several at a
time.

The vehicle's own link is used when no agent holds it, else PX4's ground link (``direct``): PX4
answers on a link only the program that it heard there first, so nothing may push in between an
agent and its autopilot.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from groundstation.client.autopilot_link import AutopilotLink
from onboard.autopilot import LinkError, Version, plausible_version
from onboard.config.fleet import Vehicle
from onboard.px4.port_lock import PortClaim

_ANSWER_S = 4.0
_LARGEST_BATCH = 8
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(slots=True)
class VehicleLink:
    """One vehicle, and the link that its PX4 answers at; without one, ``trouble`` says why."""

    vehicle: Vehicle
    link: AutopilotLink | None = None
    is_armed: bool = False
    version: Version | None = None  # as reported
    trouble: str = ""
    silent_links: tuple[str, ...] = ()  # sentences on links that were tried before

    @property
    def endpoint(self) -> str:
        """Where PX4 answers; empty when it does not."""
        return self.link.endpoint if self.link is not None else ""

    @property
    def version_text(self) -> str:
        """The reported version in words."""
        if self.version is None:
            return "an unknown version of PX4"
        dotted = ".".join(map(str, self.version))
        return (
            f"PX4 v{dotted}"
            if plausible_version(self.version)
            else f"version {dotted}, which no PX4 has"
        )


@contextlib.contextmanager
def opened(
    vehicles: Sequence[Vehicle], keys: Mapping[str, bytes], *, hears_all: bool = False
) -> Iterator[list[VehicleLink]]:
    """Links to several vehicles, closed with the block.

    Args:
        vehicles: whose.
        keys: of those that sign.
        hears_all: whether PX4 is heard whatever it signs with.
    """
    with contextlib.ExitStack() as stack:
        yield for_each(
            lambda vehicle: _open(vehicle, stack, keys.get(vehicle.name), hears_all), vehicles
        )


def for_each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Call a function for several vehicles at a time, each in a thread."""
    with ThreadPoolExecutor(_LARGEST_BATCH) as pool:
        return list(pool.map(function, items))


def _open(
    vehicle: Vehicle, stack: contextlib.ExitStack, key: bytes | None, hears_all: bool
) -> VehicleLink:
    troubles: list[str] = []
    endpoints = [(vehicle.autopilot, True)] + ([(vehicle.direct, False)] if vehicle.direct else [])
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
        if is_armed is not None:
            stack.callback(claim.release)
            stack.callback(link.stop)
            return VehicleLink(
                vehicle, link, is_armed, link.version(), silent_links=tuple(troubles)
            )
        link.stop()
        claim.release()
        troubles.append(_silence(link, vehicle, is_signed=key is not None))
    if vehicle.direct is None:
        troubles.append(
            f"The fleet file gives no direct endpoint: stop its agent, or set vehicles.{vehicle.name}.direct to PX4's "
            "ground link."
        )
    else:
        troubles.append("Start PX4, or check cable and ports.")
    return VehicleLink(vehicle, trouble=" ".join(troubles))


def _silence(link: AutopilotLink, vehicle: Vehicle, *, is_signed: bool) -> str:
    if link.other_system_id is None:
        with_key = (
            f" that is signed with the key of {vehicle.name} (covey px4 signing says more)"
            if is_signed
            else ""
        )
        return f"Nothing is heard from PX4 at {link.endpoint}{with_key}."
    return (
        f"The PX4 at {link.endpoint} has MAVLink system id {link.other_system_id}, but the fleet file says "
        f"{vehicle.system_id}. Correct 'system_id' or the endpoint of this vehicle, or MAV_SYS_ID of this PX4."
    )
