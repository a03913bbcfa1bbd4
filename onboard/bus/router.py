"""A router of the bus: Zenoh's router with the endpoints and the access control of its fleets."""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence
from typing import Any

from onboard.bus.protocol import NodeCredentials
from onboard.bus.session import open_zenoh
from onboard.bus.sockets import PromptSockets
from onboard.bus.zenoh_settings import Setting, of_router
from onboard.config.endpoints import host_of
from onboard.config.fleet import ConfigError, FleetConfig


def router_endpoint(fleets: Sequence[FleetConfig], endpoint: str | None = None) -> str:
    """Return the endpoint at which the router of this computer listens.

    Args:
        fleets: fleets of the router; each of their files must name its endpoint.
        endpoint: endpoint that a person has chosen. None chooses the only endpoint in the fleet
            files with an address of this computer.
    Raises:
        ConfigError: there is no such endpoint, or there are several.
    """
    own = endpoint
    if not own:
        own = _only_endpoint_of_this_computer(fleets[0])
    for fleet in fleets:
        if own not in fleet.fleet.routers:
            routers = "none; add routers = [...] to [fleet]"
            if fleet.fleet.routers:
                routers = ", ".join(fleet.fleet.routers)
            raise ConfigError(
                f"{fleet.path}: {own} is no router of this fleet. Its fleet.routers: {routers}."
            )
    return own


def router_settings(
    fleets: Sequence[FleetConfig], endpoint: str, credentials: NodeCredentials | None
) -> list[Setting]:
    """Return zenoh's settings for a router of this computer.

    Args:
        fleets: fleets of the router.
        endpoint: result of :func:`router_endpoint`.
        credentials: credentials of the router, with the access control of all fleets; None without
            keys.
    """
    others: list[str] = []
    for fleet in fleets:
        for other in fleet.fleet.routers:
            if other != endpoint and other not in others:
                others.append(other)
    return of_router(endpoint, others, credentials)


class Router:
    """One router.

    Args:
        settings: result of :func:`router_settings`.
    """

    def __init__(self, settings: Sequence[Setting]) -> None:
        self._settings = settings
        self._sockets = PromptSockets()
        self._session: Any = None  # zenoh's session, while the router runs

    def start(self) -> None:
        """Listen, and forward messages, on zenoh's threads.

        Raises:
            BusError: the endpoint is in use, or does not belong to this computer.
        """
        self._session = open_zenoh(self._settings)
        self._sockets.start()

    def stop(self) -> None:
        """Close the router; its clients then look for another one."""
        self._sockets.stop()
        if self._session is not None:
            self._session.close()
            self._session = None


def _only_endpoint_of_this_computer(fleet: FleetConfig) -> str:
    """Return the only router of the fleet file that has an address of this computer."""
    routers = fleet.fleet.routers
    if not routers:
        raise ConfigError(
            f"{fleet.path} names no router. Add where it is to listen, as the others reach it, to "
            '[fleet]: routers = ["quic/10.0.0.5:7447"]'
        )

    own = [endpoint for endpoint in routers if _is_of_this_computer(host_of(endpoint))]
    if not own:
        raise ConfigError(
            f"{fleet.path}: none of fleet.routers ({', '.join(routers)}) is an address of this "
            "computer. Start the router on its own computer, or correct the address."
        )
    if len(own) > 1:
        raise ConfigError(
            f"{fleet.path}: {' and '.join(own)} are of this computer. "
            f"Choose one: --endpoint {own[0]}"
        )
    return own[0]


def _is_of_this_computer(host: str) -> bool:
    """Return whether a socket of this computer can have the address."""
    try:
        candidates = socket.getaddrinfo(host.strip("[]"), 0, type=socket.SOCK_DGRAM)
    except OSError:
        return False

    for family, kind, protocol, _, address in candidates:
        with socket.socket(family, kind, protocol) as probe:
            try:
                probe.bind(address)
            except OSError as error:
                # an address in use also belongs to this computer
                if error.errno != errno.EADDRINUSE:
                    continue
            return True
    return False
