"""A thread for work that may wait, with a queue of limited length."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

MAX_WAITING = 200  # largest number of calls, including the running one

log = logging.getLogger("covey.agent")


class BackgroundQueue:
    """One thread that executes the submitted calls one by one.

    :meth:`submit` never blocks. If too many calls are already waiting, the new call is dropped and
    counted.

    Args:
        name: name of the thread.
        most: largest number of waiting calls, including the running one.
    """

    def __init__(self, name: str, most: int = MAX_WAITING) -> None:
        self.dropped = 0  # number of dropped calls
        self._room = threading.BoundedSemaphore(most)  # counts the calls that may still be added
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=name)

    def submit(self, function: Callable[..., object], *args: Any) -> bool:
        """Call ``function(*args)`` soon. Return False if it is dropped because too many calls are
        waiting.
        """
        if not self._room.acquire(blocking=False):
            self.dropped += 1
            if self.dropped == 1:
                log.warning("too much waits to be sent on the bus: what comes now is dropped")
            return False

        self._worker.submit(function, *args).add_done_callback(self._done)
        return True

    def stop(self) -> None:
        """Execute the waiting calls, and end the thread. A second call does nothing."""
        self._worker.shutdown(wait=True)

    def _done(self, work: Future[object]) -> None:
        """Make room after a call, and log its exception."""
        self._room.release()
        error = work.exception()
        if error is not None:
            log.error("left undone: %s: %s", type(error).__name__, error)
