"""The direct path: lands or kills a vehicle by a command straight to PX4, over its ground link.

It is used when the vehicle's agent does not answer. :func:`send_direct` blocks;
:func:`send_in_thread` does not.
"""

from __future__ import annotations

import asyncio
import functools
import math
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
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
_FORCE = 21196.0  # second parameter of a disarm that PX4 obeys also in the air
_LAND_PARAMS = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan)
_KILL_PARAMS = (0.0, _FORCE, 0.0, 0.0, 0.0, 0.0, 0.0)

# PX4's AUTO.LAND in HEARTBEAT.custom_mode: main mode 4 in the third byte, sub mode 6 in the fourth
_MODE_LAND = 4 << 16 | 6 << 24
_RESULTS = {
    0: "accepted",
    1: "temporarily rejected",
    2: "denied",
    3: "unsupported",
    4: "failed",
    5: "in progress",
}
_ACCEPTED = (0, 5)  # values of MAV_RESULT for "accepted" and "in progress"
# PX4's main modes in which a pilot's sticks fly: MANUAL, ALTCTL, POSCTL, ACRO, STABILIZED,
# RATTITUDE and ALTITUDE_CRUISE
PILOT_MODES = (1, 2, 3, 5, 7, 8, 11)
_REQUEST_MESSAGE = 512
_SET_MESSAGE_INTERVAL = 511
_HEARTBEAT_ID = 0
_MANUAL_CONTROL_ID = 69
_STICKS_INTERVAL_US = 100_000
_DEFAULT_INTERVAL_US = 0  # stands for the default interval of a message
# Longest wait for a heartbeat that shows the mode. PX4 sends one each second, and on request.
_LOOK_S = 1.3
_STICKS_S = 0.8  # longest wait for sticks, which PX4 repeats five times a second
_RETRY_S = 0.2  # period of the command
_HEARTBEAT_S = 1.0  # period of this ground's heartbeat
_RECEIVE_S = 0.1  # longest wait for one message


@dataclass(frozen=True, slots=True)
class DirectResult:
    """PX4's own answer to a direct command."""

    is_accepted: bool
    is_disarmed: bool  # whether a heartbeat has shown it
    sentence: str  # without a capital letter and a full stop
    has_answered: bool = True  # whether PX4 has acknowledged the command or shown its effect
    is_flown_by_hand: bool = False  # whether nothing was sent, because a pilot flies


@dataclass(frozen=True, slots=True)
class DirectCommand:
    """One command straight to PX4; its fields are the arguments of :func:`send_direct`."""

    endpoint: str
    system_id: int
    kind: DirectKind
    key: bytes | None = None
    timeout_s: float = 3.0
    watch_s: float = 0.0
    spares_pilot: bool = False
    was_flown_by_hand: bool = False


# A landing keeps its thread until the vehicle is down. No command may wait for the thread of
# another one, as in the event loop's own executor, which has only a few.
_THREADS = ThreadPoolExecutor(max_workers=1024, thread_name_prefix="direct")

SendDirect = Callable[[DirectCommand], Awaitable[DirectResult]]


async def send_in_thread(command: DirectCommand) -> DirectResult:
    """Send a command by :func:`send_direct` in a thread, so that the event loop goes on.

    Args:
        command: the command.

    Returns:
        PX4's answer.
    """
    send = functools.partial(
        send_direct,
        command.endpoint,
        command.system_id,
        command.kind,
        key=command.key,
        timeout_s=command.timeout_s,
        watch_s=command.watch_s,
        spares_pilot=command.spares_pilot,
        was_flown_by_hand=command.was_flown_by_hand,
    )
    return await asyncio.get_running_loop().run_in_executor(_THREADS, send)


