"""The direct path to a vehicle: straight to PX4 over its ground link, past an agent that does not
answer.

Blocking: call it in a thread.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Literal

from groundstation.client.mavlink_port import (
    ARMED_FLAG,
    AUTOPILOT,
    GCS_COMPONENT,
    GCS_SYSTEM,
    is_of_autopilot,
    keep_link,
    send_heartbeat,
    take_link,
)
from groundstation.fleet.own_stall import OwnStall, boot_clock_ns

DirectKind = Literal["land", "kill"]
_NAV_LAND, _ARM_DISARM, _FORCE = 21, 400, 21196.0
_MODE_LAND = 4 << 16 | 6 << 24  # PX4's AUTO.LAND in HEARTBEAT.custom_mode
_RESULTS = {
    0: "accepted",
    1: "temporarily rejected",
    2: "denied",
    3: "unsupported",
    4: "failed",
    5: "in progress",
}
_ACCEPTED = (0, 5)
_RETRY_S = 0.2


@dataclass(frozen=True, slots=True)
class DirectResult:
    """PX4's own answer to a direct command."""

    is_accepted: bool
    is_disarmed: bool  # a heartbeat has shown it
    sentence: str  # without a capital letter and a full stop
    has_answered: bool = True  # PX4 has, by word or by effect


def send_direct(
    endpoint: str,
    system_id: int,
    kind: DirectKind,
    *,
    key: bytes | None = None,
    timeout_s: float = 3.0,
    watch_s: float = 0.0,
) -> DirectResult:
    """Send one command over MAVLink until PX4's heartbeat shows its effect, then wait for PX4 to
    disarm.

    The command is repeated every 0.2 s, whatever is answered: both commands may arrive twice
    without harm, and an answer alone does not prove that the vehicle obeys. Messages of other
    senders are ignored.

    Args:
        endpoint: PX4's ground link, as ``udpout://127.0.0.1:18570``.
        system_id: PX4's MAVLink system id.
        kind: land, or kill: disarm by force.
        key: of MAVLink signing; None for a vehicle that does not sign.
        timeout_s: longest wait for the acknowledgement or the effect [s].
        watch_s: longest wait for the disarm after it [s].

    Returns:
        PX4's answer; an endpoint that cannot be used gives one that is not accepted.
    """
    try:
        link = take_link(endpoint, key)
    except (OSError, ValueError) as error:
        return DirectResult(
            False, False, f"the direct endpoint {endpoint} cannot be opened ({error})", False
        )
    try:
        progress = _command(link, system_id, kind, timeout_s, watch_s)
    except OSError as error:
        return DirectResult(False, False, f"the direct endpoint {endpoint} failed ({error})", False)
    finally:
        keep_link(endpoint, link)
    answer = progress.answer
    if answer is None and not progress.is_shown:
        return DirectResult(
            False, False, f"PX4 did not answer at {endpoint} within {timeout_s:g} s either", False
        )
    verb = (
        "did not acknowledge" if answer is None else _RESULTS.get(answer, f"answered {answer} to")
    )
    ending = (
        ", and it is disarmed"
        if progress.is_disarmed
        else ", and it lands"
        if progress.is_landing
        else ""
    )
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
        if not is_of_autopilot(message, self._system_id):
            return
        if message.get_type() == "COMMAND_ACK":
            if message.command == self.command and _is_for_this_ground(message):
                self.answer = int(message.result)
        else:
            self.is_disarmed = not message.base_mode & ARMED_FLAG
            self.is_landing = self._kind == "land" and (
                self.is_landing or message.custom_mode == _MODE_LAND
            )


def _command(
    link: Any, system_id: int, kind: DirectKind, timeout_s: float, watch_s: float
) -> _Progress:
    nan = math.nan
    params = (
        (0.0, 0.0, 0.0, nan, nan, nan, nan)
        if kind == "land"
        else (0.0, _FORCE, 0.0, 0.0, 0.0, 0.0, 0.0)
    )
    progress = _Progress(system_id, kind)
    is_watched = False
    next_send_s = next_beat_s = time.monotonic()
    end_s = next_send_s + timeout_s
    stall = OwnStall(boot_clock_ns)  # answers of that time are still to be read
    while (now_s := time.monotonic()) < (
        end_s := end_s + stall.look()
    ) and not progress.is_disarmed:
        if now_s >= next_beat_s:
            send_heartbeat(link)
            next_beat_s = now_s + 1.0
        # a pilot may take over a landing that has begun
        if now_s >= next_send_s and not progress.is_landing:
            link.mav.command_long_send(system_id, AUTOPILOT, progress.command, 0, *params)
            next_send_s = now_s + _RETRY_S
        message = link.recv_match(type=["COMMAND_ACK", "HEARTBEAT"], blocking=True, timeout=0.1)
        if message is not None:
            progress.take(message)
        if progress.is_accepted and not is_watched:
            is_watched, end_s = True, now_s + watch_s
    return progress


def _is_for_this_ground(ack: Any) -> bool:
    """Whether an acknowledgement is for this ground's command; MAVLink 1 has no target in it."""
    target = (ack.target_system, ack.target_component)
    return target in ((GCS_SYSTEM, GCS_COMPONENT), (0, 0))
