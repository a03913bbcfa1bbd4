"""The direct path to a vehicle: straight to PX4 over its ground link, past an agent that does not answer.

The only file of the ground that imports pymavlink, and only when the path is used. Blocking: call it in a thread.
"""

from __future__ import annotations

import contextlib
import math
import re
import socket
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from groundstation.fleet.own_stall import OwnStall, boot_clock_ns

DirectKind = Literal["land", "kill"]
_GCS_SYSTEM, _GCS_COMPONENT, _AUTOPILOT = 255, 190, 1
_NAV_LAND, _ARM_DISARM, _FORCE = 21, 400, 21196.0
_REQUEST_MESSAGE, _AUTOPILOT_VERSION = 512, 148.0
_PREFLIGHT_STORAGE = 245
_ARMED_FLAG = 128
_MODE_LAND = 4 << 16 | 6 << 24  # PX4's AUTO.LAND in HEARTBEAT.custom_mode
_RESULTS = {0: "accepted", 1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 5: "in progress"}
_ACCEPTED = (0, 5)
_PARAM_INT32 = 6
_RETRY_S = 0.2
_MAX_DATAGRAM = 65_535

# PX4 answers for ever to the address that sent to it first. So a link is kept for the next command, and every process
# of this computer sends from the same port, which follows from PX4's; of several processes the newest gets the answers.
_FIRST_PORT, _PORTS = 10_000, 4_000
_idle_links: dict[str, Any] = {}


@dataclass(frozen=True, slots=True)
class DirectResult:
    """PX4's own answer to a direct command."""

    is_accepted: bool
    is_disarmed: bool  # a heartbeat has shown it
    sentence: str  # without a capital letter and a full stop
    has_answered: bool = True  # PX4 has, by word or by effect


def mavutil_address(endpoint: str) -> str:
    """Return the fleet file's ``udpout://HOST:PORT`` in pymavlink's spelling.

    Args:
        endpoint: as in the fleet file.

    Returns:
        As pymavlink expects it.

    Raises:
        ValueError: it is no such endpoint.
    """
    match = re.fullmatch(r"(udpin|udpout|tcp)://(.+:\d+)", endpoint)
    if match is None:
        raise ValueError(f"'{endpoint}' is no direct endpoint; write it as udpout://127.0.0.1:18570")
    return f"{match[1]}:{match[2]}"


def send_direct(
    endpoint: str, system_id: int, kind: DirectKind, *, timeout_s: float = 3.0, watch_s: float = 0.0
) -> DirectResult:
    """Send one command over MAVLink until PX4's heartbeat shows its effect, then wait for PX4 to disarm.

    The command is repeated every 0.2 s, whatever is answered: both commands may arrive twice without harm, and an
    answer alone does not prove that the vehicle obeys. Messages of other senders are ignored.

    Args:
        endpoint: PX4's ground link, as ``udpout://127.0.0.1:18570``.
        system_id: PX4's MAVLink system id.
        kind: land, or kill: disarm by force.
        timeout_s: longest wait for the acknowledgement or the effect [s].
        watch_s: longest wait for the disarm after it [s].

    Returns:
        PX4's answer; an endpoint that cannot be used gives one that is not accepted.
    """
    try:
        link = _take_link(endpoint)
    except (OSError, ValueError) as error:
        return DirectResult(False, False, f"the direct endpoint {endpoint} cannot be opened ({error})", False)
    try:
        progress = _command(link, system_id, kind, timeout_s, watch_s)
    except OSError as error:
        return DirectResult(False, False, f"the direct endpoint {endpoint} failed ({error})", False)
    finally:
        _idle_links[endpoint] = link
    answer = progress.answer
    if answer is None and not progress.is_shown:
        return DirectResult(False, False, f"PX4 did not answer at {endpoint} within {timeout_s:g} s either", False)
    verb = "did not acknowledge" if answer is None else _RESULTS.get(answer, f"answered {answer} to")
    ending = ", and it is disarmed" if progress.is_disarmed else ", and it lands" if progress.is_landing else ""
    return DirectResult(progress.is_accepted, progress.is_disarmed, f"PX4 {verb} it{ending}")


