"""Waits that count only the time in which this ground was scheduled.

On a computer that is too busy, the event loop and the threads of the bus wake up late. A message
that has not arrived then may still have been sent in time. So a wait is divided into short sleeps,
and the time that a sleep takes beyond its length does not count.
"""

from __future__ import annotations

import asyncio
import contextlib

_SLEEP_S = 0.1
_LATE_S = 0.05  # lateness of a sleep that still counts; an idle computer needs 1 to 5 ms
_NOTHING_S = 1e-6  # remaining wait that is only a rounding error
LONGEST_LATE_S = 6.0  # time of one wait that is not counted, at most; after it all time counts


async def wait_scheduled(event: asyncio.Event, limit_s: float) -> float:
    """Wait until an event is set, at most for a time in which this ground was scheduled.

    Args:
        event: event to wait for.
        limit_s: longest wait [s], without the time in which this ground was not scheduled.

    Returns:
        Time in which this ground was not scheduled [s].
    """
    loop = asyncio.get_running_loop()
    left_s = limit_s
    late_s = 0.0

    while left_s > _NOTHING_S and not event.is_set():
        begin_s = loop.time()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(left_s, _SLEEP_S)):
                await event.wait()

        slept_s = loop.time() - begin_s
        overslept_s = slept_s - min(left_s, _SLEEP_S)
        counted_s = slept_s
        if overslept_s > _LATE_S and late_s < LONGEST_LATE_S:
            late_s += overslept_s
            counted_s = slept_s - overslept_s
        left_s -= counted_s
    return late_s
