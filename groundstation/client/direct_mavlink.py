"""The direct path to a vehicle: straight to PX4 over its ground link.

It leads past an agent that does not answer. Blocking: call it in a thread.
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

# MAV_CMD and their parameters
_NAV_LAND = 21
_ARM_DISARM = 400
_FORCE = 21196.0  # second parameter of a disarm that is obeyed in the air
_LAND_PARAMS = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan)
_KILL_PARAMS = (0.0, _FORCE, 0.0, 0.0, 0.0, 0.0, 0.0)

_MODE_LAND = 4 << 16 | 6 << 24  # PX4's AUTO.LAND in HEARTBEAT.custom_mode
_RESULTS = {
    0: "accepted",
    1: "temporarily rejected",
    2: "denied",
    3: "unsupported",
    4: "failed",
    5: "in progress",
}
_ACCEPTED = (0, 5)  # of MAV_RESULT
_RETRY_S = 0.2
_HEARTBEAT_S = 1.0
_RECEIVE_S = 0.1


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
    """Send one command over MAVLink until PX4's heartbeat shows its effect, then wait for disarm.

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
        return _no_answer(f"the direct endpoint {endpoint} cannot be opened ({error})")
    try:
        progress = _command(link, system_id, kind, timeout_s, watch_s)
    except OSError as error:
        return _no_answer(f"the direct endpoint {endpoint} failed ({error})")
    finally:
        keep_link(endpoint, link)

    if progress.answer is None and not progress.is_shown:
        return _no_answer(f"PX4 did not answer at {endpoint} within {timeout_s:g} s either")
    return DirectResult(progress.is_accepted, progress.is_disarmed, progress.sentence)


def _no_answer(sentence: str) -> DirectResult:
    return DirectResult(is_accepted=False, is_disarmed=False, sentence=sentence, has_answered=False)


class _Progress:
    """Acknowledgement and effect of one command, by PX4's messages."""

    def __init__(self, system_id: int, kind: DirectKind) -> None:
        self._system_id = system_id
        self._kind = kind
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

    @property
    def sentence(self) -> str:
        """What PX4 has answered and shown."""
        verb = "did not acknowledge"
        if self.answer is not None:
            verb = _RESULTS.get(self.answer, f"answered {self.answer} to")

        ending = ""
        if self.is_disarmed:
            ending = ", and it is disarmed"
        elif self.is_landing:
            ending = ", and it lands"
        return f"PX4 {verb} it{ending}"

    def take(self, message: Any) -> None:
        """Take over a COMMAND_ACK or HEARTBEAT of PX4, and ignore those of others."""
        if not is_of_autopilot(message, self._system_id):
            return

        if message.get_type() == "COMMAND_ACK":
            if message.command == self.command and _is_for_this_ground(message):
                self.answer = int(message.result)
            return

        self.is_disarmed = not message.base_mode & ARMED_FLAG
        if self._kind == "land" and message.custom_mode == _MODE_LAND:
            self.is_landing = True


def _command(
    link: Any, system_id: int, kind: DirectKind, timeout_s: float, watch_s: float
) -> _Progress:
    """Send a command until it has its effect or the time is over; return what PX4 has shown."""
    params = _LAND_PARAMS if kind == "land" else _KILL_PARAMS
    progress = _Progress(system_id, kind)
    was_accepted = False

    begin_s = time.monotonic()
    next_send_s = begin_s
    next_heartbeat_s = begin_s
    end_s = begin_s + timeout_s
    stall = OwnStall(boot_clock_ns)

    while True:
        now_s = time.monotonic()
        end_s += stall.look()  # answers of the time of a stall are still to be read
        if now_s >= end_s or progress.is_disarmed:
            return progress

        if now_s >= next_heartbeat_s:
            send_heartbeat(link)
            next_heartbeat_s = now_s + _HEARTBEAT_S
        # A pilot may take over a landing that has begun: it is not ordered once more.
        if now_s >= next_send_s and not progress.is_landing:
            link.mav.command_long_send(system_id, AUTOPILOT, progress.command, 0, *params)
            next_send_s = now_s + _RETRY_S

        message = link.recv_match(
            type=["COMMAND_ACK", "HEARTBEAT"], blocking=True, timeout=_RECEIVE_S
        )
        if message is not None:
            progress.take(message)
        if progress.is_accepted and not was_accepted:
            was_accepted = True
            end_s = now_s + watch_s


def _is_for_this_ground(ack: Any) -> bool:
    """Whether an acknowledgement is for this ground's command; MAVLink 1 has no target in it."""
    target = (ack.target_system, ack.target_component)
    return target in ((GCS_SYSTEM, GCS_COMPONENT), (0, 0))
