"""Sockets of the emulator: where each link of each vehicle is bound, and to whom it streams.

PX4 starts to stream to a fixed port before it has received anything. The first datagram that
arrives, whatever it holds, decides to whom it talks from then on, for good.
"""

from __future__ import annotations

import re
import selectors
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

Address = tuple[str, int]

# PX4's instance N binds 14580 + N for the companion that listens at 14540 + N, and 18570 + N for
# ground stations.
ONBOARD_PORT_OFFSET = 40
GROUND_STATION: Address = ("127.0.0.1", 14550)
# First companion port, first port of the ground link, and how many: PX4's own ports collide from
# the eleventh on.
_LAYOUT: tuple[tuple[int, int, range], ...] = (
    (14540, 18570, range(10)),
    (15540, 19570, range(10, 255)),
)
# SIH's link: instance N binds the first port + N and sends to the second + N. From the fortieth on
# the two would meet.
SIMULATOR_PORT = 19450
VIEWER_PORT = 19410
SIMULATOR_INSTANCES = 40

_ENDPOINT = re.compile(r"(udpin|udpout)://([^:/]*|\[[^\]]*\]):(\d{1,5})")  # scheme, host, port
_MOST_READ_AT_ONCE = 64  # datagrams at one socket
_LARGEST_DATAGRAM = 65535
_RECEIVE_BUFFER_BYTES = 1 << 20


class StartError(RuntimeError):
    """The emulator cannot start: a sentence for people."""


@dataclass(frozen=True, slots=True)
class Ports:
    """Address of one link, and the address that it streams to by itself, if any."""

    bind: Address
    peer: Address | None


def onboard_ports(autopilot: str, key: str) -> Ports:
    """Return the addresses of the companion link.

    PX4 sends at once to where the agent listens, from a port of its own that is 40 higher.
    """
    scheme, host, port = _parse(autopilot, key)
    if scheme == "udpout":
        return Ports(bind=(host, port), peer=None)

    peer_host = "127.0.0.1" if host == "0.0.0.0" else host
    return Ports(bind=(host, port + ONBOARD_PORT_OFFSET), peer=(peer_host, port))


def ground_ports(
    autopilot: str, direct: str | None, key: str, station: Address | None
) -> Ports | None:
    """Return the addresses of the ground station's link; None when there is no such link.

    They are the fleet file's `direct` endpoint, or what PX4's layout of ports says.

    Args:
        autopilot: the companion's endpoint in the fleet file.
        direct: the ground's endpoint in the fleet file.
        key: where both stand there, for messages.
        station: to whom to stream; None answers only whoever speaks first.
    """
    if direct is not None:
        _, host, port = _parse(direct, f"{key}.direct")
        return Ports(bind=(host, port), peer=station)
    if station is None:
        return None

    # Outside of PX4's layout any free port will do: a ground station answers to the port that a
    # datagram came from.
    port = ground_port_of(autopilot) or 0
    return Ports(bind=("127.0.0.1", port), peer=station)


def ground_port_of(autopilot: str) -> int | None:
    """Return the port of the ground link beside a companion endpoint; None outside PX4's layout."""
    instance = _instance(autopilot)
    if instance is None:
        return None
    first_port, number = instance
    return first_port + number


def simulator_ports(autopilot: str) -> Ports | None:
    """Return the addresses of the link on which SIH shows its true state to viewers.

    None outside PX4's layout of ports, and from the instance on whose ports would meet.
    """
    instance = _instance(autopilot)
    if instance is None:
        return None

    _, number = instance
    if number >= SIMULATOR_INSTANCES:
        return None
    return Ports(
        bind=("127.0.0.1", SIMULATOR_PORT + number), peer=("127.0.0.1", VIEWER_PORT + number)
    )


def _instance(autopilot: str) -> tuple[int, int] | None:
    """Return the first port of the ground links, and PX4's instance, of a companion endpoint."""
    match = _ENDPOINT.fullmatch(autopilot)
    if match is None or match[1] != "udpin":
        return None

    for first_companion_port, first_ground_port, instances in _LAYOUT:
        number = int(match[3]) - first_companion_port
        if number in instances:
            return first_ground_port, number
    return None


