"""A router of the bus: Zenoh's own, with the endpoints, the keys and the table of roles of one or
more fleets.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence
from pathlib import Path

from onboard.bus.credentials import Credentials, credentials_of
from onboard.bus.roles import ROUTER
from onboard.bus.session import open_zenoh
from onboard.bus.settings import Setting, of_router
from onboard.bus.sockets import PromptSockets
from onboard.config.endpoints import host_of
from onboard.config.fleet import ConfigError, FleetConfig


def router_settings(fleets: Sequence[FleetConfig], endpoint: str | None = None) -> list[Setting]:
    """Return zenoh's settings for a router of this computer.

    Args:
        fleets: whose messages it passes on; all of their files name its endpoint.
        endpoint: where it listens; None for the one of the fleet files that is of this computer.
    Raises:
        ConfigError: there is no such endpoint, or none that is clear; or the keys do not fit.
    """
    own = endpoint or _own_endpoint(fleets[0])
    others: list[str] = []
    for fleet in fleets:
        if own not in fleet.fleet.routers:
            raise ConfigError(
                f"{fleet.path}: {own} is no router of this fleet. Its fleet.routers: "
                f"{', '.join(fleet.fleet.routers) or 'none; add routers = [...] to [fleet]'}."
            )
        others += [other for other in fleet.fleet.routers if other != own and other not in others]
    return of_router(own, others, fleets, _credentials(fleets))


class Router:
    """One router.

    Args:
        settings: of :func:`router_settings`.
    """

    def __init__(self, settings: Sequence[Setting]) -> None:
        self._settings = settings
        self._sockets = PromptSockets()

    def start(self) -> None:
        """Listen, and pass on.

        Raises:
            BusError: the endpoint is taken or not of this computer.
        """
        self._session = open_zenoh(self._settings)
        self._sockets.start()

    def stop(self) -> None:
        """End: the clients look for another router."""
        self._sockets.stop()
        self._session.close()  # type: ignore[no-untyped-call]


def _own_endpoint(fleet: FleetConfig) -> str:
    routers = fleet.fleet.routers
    if not routers:
        raise ConfigError(
            f"{fleet.path} names no router. Add where it is to listen, as the others reach it, to [fleet]: "
            'routers = ["quic/10.0.0.5:7447"]'
        )
    own = [endpoint for endpoint in routers if _is_of_this_computer(host_of(endpoint))]
    if len(own) == 1:
        return own[0]
    if not own:
        raise ConfigError(
            f"{fleet.path}: none of fleet.routers ({', '.join(routers)}) is an address of this computer. Start the "
            "router on its own computer, or correct the address."
        )
    raise ConfigError(
        f"{fleet.path}: {' and '.join(own)} are of this computer. Choose one: --endpoint {own[0]}"
    )


def _is_of_this_computer(host: str) -> bool:
    try:
        found = socket.getaddrinfo(host.strip("[]"), 0, type=socket.SOCK_DGRAM)
    except OSError:
        return False
    for family, kind, protocol, _, address in found:
        with socket.socket(family, kind, protocol) as probe:
            try:
                probe.bind(address)
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    continue
            return True
    return False


def _credentials(fleets: Sequence[FleetConfig]) -> Credentials | None:
    """Return the router's credentials: one authority for all of its fleets."""
    own = [credentials_of(fleet, ROUTER) for fleet in fleets]
    first = own[0]
    for fleet, other in zip(fleets[1:], own[1:], strict=True):
        one, two = (
            None if each is None else Path(each.authority).read_bytes() for each in (first, other)
        )
        if one != two:
            raise ConfigError(
                f"{fleets[0].path} and {fleet.path} have different authorities, and a router shows one certificate. "
                "Run a router for each, or let both fleets use one folder of keys: [fleet] keys = ..."
            )
        both = sorted(fleets[0].vehicles.keys() & fleet.vehicles.keys())
        if first is not None and both:
            raise ConfigError(
                f"{fleets[0].path} and {fleet.path} both have a vehicle '{both[0]}': one certificate would be both. "
                "Give one of them another name, or run a router for each fleet."
            )
    return first
