"""Interruption of Python missions that block: ``time.sleep`` in a mission holds up the event loop
and its signals.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_ROOT = os.path.realpath(Path(__file__).parents[2]) + os.sep
# signals that the loop hears within this time are one: it was blocked when they came
_TOGETHER_S = 0.3


def listen(mission_path: str, on_signal: Callable[[], None]) -> None:
    """Call a function on the event loop for each signal, and end a mission's own code that blocks
    the loop.

    Args:
        mission_path: file of the mission. Its code ends as if its task was cancelled, so that
            vehicles land at once.
        on_signal: called on the running event loop; once for signals that came while it was
            blocked.
    """
    loop = asyncio.get_running_loop()
    last_s, path = [float("-inf")], os.path.realpath(mission_path)

    def hear() -> None:
        now_s = time.monotonic()
        if now_s - last_s[0] > _TOGETHER_S:
            last_s[0] = now_s
            on_signal()

    def end_blocking(_: int, frame: FrameType | None) -> None:
        while frame is not None and not frame.f_code.co_filename.startswith(_ROOT):
            if os.path.realpath(frame.f_code.co_filename) == path:
                raise asyncio.CancelledError
            frame = frame.f_back

    for number in SIGNALS:
        loop.add_signal_handler(number, hear)
        # runs between two steps of Python; the loop hears of the signal as well
        signal.signal(number, end_blocking)


def listen_no_more() -> None:
    """Leave the signals as they were."""
    loop = asyncio.get_running_loop()
    for number in SIGNALS:
        loop.remove_signal_handler(number)