def station_of(text: str) -> Address:
    """Return `HOST:PORT` of a ground station as an address."""
    host, _, port = text.rpartition(":")
    if not port.isdigit() or not 0 < int(port) < 65536:
        raise StartError(
            f"'{text}' is no address of a ground station. Write it as 127.0.0.1:14550."
        )
    return host or GROUND_STATION[0], int(port)


def _parse(endpoint: str, key: str) -> tuple[str, str, int]:
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or not 0 < int(match[3]) < 65536 - ONBOARD_PORT_OFFSET:
        raise StartError(
            f"'{key}' is {endpoint!r}, which cannot be emulated. "
            "Use udpin://127.0.0.1:14540 (PX4's layout) or udpout://."
        )
    return match[1], match[2] or "0.0.0.0", int(match[3])


def bind(ports: Ports, what: str) -> socket.socket:
    """Return a bound socket that never blocks.

    Raises:
        StartError: the port is taken, in words.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(ports.bind)
    except (OSError, OverflowError) as error:
        sock.close()
        host, port = ports.bind
        reason = getattr(error, "strerror", None) or error
        raise StartError(
            f"{what} needs UDP port {port} on {host}, which cannot be bound ({reason}). "
            "Is another emulator or a PX4 running? Stop it, or change the port in the fleet file."
        ) from None

    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    return sock


class EndpointLink(Protocol):
    """Interface of a link for its endpoint; `boot` counts the restarts of its autopilot."""

    @property
    def boot(self) -> int:
        """Return how often its autopilot has started."""
        ...

    def receive(self, datagram: bytes) -> list[bytes]:
        """Return the answers to one datagram."""
        ...

    def poll(self) -> list[bytes]:
        """Return what is due to be sent now."""
        ...


class Endpoint:
    """One link and its peer. Pure: datagrams come in with their sender and leave through `send`.

    Args:
        link: link that the messages pass.
        peer: to whom, until somebody has spoken.
        send: sends a datagram to an address.
    """

    def __init__(
        self, link: EndpointLink, peer: Address | None, send: Callable[[bytes, Address], object]
    ) -> None:
        self.link = link
        self.peer = peer
        self._first_peer = peer
        self._boot = link.boot
        self._send = send
        self._is_locked = False

    def receive(self, datagram: bytes, sender: Address) -> None:
        """Take a datagram, and answer the peer."""
        if datagram and not self._is_locked:
            self._is_locked = True
            self.peer = sender
        for answer in self.link.receive(datagram):
            self._send_to_peer(answer)

    def poll(self) -> None:
        """Send what is due; without a peer it is built all the same, and dropped."""
        for datagram in self.link.poll():
            self._send_to_peer(datagram)

        if self.link.boot != self._boot:
            # Only a restart of PX4 lets go of its peer.
            self._boot = self.link.boot
            self.peer = self._first_peer
            self._is_locked = False

    def _send_to_peer(self, datagram: bytes) -> None:
        if self.peer is not None:
            self._send(datagram, self.peer)


class Socket:
    """A bound socket that reads for an endpoint and sends for it."""

    def __init__(self, sock: socket.socket, link: EndpointLink, peer: Address | None) -> None:
        self._sock = sock
        self.endpoint = Endpoint(link, peer, self._send)

    def open(self, ready: selectors.BaseSelector) -> None:
        """Be read by :func:`read_all` from now on."""
        ready.register(self._sock, selectors.EVENT_READ, self.read)

    def close(self, ready: selectors.BaseSelector) -> None:
        """Close the socket."""
        ready.unregister(self._sock)
        self._sock.close()

    def read(self) -> None:
        """Take what has arrived."""
        # A client that floods the socket has to wait for the next round: the vehicles fly on.
        for _ in range(_MOST_READ_AT_ONCE):
            try:
                data, sender = self._sock.recvfrom(_LARGEST_DATAGRAM)
            except OSError:
                return  # nothing left, or word that the peer is not there
            self.endpoint.receive(data, sender)

    def _send(self, datagram: bytes, peer: Address) -> None:
        try:
            self._sock.sendto(datagram, peer)
        except OSError:
            return  # nobody listens, or the buffer is full: a datagram is lost, as on any network


def read_all(ready: selectors.BaseSelector) -> None:
    """Take what has arrived at any open socket.

    Once in a step of the physics is enough, for nothing acts before the step. To wake up for each
    datagram would cost as much as all the rest.
    """
    for key, _ in ready.select(0):
        key.data()