def send_direct(
    endpoint: str,
    system_id: int,
    kind: DirectKind,
    *,
    key: bytes | None = None,
    timeout_s: float = 3.0,
    watch_s: float = 0.0,
    spares_pilot: bool = False,
    was_flown_by_hand: bool = False,
) -> DirectResult:
    """Send one command over MAVLink until PX4's heartbeat shows its effect, then wait for disarm.

    The command is repeated every 0.2 s also after an acknowledgement, because an acknowledgement
    does not prove that the vehicle obeys. Both commands may arrive twice without harm. Messages of
    other senders are ignored.

    Args:
        endpoint: PX4's ground link, such as ``udpout://127.0.0.1:18570``.
        system_id: PX4's MAVLink system id.
        kind: "land", or "kill" to disarm by force.
        key: key of MAVLink signing; None for a vehicle that does not sign.
        timeout_s: longest wait for the acknowledgement or the effect [s].
        watch_s: longest wait for the disarm after that [s].
        spares_pilot: whether to ask PX4 first, and to send nothing if it is in a pilot's mode and
            receives sticks.
        was_flown_by_hand: whether the agent's last telemetry says that a pilot flies. It counts if
            PX4 does not answer the question, because it answers another ground on this link.

    Returns:
        PX4's answer. If the endpoint cannot be used, the answer is not accepted.
    """
    try:
        link = take_link(endpoint, key)
    except (OSError, ValueError) as error:
        return _no_answer(f"the direct endpoint {endpoint} cannot be opened ({error})")
    try:
        if spares_pilot and _is_flown_by_hand(link, system_id, otherwise=was_flown_by_hand):
            return DirectResult(
                is_accepted=False,
                is_disarmed=False,
                sentence="a pilot flies it by hand",
                is_flown_by_hand=True,
            )
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
        """Whether PX4 has acknowledged the command or shown its effect."""
        return self.is_shown or self.answer in _ACCEPTED

    @property
    def sentence(self) -> str:
        """PX4's acknowledgement and the effect, in words."""
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
        """Take a COMMAND_ACK or HEARTBEAT of PX4; ignore messages of other senders."""
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
    """Send a command until it has its effect or the time is over; return the progress."""
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
        end_s += stall.stalled_s()  # the length of a stall of this process does not count
        if now_s >= end_s or progress.is_disarmed:
            return progress

        if now_s >= next_heartbeat_s:
            send_heartbeat(link)
            next_heartbeat_s = now_s + _HEARTBEAT_S
        # A landing that has begun is not ordered again, because a pilot may have taken over since.
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
            end_s = now_s + watch_s  # from now on only the disarm is awaited


def _is_flown_by_hand(link: Any, system_id: int, *, otherwise: bool) -> bool:
    """Whether PX4 is in a pilot's mode and receives sticks; `otherwise` if PX4 is silent.

    PX4 is repeatedly asked for its heartbeat and for the sticks (MANUAL_CONTROL). A heartbeat with
    another mode ends the wait: no pilot flies. After a heartbeat with a pilot's mode, two messages
    about the sticks show that a pilot flies.
    """
    has_heartbeat = False
    is_pilots_mode = False
    sticks_count = 0  # PX4 sends the first message at once, even without sticks

    stall = OwnStall(boot_clock_ns)
    end_s = time.monotonic() + _LOOK_S
    next_send_s = 0.0
    try:
        while time.monotonic() < end_s:
            end_s += stall.stalled_s()
            if time.monotonic() >= next_send_s:
                next_send_s = time.monotonic() + _RETRY_S
                send_heartbeat(link)
                _ask(link, system_id, _REQUEST_MESSAGE, _HEARTBEAT_ID, 0.0)
                _ask(
                    link, system_id, _SET_MESSAGE_INTERVAL, _MANUAL_CONTROL_ID, _STICKS_INTERVAL_US
                )

            message = link.recv_match(
                type=["HEARTBEAT", "MANUAL_CONTROL"], blocking=True, timeout=_RECEIVE_S
            )
            if message is None or not is_of_autopilot(message, system_id):
                continue
            if message.get_type() == "MANUAL_CONTROL":
                sticks_count += 1
                if is_pilots_mode and sticks_count > 1:
                    return True
                continue

            has_heartbeat = True
            is_armed = bool(message.base_mode & ARMED_FLAG)
            was_pilots_mode = is_pilots_mode
            main_mode = message.custom_mode >> 16 & 0xFF
            is_pilots_mode = is_armed and main_mode in PILOT_MODES
            if not is_pilots_mode:
                return False
            if not was_pilots_mode:
                end_s = time.monotonic() + _STICKS_S
        return otherwise and not has_heartbeat
    finally:
        _ask(link, system_id, _SET_MESSAGE_INTERVAL, _MANUAL_CONTROL_ID, _DEFAULT_INTERVAL_US)


def _ask(link: Any, system_id: int, command: int, param1: float, param2: float) -> None:
    """Send a command that requests messages; PX4 answers it with these messages."""
    link.mav.command_long_send(
        system_id, AUTOPILOT, command, 0, param1, param2, 0.0, 0.0, 0.0, 0.0, 0.0
    )


def _is_for_this_ground(ack: Any) -> bool:
    """Whether an acknowledgement answers this ground's command.

    In MAVLink 1 an acknowledgement has no target, and both numbers are 0.
    """
    target = (ack.target_system, ack.target_component)
    return target in ((GCS_SYSTEM, GCS_COMPONENT), (0, 0))
