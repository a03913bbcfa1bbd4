"""Opens MAVLink links from this computer to an autopilot.

This is the only file of the ground that imports pymavlink, and it does so only when a link is
opened. There are two kinds of links. A UDP link to PX4's ground link is kept for the next command.
The vehicle's own link is opened as its agent opens it, and closed after use, so that the agent can
open it again.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import threading
import time
from typing import Any

from onboard.config.endpoints import LAST_PORT
from onboard.security.mavlink_key import TOOL_LINK_ID, ground_link_id, signing_time
from onboard.serial_device import open_serial

# system and components
GCS_SYSTEM = 255
GCS_COMPONENT = 190
AUTOPILOT = 1
_COMPANION_COMPONENT = 191

ARMED_FLAG = 128  # flag of HEARTBEAT.base_mode

# values of MAV_TYPE, and the value of MAV_AUTOPILOT for a sender that is not an autopilot
_GCS = 6
_ONBOARD_CONTROLLER = 18
_NO_AUTOPILOT = 8

_CONNECT_ATTEMPTS = 3  # attempts to open a TCP link, whose other side may be starting
_CONNECT_AGAIN_S = 1.0
_ENDED_WAIT_S = 0.05  # wait for each message of a TCP link that the other side has closed

_DIALECT = "common"
_MAX_DATAGRAM = 65_535

# PX4 always answers to the address that sent to it first. So a link is kept for the next command,
# and every process of this computer sends from the same port, which is computed from PX4's port. If
# several links to one PX4 are open, the newest gets the answers.
_FIRST_PORT = 10_000
_PORTS = 4_000

_newest_links: dict[str, Any] = {}  # endpoint -> link that was opened last
_idle_links: dict[str, Any] = {}  # endpoint -> link that waits for its next command
_opening = threading.Lock()  # pymavlink keeps its dialect in a module variable


def mavutil_address(endpoint: str) -> str:
    """Return an endpoint such as ``udpout://HOST:PORT`` in pymavlink's spelling.

    Args:
        endpoint: endpoint as in the fleet file.

    Returns:
        The address as pymavlink expects it.

    Raises:
        ValueError: the text is not such an endpoint.
    """
    match = re.fullmatch(r"(udpin|udpout|tcp)://(.+):(\d{1,5})", endpoint)
    if match is None or int(match[3]) > LAST_PORT:
        raise ValueError(
            f"'{endpoint}' is no direct endpoint; write it as udpout://127.0.0.1:18570"
        )
    return f"{match[1]}:{match[2]}:{match[3]}"


def is_of_autopilot(message: Any, system_id: int) -> bool:
    """Whether this vehicle's autopilot has sent a message, and not another sender."""
    return bool(message.get_srcSystem() == system_id and message.get_srcComponent() == AUTOPILOT)


def send_heartbeat(link: Any) -> None:
    """Send a heartbeat as a ground station, or as a companion on the vehicle's own link."""
    kind = _ONBOARD_CONTROLLER
    if link.source_system == GCS_SYSTEM:
        kind = _GCS
    link.mav.heartbeat_send(kind, _NO_AUTOPILOT, 0, 0, 0)


class Signing:
    """Signing of one link, with the attributes that pymavlink expects.

    Timestamps follow the clock and never go back: several programs of this computer send under the
    same link id, and PX4 refuses messages that are older than the newest of them.

    Args:
        key: key of the vehicle; None for a link that neither signs nor checks.
        link_id: MAVLink link id of this sender.
        hears_all: whether messages that are not signed with the key are accepted, too.
    """

    def __init__(self, key: bytes | None, link_id: int, *, hears_all: bool = False) -> None:
        self.secret_key = key
        self.link_id = link_id
        self.sign_outgoing = key is not None
        self.allow_unsigned_callback = self._accepts_unsigned
        self.stream_timestamps: dict[tuple[int, int, int], int] = {}

        # pymavlink counts received messages in these attributes
        self.sig_count = 0
        self.badsig_count = 0
        self.goodsig_count = 0
        self.unsigned_count = 0
        self.reject_count = 0

        self._hears_all = hears_all
        self._newest = 0  # newest timestamp [10 us since 2015]

    @property
    def timestamp(self) -> int:
        """The next timestamp [10 us since 2015]."""
        return max(self._newest, signing_time(time.time_ns()))

    @timestamp.setter
    def timestamp(self, value: int) -> None:
        self._newest = value

    def _accepts_unsigned(self, _: Any, message_id: int) -> bool:
        return self._hears_all


