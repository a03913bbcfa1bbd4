"""Sockets of the emulator: the address of each link of each vehicle, and the address of its peer.

PX4 streams to a fixed port before it has received a datagram. The sender of the first datagram, of
any content, then becomes the peer until PX4 restarts.
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
# First port of the companion link, first port of the ground link, and instances. PX4's own ports
# collide from the eleventh instance on.
_LAYOUT: tuple[tuple[int, int, range], ...] = (
    (14540, 18570, range(10)),
    (15540, 19570, range(10, 255)),
)
# SIH's link: instance N binds SIMULATOR_PORT + N and sends to VIEWER_PORT + N. The ports collide
# from the instance SIMULATOR_INSTANCES on.
SIMULATOR_PORT = 19450
VIEWER_PORT = 19410
SIMULATOR_INSTANCES = 40

_ENDPOINT = re.compile(r"(?P<scheme>udpin|udpout)://(?P<host>[^:/]*|\[[^\]]*\]):(?P<port>\d{1,5})")
_MAX_DATAGRAMS = 64  # datagrams read in one batch from one socket
_LARGEST_DATAGRAM = 65535
_RECEIVE_BUFFER_BYTES = 1 << 20


class StartError(RuntimeError):
    """The emulator cannot start; the message is a sentence with the reason."""


@dataclass(frozen=True, slots=True)
class Ports:
    """Address of one link, and the address of its first peer, if any."""

    bind: Address
    peer: Address | None


def onboard_ports(autopilot: str, key: str) -> Ports:
    """Return the addresses of the companion link.

    Args:
        autopilot: endpoint of the agent in the fleet file.
        key: key of that endpoint, for messages.
    """
    scheme, host, port = _parse(autopilot, key)
    if scheme == "udpout":
        # The agent sends first, to this address. PX4 waits there.
        return Ports(bind=(host, port), peer=None)

    # The agent waits at this address. PX4 sends first, from a port that is 40 higher.
    peer_host = host
    if host == "0.0.0.0":
        peer_host = "127.0.0.1"
    return Ports(bind=(host, port + ONBOARD_PORT_OFFSET), peer=(peer_host, port))


def ground_ports(
    autopilot: str, direct: str | None, key: str, station: Address | None
) -> Ports | None:
    """Return the addresses of the ground station's link; None when there is no such link.

    They come from the fleet file's `direct` endpoint, or from PX4's layout of ports.

    Args:
        autopilot: endpoint of the companion in the fleet file.
        direct: endpoint of the ground station in the fleet file.
        key: key of the vehicle's endpoints in the fleet file, for messages.
        station: address of the first peer; None waits for the first datagram.
    """
    if direct is not None:
        _, host, port = _parse(direct, f"{key}.direct")
        return Ports(bind=(host, port), peer=station)
    if station is None:
        return None

    px4_port = ground_port_of(autopilot)
    if px4_port is None:
        # Outside PX4's layout any free port (0) will do, because a ground station answers to the
        # sender's port.
        px4_port = 0
    return Ports(bind=("127.0.0.1", px4_port), peer=station)


def ground_port_of(autopilot: str) -> int | None:
    """Return the port of the ground link beside a companion endpoint; None outside PX4's layout."""
    instance = _instance(autopilot)
    if instance is None:
        return None
    first_port, number = instance
    return first_port + number


