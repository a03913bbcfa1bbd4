"""The second way to a vehicle: straight to PX4 over its ground link, when its agent does not answer or holds the other.

The only file of the ground that imports pymavlink, and only when the way is needed. Blocking: call it in a thread.
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

DirectKind = Literal["land", "kill"]
_GCS_SYSTEM, _GCS_COMPONENT, _AUTOPILOT = 255, 190, 1
_NAV_LAND, _ARM_DISARM, _FORCE = 21, 400, 21196.0
_ARMED_FLAG = 128
_RESULTS = {0: "accepted", 1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 5: "in progress"}
_PARAM_INT32 = 6
_RETRY_S = 0.2

# PX4 answers for ever to the address that spoke to it first. So a link is kept for the next command, and every process
# of this computer speaks from the same port, which follows from PX4's; of several the newest hears the answers.
_FIRST_PORT, _PORTS = 10_000, 4_000
_idle_links: dict[str, Any] = {}


@dataclass(frozen=True, slots=True)
class DirectResult:
    """What PX4 said itself: accepted or not, disarmed or not, in a sentence."""

    is_accepted: bool
    is_disarmed: bool
    sentence: str


def mavutil_address(endpoint: str) -> str:
    """The fleet file's ``udpout://HOST:PORT`` in pymavlink's spelling."""
    match = re.fullmatch(r"(udpin|udpout|tcp)://(.+:\d+)", endpoint)
    if match is None:
        raise ValueError(f"'{endpoint}' is no direct endpoint; write it as udpout://127.0.0.1:18570")
    return f"{match[1]}:{match[2]}"


def send_direct(
    endpoint: str, system_id: int, kind: DirectKind, *, timeout_s: float = 3.0, watch_s: float = 0.0
) -> DirectResult:
    """Send one command over MAVLink until PX4 acknowledges it, then watch up to ``watch_s`` for the disarm.

    The command is repeated every 0.2 s until acknowledged: both commands may arrive twice without harm.
    """
    try:
        link = _take_link(endpoint)
    except (OSError, ValueError) as error:
        return DirectResult(False, False, f"the direct endpoint {endpoint} cannot be opened ({error})")
    command = _NAV_LAND if kind == "land" else _ARM_DISARM
    nan = math.nan
    params = (0.0, 0.0, 0.0, nan, nan, nan, nan) if kind == "land" else (0.0, _FORCE, 0.0, 0.0, 0.0, 0.0, 0.0)
    answer: int | None = None
    is_disarmed = False
    try:
        begun_s = time.monotonic()
        next_send_s = begun_s
        end_s = begun_s + timeout_s
        while time.monotonic() < end_s:
            now_s = time.monotonic()
            if answer is None and now_s >= next_send_s:
                link.mav.heartbeat_send(6, 8, 0, 0, 0)
                link.mav.command_long_send(system_id, _AUTOPILOT, command, 0, *params)
                next_send_s = now_s + _RETRY_S
            elif now_s >= next_send_s:
                link.mav.heartbeat_send(6, 8, 0, 0, 0)
                next_send_s = now_s + 1.0
            message = link.recv_match(type=["COMMAND_ACK", "HEARTBEAT"], blocking=True, timeout=0.1)
            if message is None or message.get_srcSystem() != system_id:
                continue
            if message.get_type() == "COMMAND_ACK" and message.command == command and answer is None:
                answer = int(message.result)
                if answer not in (0, 5):
                    break
                end_s = time.monotonic() + watch_s
            elif message.get_type() == "HEARTBEAT" and answer is not None and _says_disarmed(message):
                is_disarmed = True
                break
    except OSError as error:
        return DirectResult(False, False, f"the direct endpoint {endpoint} failed ({error})")
    finally:
        _idle_links[endpoint] = link
    if answer is None:
        return DirectResult(False, False, f"PX4 did not answer at {endpoint} within {timeout_s:g} s either")
    ending = ", and it is disarmed" if is_disarmed else ""
    return DirectResult(answer in (0, 5), is_disarmed, f"PX4 {_RESULTS.get(answer, f'answered {answer}')} it{ending}")


class DirectParams:
    """PX4's parameters over the ground link, with the methods of the agent's link that ``covey px4 params`` uses."""

    def __init__(self, endpoint: str, system_id: int) -> None:
        self.endpoint, self.system_id = endpoint, system_id
        self._link = _take_link(endpoint)
        self._kinds: dict[str, int] = {}

    def stop(self) -> None:
        """Keep the link for the next who needs it."""
        _idle_links[self.endpoint] = self._link

    def is_armed(self, timeout_s: float) -> bool | None:
        """What the next heartbeat says; None when none came."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            self._link.mav.heartbeat_send(6, 8, 0, 0, 0)
            message = self._link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.5)
            if message is not None and message.get_srcSystem() == self.system_id and _is_autopilot(message):
                return bool(message.base_mode & _ARMED_FLAG)
        return None

    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        """PX4's values; None where it did not answer."""
        return {name: self._asked(name, lambda name=name: self._request(name)) for name in names}

    def apply_params(self, values: Mapping[str, float | int]) -> None:
        """Set parameters; whether that worked is for :meth:`read_params` to say."""
        for name, value in values.items():
            if name not in self._kinds:
                self._asked(name, lambda name=name: self._request(name))
            kind = self._kinds.get(name)
            if kind is not None:
                self._asked(name, lambda name=name, kind=kind, value=value: self._set(name, kind, value))

    def _request(self, name: str) -> None:
        self._link.mav.param_request_read_send(self.system_id, _AUTOPILOT, name.encode(), -1)

    def _set(self, name: str, kind: int, value: float | int) -> None:
        # PX4 puts whole numbers bit by bit into the field of a float
        sent = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == _PARAM_INT32 else float(value)
        self._link.mav.param_set_send(self.system_id, _AUTOPILOT, name.encode(), sent, kind)

    def _asked(self, name: str, ask: Any, attempts: int = 4) -> float | int | None:
        for _ in range(attempts):
            ask()
            end_s = time.monotonic() + 2.0 * _RETRY_S
            while time.monotonic() < end_s:
                told = self._link.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.05)
                if told is None or told.get_srcSystem() != self.system_id or told.param_id != name:
                    continue
                self._kinds[name] = int(told.param_type)
                if told.param_type == _PARAM_INT32:
                    return int(struct.unpack("<i", struct.pack("<f", told.param_value))[0])
                return float(told.param_value)
        return None


def _says_disarmed(heartbeat: Any) -> bool:
    return _is_autopilot(heartbeat) and not heartbeat.base_mode & _ARMED_FLAG


def _is_autopilot(heartbeat: Any) -> bool:
    return bool(heartbeat.get_srcComponent() == _AUTOPILOT)


def _take_link(endpoint: str) -> Any:
    """A link to this endpoint, without what waited on it: OSError or ValueError where there can be none."""
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
    while link.recv_match(blocking=False) is not None:
        pass
    return link
