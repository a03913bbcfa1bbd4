"""Ends a process in which a Python mission has left a task that catches its own end.

asyncio waits for every task at its end, and a task such as ``while True: try: ... except: pass``
never ends. Python cannot end it either: also the deletion of its coroutine is an exception in it,
which it catches. So after the vehicles are down, the record is closed and the verdict is printed,
only the operating system can end the process.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from typing import NoReturn

_LONGEST_END_S = 1.0


async def end_other_tasks() -> bool:
    """Cancel all other tasks of this event loop; return whether they have ended."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    if not others:
        return True

    for task in others:
        task.cancel()
    _, stubborn = await asyncio.wait(others, timeout=_LONGEST_END_S)
    return not stubborn


def leave_process(status: int) -> NoReturn:
    """End this process at once, with all that it has printed, and wait for nothing.

    Args:
        status: exit status.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # nobody reads it any more
            stream.flush()
    os._exit(status)