def simulator_ports(autopilot: str) -> Ports | None:
    """Return the addresses of the link on which SIH sends its true state to viewers.

    The result is None outside PX4's layout of ports, and for instances whose ports collide.
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
    if match is None or match["scheme"] != "udpin":
        return None

    for first_companion_port, first_ground_port, instances in _LAYOUT:
        number = int(match["port"]) - first_companion_port
        if number in instances:
            return first_ground_port, number
    return None


def station_of(text: str) -> Address:
    """Return `HOST:PORT` of a ground station as an address.

    A name is resolved here, once, because each datagram would resolve it again.
    """
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise StartError(
            f"'{text}' is no address of a ground station. Write it as 127.0.0.1:14550."
        )
    if not host:
        host, _ = GROUND_STATION

    try:
        found = socket.getaddrinfo(host, int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        raise StartError(
            f"The host of '{text}' is not known. Check its name, or write its address: "
            "127.0.0.1:14550."
        ) from None
    _, _, _, _, address = found[0]
    return str(address[0]), int(port)


def _parse(endpoint: str, key: str) -> tuple[str, str, int]:
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or not 0 < int(match["port"]) < 65536 - ONBOARD_PORT_OFFSET:
        raise StartError(
            f"'{key}' is {endpoint!r}, which cannot be emulated. "
            "Use udpin://127.0.0.1:14540 (PX4's layout) or udpout://."
        )
    host = match["host"] or "0.0.0.0"
    return match["scheme"], host, int(match["port"])


def bind(ports: Ports, user: str) -> socket.socket:
    """Return a bound socket that never blocks.

    Args:
        ports: addresses of the link.
        user: description of the link, for messages.

    Raises:
        StartError: the port cannot be bound.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(ports.bind)
    except (OSError, OverflowError) as error:
        sock.close()
        host, port = ports.bind
        reason = getattr(error, "strerror", None) or error
        raise StartError(
            f"{user} needs UDP port {port} on {host}, which cannot be bound ({reason}). "
            "Is another emulator or a PX4 running? Stop it, or change the port in the fleet file."
        ) from None

    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    return sock


class EndpointLink(Protocol):
    """Interface of a link for its endpoint; `boot` counts the restarts of its autopilot."""

    @property
    def boot(self) -> int:
        """Return the number of restarts of the autopilot."""
        ...

    def receive(self, datagram: bytes) -> list[bytes]:
        """Return the answers to one datagram."""
        ...

    def poll(self) -> list[bytes]:
        """Return the datagrams that are due now."""
        ...


class Endpoint:
    """One link and its peer.

    The endpoint is pure: it receives datagrams with their senders, and calls `send` to send.

    Args:
        link: link that answers and sends datagrams.
        peer: address of the peer until the first datagram arrives.
        send: function that sends a datagram to an address.
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
        """Receive a datagram and send the answers to the peer."""
        if datagram and not self._is_locked:
            self._is_locked = True
            self.peer = sender
        for answer in self.link.receive(datagram):
            self._send_to_peer(answer)

    def poll(self) -> None:
        """Send the datagrams that are due; without a peer they are dropped."""
        for datagram in self.link.poll():
            self._send_to_peer(datagram)

        if self.link.boot != self._boot:
            # PX4 changes its peer only at a restart.
            self._boot = self.link.boot
            self.peer = self._first_peer
            self._is_locked = False

    def _send_to_peer(self, datagram: bytes) -> None:
        if self.peer is not None:
            self._send(datagram, self.peer)


class Socket:
    """A bound socket with the endpoint that it serves."""

    def __init__(self, sock: socket.socket, link: EndpointLink, peer: Address | None) -> None:
        self._sock = sock
        self.endpoint = Endpoint(link, peer, self._send)

    def open(self, ready: selectors.BaseSelector) -> None:
        """Register the socket for :func:`read_all`."""
        ready.register(self._sock, selectors.EVENT_READ, self.read)

    def close(self, ready: selectors.BaseSelector) -> None:
        """Close the socket."""
        ready.unregister(self._sock)
        self._sock.close()

    def read(self) -> None:
        """Pass the datagrams that have arrived to the endpoint."""
        # The number is limited, so that a client that floods the socket does not stop the vehicles.
        for _ in range(_MAX_DATAGRAMS):
            try:
                data, sender = self._sock.recvfrom(_LARGEST_DATAGRAM)
            except OSError:
                return  # no datagram is left, or the peer does not exist
            self.endpoint.receive(data, sender)

    def _send(self, datagram: bytes, peer: Address) -> None:
        try:
            self._sock.sendto(datagram, peer)
        except OSError:
            return  # the peer does not exist or a buffer is full, and the datagram is lost


def read_all(ready: selectors.BaseSelector) -> None:
    """Read the datagrams that have arrived at all open sockets.

    Reading once per step of the physics is enough, because datagrams take effect with the step.
    Waking up for each datagram would take as much time as the rest of the emulator.
    """
    for key, _ in ready.select(0):
        read_socket = key.data  # Socket.read, registered by Socket.open
        read_socket()
