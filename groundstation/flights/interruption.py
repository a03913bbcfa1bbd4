"""Interrupts a flight by signals, even if a Python mission blocks the event loop.

``time.sleep`` in a mission blocks the loop, and with it the loop's signal handlers. So each signal
is handled twice. asyncio's handler runs as soon as the loop is free. Python's own handler runs
between two steps of the interpreter, wherever it is. If code of the mission's file is running at
that moment, the handler ends it as if its task were cancelled.

A loop that calls this project all the time, or that catches every exception, goes on all the same.
Then only the end of the process helps, which a later signal brings.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from onboard.end_signals import end_signals

# Folders of this project's code. A mission may lie beside them, in the same clone.
_PACKAGES = tuple(
    os.path.realpath(Path(__file__).parents[2] / name) + os.sep
    for name in ("groundstation", "onboard", "sitl")
)
# Signals that the loop handles within this time count as one, because they may have arrived while
# it was blocked.
_TOGETHER_S = 0.3
# A loop that has not handled a signal for this time is blocked for good: a healthy one takes some
# milliseconds, on a busy computer tenths of a second.
_BLOCKED_S = 1.0


def listen(
    mission_path: str, on_signal: Callable[[], None], on_blocked: Callable[[], None] | None = None
) -> None:
    """Call a function on the event loop for each signal, and end a mission that blocks the loop.

    Args:
        mission_path: path of the mission. Its code ends as if its task were cancelled, so that
            vehicles land at once.
        on_signal: called on the running event loop; only once for all signals that arrive while
            the loop is blocked.
        on_blocked: called between two steps of the interpreter for a signal that comes while the
            loop has not handled an earlier one for a second; None: such a signal is like the first.
    """
    loop = asyncio.get_running_loop()
    mission_file = os.path.realpath(mission_path)
    last_signal_s = float("-inf")
    waiting_since_s: float | None = None  # time of the first signal that the loop has not handled

    def handle_on_loop() -> None:
        nonlocal last_signal_s, waiting_since_s
        waiting_since_s = None
        now_s = time.monotonic()
        if now_s - last_signal_s > _TOGETHER_S:
            last_signal_s = now_s
            on_signal()

    def end_blocking_code(_: int, frame: FrameType | None) -> None:
        nonlocal waiting_since_s
        now_s = time.monotonic()
        if waiting_since_s is None:
            waiting_since_s = now_s
        elif on_blocked is not None and now_s - waiting_since_s > _BLOCKED_S:
            on_blocked()

        # Look at the calls from the innermost outwards, up to the first one of this project.
        while frame is not None:
            file = os.path.realpath(frame.f_code.co_filename)
            if file == mission_file:
                raise asyncio.CancelledError
            if file.startswith(_PACKAGES):
                return
            frame = frame.f_back

    for number in end_signals():
        loop.add_signal_handler(number, handle_on_loop)
        signal.signal(number, end_blocking_code)  # asyncio's own handler stays


def listen_no_more() -> None:
    """Remove the signal handlers."""
    loop = asyncio.get_running_loop()
    for number in end_signals():
        loop.remove_signal_handler(number)
