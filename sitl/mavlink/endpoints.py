"""Sockets of the emulator: where each link of each vehicle is bound, whom it streams to, and who
has locked it.

PX4 starts to stream to a fixed port before it has heard anything. The first datagram that arrives,
whatever it holds, decides whom it talks to from then on, for good.
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
# SIH's link: instance N binds the one + N and sends to the other + N; from here on the two would
# meet
SIMULATOR_PORT, VIEWER_PORT, SIMULATOR_INSTANCES = 19450, 19410, 40
_ENDPOINT = re.compile(r"(udpin|udpout)://([^:/]*|\[[^\]]*\]):(\d{1,5})")
_MOST_READ_AT_ONCE = 64
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
    """The companion link: PX4 sends at once to where the agent listens, from its own port 40
    higher.
    """
    scheme, host, port = _parse(autopilot, key)
    if scheme == "udpout":
        return Ports((host, port), None)
    return Ports(
        (host, port + ONBOARD_PORT_OFFSET), ("127.0.0.1" if host == "0.0.0.0" else host, port)
    )


def ground_ports(
    autopilot: str, direct: str | None, key: str, station: Address | None
) -> Ports | None:
    """The ground station's link: the fleet file's `direct` endpoint, or what PX4's layout of ports
    says.

    Args:
        autopilot, direct: endpoints of the vehicle in the fleet file.
        key: where they stand, for messages.
        station: whom to stream to; None answers only who speaks first.
    """
    if direct is not None:
        _, host, port = _parse(direct, f"{key}.direct")
        return Ports((host, port), station)
    if station is None:
        return None
    # Outside of PX4's layout any free port will do: a ground station answers where it is spoken to
    # from.
    return Ports(("127.0.0.1", ground_port_of(autopilot) or 0), station)


def ground_port_of(autopilot: str) -> int | None:
    """The port of PX4's ground link that belongs to a companion endpoint in PX4's layout; None
    outside of it.
    """
    found = _instance(autopilot)
    return None if found is None else sum(found)


def simulator_ports(autopilot: str) -> Ports | None:
    """The link on which PX4's simulator SIH shows its true state to viewers; None outside of PX4's
    layout of ports.
    """
    _, instance = _instance(autopilot) or (0, SIMULATOR_INSTANCES)
    if instance >= SIMULATOR_INSTANCES:
        return None
    return Ports(("127.0.0.1", SIMULATOR_PORT + instance), ("127.0.0.1", VIEWER_PORT + instance))


def _instance(autopilot: str) -> tuple[int, int] | None:
    """First port of the ground links, and the instance of PX4, of a companion endpoint in PX4's
    layout.
    """
    match = _ENDPOINT.fullmatch(autopilot)
    if match is None or match[1] != "udpin":
        return None
    for companion, ground, instances in _LAYOUT:
        instance = int(match[3]) - companion
        if instance in instances:
            return ground, instance
    return None


def station_of(text: str) -> Address:
    """`HOST:PORT` of a ground station as an address."""
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
            f"'{key}' is {endpoint!r}, which cannot be emulated. Use udpin://127.0.0.1:14540 (PX4's layout) or udpout://."
        )
    return match[1], match[2] or "0.0.0.0", int(match[3])


def bind(ports: Ports, what: str) -> socket.socket:
    """A bound socket that never blocks.

    Raises:
        StartError: the port is taken, in words.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(ports.bind)
    except (OSError, OverflowError) as error:
        sock.close()
        reason = getattr(error, "strerror", None) or error
        raise StartError(
            f"{what} needs UDP port {ports.bind[1]} on {ports.bind[0]}, which cannot be bound ({reason}). "
            "Is another emulator or a PX4 running? Stop it, or change the port in the fleet file."
        ) from None
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    return sock


class EndpointLink(Protocol):
    """Interface of a link for its endpoint; `boot` counts the restarts of its autopilot."""

    @property
    def boot(self) -> int: ...
    def receive(self, datagram: bytes) -> list[bytes]: ...
    def poll(self) -> list[bytes]: ...


class Endpoint:
    """One link and whom it talks to. Pure: datagrams come in with their sender and leave through
    `send`.

    Args:
        link: what is said.
        peer: to whom, until somebody has spoken.
        send: puts a datagram on its way to an address.
    """

    def __init__(
        self, link: EndpointLink, peer: Address | None, send: Callable[[bytes, Address], object]
    ) -> None:
        self.link = link
        self.peer = self._first_peer = peer
        self._boot = link.boot
        self._send = send
        self._is_locked = False

    def receive(self, datagram: bytes, sender: Address) -> None:
        """Take a datagram, and answer the peer."""
        if datagram and not self._is_locked:
            self._is_locked, self.peer = True, sender
        for answer in self.link.receive(datagram):
            self._tell(answer)

    def poll(self) -> None:
        """Send what is due; without a peer it is built all the same, and dropped."""
        for datagram in self.link.poll():
            self._tell(datagram)
        if self.link.boot != self._boot:
            # Only a restart of PX4 lets go of whom it talks to.
            self._boot, self.peer, self._is_locked = self.link.boot, self._first_peer, False

    def _tell(self, datagram: bytes) -> None:
        if self.peer is not None:
            self._send(datagram, self.peer)


class Socket:
    """A bound socket that reads for an endpoint when it is asked to, and sends for it."""

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
    """Take what has arrived at any open socket. Once a step is enough, for nothing acts before the
    step; to wake up for each datagram by itself would cost as much as all the rest."""
    for key, _ in ready.select(0):
        key.data()
