"""An asyncio event loop in simulated time: instead of waiting, it advances the simulation.

The ground's mission runner and its client are asyncio code. In this loop they run unchanged, in one
thread and always in the same order. ``sleep`` and timeouts count simulated time, and functions for
an executor run at once.
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from typing import Any

# The loop raises an error after this simulated time without a callback. No flight waits that long,
# so a coroutine must be waiting for something that never happens.
_LONGEST_WAIT_S = 3600.0
# A coroutine that polls with ``asyncio.sleep(0)`` waits for no time. After this number of rounds of
# the loop without a step of the simulation, it advances by one; nothing else takes as many.
_MAX_ROUNDS = 1000


class StalledError(RuntimeError):
    """All coroutines wait, and nothing that could wake one of them is planned."""


class VirtualLoop(asyncio.BaseEventLoop):
    """An event loop whose clock is the simulation's.

    Args:
        now_ns: returns the simulated time.
        advance: advances the simulation by one step; it may call ``call_soon_threadsafe``.
    """

    def __init__(self, now_ns: Callable[[], int], advance: Callable[[], None]) -> None:
        super().__init__()
        self._now_ns = now_ns
        self._advance = advance
        self._is_woken = False
        self._stands_until_s = 0.0
        self._rounds = 0  # since the last step of the simulation
        self._selector = self  # BaseEventLoop asks its selector to wait until something happens

    def time(self) -> float:
        """Return simulated seconds."""
        return self._now_ns() * 1e-9

    def stand_still(self, duration_s: float) -> None:
        """Run no callbacks for a time while the simulation goes on, like a stopped process."""
        self._stands_until_s = max(self._stands_until_s, self.time() + duration_s)

    def select(self, timeout_s: float | None) -> list[Any]:
        """Advance the simulation until a timer is due or a step of it has scheduled a callback.

        While callbacks are due, it advances only after many rounds of them.
        """
        before_ns = self._now_ns()
        self._rounds += 1
        if timeout_s is None or timeout_s > 0.0:
            self._wait(timeout_s)
        elif self._rounds > _MAX_ROUNDS:
            self._advance()

        while self.time() < self._stands_until_s:
            self._advance()
        if self._now_ns() > before_ns:
            self._rounds = 0
        return []

    def _wait(self, timeout_s: float | None) -> None:
        longest_s = timeout_s
        if longest_s is None:
            longest_s = _LONGEST_WAIT_S
        end_s = self.time() + longest_s

        self._is_woken = False
        while not self._is_woken and self.time() < end_s:
            self._advance()

        if timeout_s is None and not self._is_woken:
            raise StalledError(f"Nothing happened for {_LONGEST_WAIT_S:.0f} s of simulated time.")

    def call_soon(  # type: ignore[override]
        self, callback: Callable[..., object], *args: Any, context: Any = None
    ) -> asyncio.Handle:
        """Schedule a callback, as asyncio does; simulation steps may call this too."""
        self._is_woken = True
        return super().call_soon(callback, *args, context=context)

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Any], *args: Any
    ) -> asyncio.Future[Any]:
        """Run a function now, or start it as a task if it is a coroutine function.

        The simulation cannot advance while a function runs. A function that waits for the
        simulation therefore has to be a coroutine function.
        """
        result = func(*args)
        if inspect.iscoroutine(result):
            return self.create_task(result)

        future = self.create_future()
        future.set_result(result)
        return future

    def _process_events(self, event_list: list[Any]) -> None:
        """Do nothing, because there are no sockets."""

    def _write_to_self(self) -> None:
        self._is_woken = True