def sign(link: Any, signing: Signing) -> None:
    """Let a link sign what it sends and check what it receives, from now on."""
    link.mav.signing = signing


def take_link(endpoint: str, key: bytes | None = None) -> Any:
    """Return the ground's link to this endpoint, without old messages in its queue.

    Args:
        endpoint: PX4's ground link, as in the fleet file.
        key: key of MAVLink signing; None for a vehicle that does not sign.

    Raises:
        OSError: the endpoint cannot be opened.
        ValueError: the endpoint is not well-formed.
    """
    link = _idle_links.pop(endpoint, None)
    is_udp = endpoint.startswith("udpout://")
    if link is not None and is_udp and _has_moved(link):
        link.close()
        link = None
    if link is None:
        link = _new_link(endpoint)
        _newest_links[endpoint] = link

    if link.mav.signing.secret_key != key:
        sign(link, Signing(key, ground_link_id(socket.gethostname())))
    while link.recv_match(blocking=False) is not None:
        pass
    return link


def _new_link(endpoint: str) -> Any:
    """Open the ground's link to an endpoint, from the port that is computed from PX4's port."""
    address = mavutil_address(endpoint)
    link = _connection(address, GCS_SYSTEM, GCS_COMPONENT)
    if not address.startswith("udpout:"):
        return link

    host, px4_port = link.destination_addr
    link.destination_addr = (socket.gethostbyname(host), px4_port)
    link.port.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    with contextlib.suppress(OSError):  # another program has the port, so the system chooses one
        link.port.bind(("", _FIRST_PORT + px4_port % _PORTS))
    _exchange_with_px4_only(link)
    return link