class _Progress:
    """Acknowledgement and effect of one command, by PX4's messages."""

    def __init__(self, system_id: int, kind: DirectKind) -> None:
        self._system_id, self._kind = system_id, kind
        self.command = _NAV_LAND if kind == "land" else _ARM_DISARM
        self.answer: int | None = None  # last MAV_RESULT
        self.is_landing = False
        self.is_disarmed = False

    @property
    def is_shown(self) -> bool:
        """Whether a heartbeat has shown the effect."""
        return self.is_landing or self.is_disarmed

    @property
    def is_accepted(self) -> bool:
        """Whether PX4 has accepted the command, by word or by effect."""
        return self.is_shown or self.answer in _ACCEPTED

    def take(self, message: Any) -> None:
        """Take over a COMMAND_ACK or HEARTBEAT of PX4, and ignore those of others."""
        if not _is_of_autopilot(message, self._system_id):
            return
        if message.get_type() == "COMMAND_ACK":
            if message.command == self.command and _is_for_this_ground(message):
                self.answer = int(message.result)
        else:
            self.is_disarmed = not message.base_mode & _ARMED_FLAG
            self.is_landing = self._kind == "land" and (self.is_landing or message.custom_mode == _MODE_LAND)


def _command(link: Any, system_id: int, kind: DirectKind, timeout_s: float, watch_s: float) -> _Progress:
    nan = math.nan
    params = (0.0, 0.0, 0.0, nan, nan, nan, nan) if kind == "land" else (0.0, _FORCE, 0.0, 0.0, 0.0, 0.0, 0.0)
    progress = _Progress(system_id, kind)
    is_watched = False
    next_send_s = next_beat_s = time.monotonic()
    end_s = next_send_s + timeout_s
    stall = OwnStall(boot_clock_ns)  # answers of that time are still to be read
    while (now_s := time.monotonic()) < (end_s := end_s + stall.look()) and not progress.is_disarmed:
        if now_s >= next_beat_s:
            _send_heartbeat(link)
            next_beat_s = now_s + 1.0
        if now_s >= next_send_s and not progress.is_landing:  # a pilot may take over a landing that has begun
            link.mav.command_long_send(system_id, _AUTOPILOT, progress.command, 0, *params)
            next_send_s = now_s + _RETRY_S
        message = link.recv_match(type=["COMMAND_ACK", "HEARTBEAT"], blocking=True, timeout=0.1)
        if message is not None:
            progress.take(message)
        if progress.is_accepted and not is_watched:
            is_watched, end_s = True, now_s + watch_s
    return progress


def _is_of_autopilot(message: Any, system_id: int) -> bool:
    return bool(message.get_srcSystem() == system_id and message.get_srcComponent() == _AUTOPILOT)


def _is_for_this_ground(ack: Any) -> bool:
    """Whether an acknowledgement is for this ground's command; MAVLink 1 has no target in it."""
    target = (ack.target_system, ack.target_component)
    return target in ((_GCS_SYSTEM, _GCS_COMPONENT), (0, 0))


def _send_heartbeat(link: Any) -> None:
    link.mav.heartbeat_send(6, 8, 0, 0, 0)  # MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID


