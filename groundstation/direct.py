"""The second way to a vehicle: kill and land straight to PX4, when its agent does not answer.

The only file of the ground that imports pymavlink, and only when the way is needed. Blocking: call it in a thread.
"""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from typing import Any, Literal

DirectKind = Literal["land", "kill"]
_GCS_SYSTEM, _GCS_COMPONENT, _AUTOPILOT = 255, 190, 1
_NAV_LAND, _ARM_DISARM, _FORCE = 21, 400, 21196.0
_ARMED_FLAG = 128
_RESULTS = {0: "accepted", 1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 5: "in progress"}

# PX4 answers for ever to the address that spoke to it first, so a link is kept for the next command.
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


def _says_disarmed(heartbeat: Any) -> bool:
    return heartbeat.get_srcComponent() == _AUTOPILOT and not heartbeat.base_mode & _ARMED_FLAG


def send_direct(
    endpoint: str, system_id: int, kind: DirectKind, *, timeout_s: float = 3.0, watch_s: float = 0.0
) -> DirectResult:
    """Send one command over MAVLink until PX4 acknowledges it, then watch up to ``watch_s`` for the disarm.

    The command is repeated every 0.2 s until acknowledged: both commands may arrive twice without harm.
    """
    from pymavlink import mavutil

    link = _idle_links.pop(endpoint, None)
    try:
        if link is None:
            link = mavutil.mavlink_connection(
                mavutil_address(endpoint), source_system=_GCS_SYSTEM, source_component=_GCS_COMPONENT, dialect="common"
            )
        while link.recv_match(blocking=False) is not None:
            pass  # what waited since the last command is not an answer to this one
    except (OSError, ValueError) as error:
        return DirectResult(False, False, f"the direct endpoint {endpoint} cannot be opened ({error})")
    command = _NAV_LAND if kind == "land" else _ARM_DISARM
    nan = float("nan")
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
                next_send_s = now_s + 0.2
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