def _has_moved(link: Any) -> bool:
    """Whether this computer would send to PX4 from another address than the link's, as by DHCP.

    A connected socket keeps the address that it was connected with.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(link.destination_addr)
        except OSError:  # there is no network at the moment
            return True
        present_address, _ = probe.getsockname()
        own_address, _ = link.port.getsockname()
        return bool(present_address != own_address)


def keep_link(endpoint: str, link: Any) -> None:
    """Keep the ground's link for its next command.

    A TCP link is closed instead, because its other end may close it before the next command. So is
    a link that is not the newest to its PX4, because it does not get the answers.
    """
    if endpoint.startswith("tcp://") or _newest_links.get(endpoint) is not link:
        link.close()
    else:
        _idle_links[endpoint] = link


def open_as_companion(endpoint: str, system_id: int, key: bytes | None = None) -> Any:
    """Return the vehicle's own link, as its agent opens it; close it after use.

    Args:
        endpoint: endpoint ``autopilot`` of the fleet file.
        system_id: PX4's MAVLink system id.
        key: key of MAVLink signing; None for a vehicle that does not sign.

    Raises:
        OSError: the endpoint cannot be opened.
        ValueError: the endpoint is not well-formed.
    """
    if endpoint.startswith("serial://"):
        link = _serial(endpoint, system_id)
    else:
        link = _connection(mavutil_address(endpoint), system_id, _COMPANION_COMPONENT)
    sign(link, Signing(key, TOOL_LINK_ID))
    return link


def message_codec(port: Any) -> Any:
    """Return a codec that encodes and decodes MAVLink without a socket or device.

    Args:
        port: object whose ``write`` gets each packet that is sent.
    """
    with _opening:
        codec = _mavutil().mavlink.MAVLink(port, GCS_SYSTEM, GCS_COMPONENT)
    codec.robust_parsing = True
    return codec


def send_to_autopilot(codec: Any, system_id: int, name: str, values: tuple[object, ...]) -> None:
    """Send a message that is addressed to an autopilot.

    Args:
        codec: MAVLink codec of pymavlink.
        system_id: system id of the vehicle.
        name: name of the message, in small letters.
        values: values of its fields, without target system and component. These two come first, but
            in file transfers they come after the first field, the network.
    """
    target = (system_id, AUTOPILOT)
    if name == "file_transfer_protocol":
        network, *others = values
        codec.file_transfer_protocol_send(network, *target, *others)
    else:
        getattr(codec, f"{name}_send")(*target, *values)


def _mavutil() -> Any:
    # Without this, pymavlink begins with MAVLink 1, and forgets its key when it changes to
    # MAVLink 2.
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil

    return mavutil


def _connection(address: str, system_id: int, component_id: int) -> Any:
    """Open a UDP or TCP link, which prints nothing."""
    with _opening:
        mavutil = _mavutil()
        mavutil.set_dialect(_DIALECT)

    # A TCP link to a host that does not answer takes minutes. The lock is not held meanwhile, so
    # that it does not delay the kill of another vehicle.
    def opened() -> Any:
        return mavutil.mavlink_connection(
            address,
            source_system=system_id,
            source_component=component_id,
            dialect=_DIALECT,
            retries=1,  # pymavlink prints a line before each further attempt
        )

    if not address.startswith("tcp:"):
        return opened()

    for attempt in range(1, _CONNECT_ATTEMPTS + 1):
        try:
            link = opened()
            break
        except OSError:
            if attempt == _CONNECT_ATTEMPTS:
                raise
            time.sleep(_CONNECT_AGAIN_S)

    # pymavlink prints when the other side has closed the link, at each attempt to receive
    link.handle_eof = lambda: time.sleep(_ENDED_WAIT_S)
    link.handle_disconnect = lambda: None
    return link


def _serial(endpoint: str, system_id: int) -> Any:
    """Open a serial device without pyserial, which is not installed on the ground.

    A device whose cable is pulled is silent from then on; it raises nothing.
    """
    with _opening:
        mavutil = _mavutil()
        mavutil.set_dialect(_DIALECT)

    descriptor = open_serial(endpoint)
    link = mavutil.mavfile(
        descriptor, endpoint, source_system=system_id, source_component=_COMPANION_COMPONENT
    )

    def receive(count: int | None = None) -> bytes:
        try:
            return os.read(descriptor, count or _MAX_DATAGRAM)
        except OSError:  # nothing has come yet, or the cable is pulled
            return b""

    def write(data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(descriptor, data)

    link.recv = receive
    link.write = write
    link.close = lambda: os.close(descriptor)
    return link


def _exchange_with_px4_only(link: Any) -> None:
    """Let a UDP link receive datagrams of its own PX4, and of no other sender.

    PX4s of several vehicles often have the same port, and then so do the links to them. The socket
    is connected to its PX4, so that the system gives it that PX4's datagrams.

    Our port is predictable, so any sender could pretend to be the autopilot. Datagrams from any
    address other than PX4's are dropped, also while the socket could not be connected.
    """
    px4 = link.destination_addr
    with contextlib.suppress(OSError):  # there is no network at the moment
        link.port.connect(px4)

    def receive(_: int | None = None) -> bytes:
        try:
            data, sender = link.port.recvfrom(_MAX_DATAGRAM)
        except OSError:  # nothing has come, or somebody on the way refused the last datagram
            return b""
        return data if sender == px4 else b""

    def write(data: bytes) -> None:
        try:
            link.port.send(data)
        except OSError:
            _send_anyhow(link.port, data, px4)

    link.recv = receive
    link.write = write


def _send_anyhow(port: socket.socket, data: bytes, px4: tuple[str, int]) -> None:
    """Send what the connected socket of a link did not send.

    An error of the datagram before is gone at the second attempt. If that fails, too, the socket is
    not connected, or this computer has another address now: another socket sends, which at least
    PX4 hears.
    """
    try:
        port.send(data)
    except OSError:
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
        ):
            other.sendto(data, px4)