class DirectParams:
    """PX4's parameters over the ground link, with the methods of the agent's link that ``covey px4 params`` uses.

    Args:
        endpoint: PX4's ground link.
        system_id: PX4's MAVLink system id.

    Raises:
        OSError: the endpoint cannot be opened.
        ValueError: it is written wrongly.
    """

    def __init__(self, endpoint: str, system_id: int) -> None:
        self.endpoint, self.system_id = endpoint, system_id
        self._link = _take_link(endpoint)
        self._kinds: dict[str, int] = {}

    def stop(self) -> None:
        """Keep the link for the next command."""
        _idle_links[self.endpoint] = self._link

    def is_armed(self, timeout_s: float) -> bool | None:
        """Wait for PX4's next heartbeat.

        Args:
            timeout_s: longest wait [s].

        Returns:
            Whether PX4 is armed; None when no heartbeat came.
        """
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            _send_heartbeat(self._link)
            message = self._link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.5)
            is_armed = _shows_armed(message, self.system_id)
            if is_armed is not None:
                return is_armed
        return None

    def version(self, timeout_s: float) -> tuple[int, int] | None:
        """Ask for PX4's version.

        Args:
            timeout_s: longest wait [s].

        Returns:
            Major and minor number; None when PX4 does not answer.
        """
        self._link.mav.command_long_send(
            self.system_id, _AUTOPILOT, _REQUEST_MESSAGE, 0, _AUTOPILOT_VERSION, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        )
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            message = self._link.recv_match(type="AUTOPILOT_VERSION", blocking=True, timeout=0.05)
            if message is not None and _is_of_autopilot(message, self.system_id):
                return message.flight_sw_version >> 24 & 0xFF, message.flight_sw_version >> 16 & 0xFF
        return None

    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        """Read parameters.

        Args:
            names: parameters to read; the values are ignored.

        Returns:
            PX4's values; None where it did not answer.
        """
        return {name: self._value_after(name, lambda name=name: self._request(name)) for name in names}

    def apply_params(self, values: Mapping[str, float | int]) -> None:
        """Set parameters; :meth:`read_params` tells whether that worked.

        Args:
            values: parameter -> value.
        """
        for name, value in values.items():
            if name not in self._kinds:
                self._value_after(name, lambda name=name: self._request(name))
            kind = self._kinds.get(name)
            if kind is not None:
                self._value_after(name, lambda name=name, kind=kind, value=value: self._set(name, kind, value))

    def request_storage(self, timeout_s: float) -> int | None:
        """Have PX4 write its parameters to its storage.

        Args:
            timeout_s: longest wait for the acknowledgement [s].

        Returns:
            PX4's MAV_RESULT, which comes before it writes; None when it does not answer.
        """
        self._link.mav.command_long_send(
            self.system_id, _AUTOPILOT, _PREFLIGHT_STORAGE, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        )
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            ack = self._link.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.05)
            if ack is not None and ack.get_srcSystem() == self.system_id and ack.command == _PREFLIGHT_STORAGE:
                return int(ack.result)
        return None

    def _request(self, name: str) -> None:
        self._link.mav.param_request_read_send(self.system_id, _AUTOPILOT, name.encode(), -1)

    def _set(self, name: str, kind: int, value: float | int) -> None:
        # PX4 puts whole numbers bit by bit into the field of a float
        sent = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == _PARAM_INT32 else float(value)
        self._link.mav.param_set_send(self.system_id, _AUTOPILOT, name.encode(), sent, kind)

    def _value_after(self, name: str, send: Any, attempts: int = 4) -> float | int | None:
        """The parameter's value in PX4's reply to what ``send`` sends."""
        for _ in range(attempts):
            send()
            end_s = time.monotonic() + 2.0 * _RETRY_S
            while time.monotonic() < end_s:
                reply = self._link.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.05)
                if reply is None or not _is_of_autopilot(reply, self.system_id) or reply.param_id != name:
                    continue
                self._kinds[name] = int(reply.param_type)
                if reply.param_type == _PARAM_INT32:
                    return int(struct.unpack("<i", struct.pack("<f", reply.param_value))[0])
                return float(reply.param_value)
        return None


def _shows_armed(heartbeat: Any, system_id: int) -> bool | None:
    """Whether a heartbeat shows this autopilot as armed; None when it is of another sender, or none at all."""
    if heartbeat is None or not _is_of_autopilot(heartbeat, system_id):
        return None
    return bool(heartbeat.base_mode & _ARMED_FLAG)


def _receive_from_px4_only(link: Any) -> None:
    """Drop datagrams of any other address: the port is predictable, and anybody could play the autopilot there."""
    host, port = link.destination_addr
    px4 = (socket.gethostbyname(host), port)

    def receive(_: int | None = None) -> bytes:
        try:
            data, sender = link.port.recvfrom(_MAX_DATAGRAM)
        except (BlockingIOError, ConnectionRefusedError):
            return b""
        return data if sender == px4 else b""

    link.recv = receive


def _take_link(endpoint: str) -> Any:
    """A link to this endpoint, emptied of old messages; OSError or ValueError when it cannot be opened."""
    from pymavlink import mavutil

    link = _idle_links.pop(endpoint, None)
    if link is None:
        address = mavutil_address(endpoint)
        link = mavutil.mavlink_connection(
            address, source_system=_GCS_SYSTEM, source_component=_GCS_COMPONENT, dialect="common"
        )
        if address.startswith("udpout:"):
            link.port.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with contextlib.suppress(OSError):  # taken by something else: any port then
                link.port.bind(("", _FIRST_PORT + int(address.rpartition(":")[2]) % _PORTS))
            _receive_from_px4_only(link)
    while link.recv_match(blocking=False) is not None:
        pass
    return link
