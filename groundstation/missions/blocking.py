"""A fleet for plain scripts and notebooks: the verbs of :class:`Fleet` without ``await``.

The asynchronous fleet runs in the event loop of its host. For real vehicles this loop has a thread
of its own; in lockstep it runs in simulated time. Each call from the script hands a coroutine to
that loop and waits for its result.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import inspect
import signal
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from groundstation.missions.api import AtEnd, Fleet
from groundstation.missions.connection import (
    Host,
    check_first_connection,
    close_at_end,
    host_of,
)
from groundstation.missions.group import Group
from onboard.config.fleet import FleetConfig
from onboard.end_signals import termination_signals

FleetFile = FleetConfig | str | Path | None
T = TypeVar("T")


class _Blocking:
    """Wraps a fleet or a group: a call of a coroutine method returns after the coroutine's end."""

    def __init__(self, host: Host, target: Group) -> None:
        self._host = host
        self._target = target

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._target, name)
        if not callable(value):
            return value

        @functools.wraps(value)
        def call(*args: Any, **options: Any) -> Any:
            result = value(*args, **options)
            if inspect.iscoroutine(result):
                return self._host.call(result)
            if isinstance(result, Group):
                return _Blocking(self._host, result)
            return result

        return call


class BlockingFleet(_Blocking):
    """All vehicles of a fleet, for scripts without coroutines.

    Every verb of :class:`Fleet` blocks until its end. Use it as
    ``with BlockingFleet("fleet.toml") as fleet: fleet.takeoff(1.0)``. Without ``with``, the
    connection is closed at the end of the program.

    Args:
        fleet: a fleet file or its path; None: the fleet of ``covey fly script``.
        at_end: state in which the end of the connection leaves vehicles that still fly.
        ready_timeout_s: longest wait for the vehicles [s]; 0: no wait; None: the host decides.

    Raises:
        ConfigError: no fleet file, or a wrong one; a state at the end that does not exist; or the
            second connection of a script that has a verdict.
        NotReady: a vehicle is not ready in time.
    """

    _target: Fleet

    def __init__(
        self,
        fleet: FleetFile = None,
        *,
        at_end: AtEnd = "land",
        ready_timeout_s: float | None = None,
    ) -> None:
        check_first_connection()  # before this one would be closed at the end
        host = host_of(fleet)
        # `close` needs these already while the fleet waits for its vehicles.
        self._host = host
        self._is_connected = False
        self._end: asyncio.Event | None = None  # set to end the connection
        self._task: asyncio.Task[None] | None = None  # holds the connection open
        self._is_open = True

        close_at_end(self.close)
        _turn_signals_into_exceptions()
        super().__init__(host, host.call(self._begin(fleet, at_end, ready_timeout_s)))
        self._is_connected = True

    def __getitem__(self, name: str) -> Any:
        return _Blocking(self._host, self._target[name])

    def __enter__(self) -> BlockingFleet:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def run(self, function: Callable[[Fleet], Coroutine[Any, Any, T]]) -> T:
        """Run a coroutine function with the fleet, for things that happen at the same time.

        Args:
            function: function that receives the :class:`Fleet`.

        Returns:
            The result of the function.
        """
        return self._host.call(function(self._target))

    def close(self) -> None:
        """Leave the fleet in the declared state and close the connection.

        A second call does nothing.
        """
        if self._is_open and self._task is not None:
            self._is_open = False
            self._host.call(self._finish())
            self._host.end_calls()

    async def _begin(self, fleet: FleetFile, at_end: AtEnd, ready_timeout_s: float | None) -> Fleet:
        """Open the connection in a separate task, which holds it open until the end."""
        ready: asyncio.Future[Fleet] = asyncio.get_running_loop().create_future()
        end = asyncio.Event()
        self._end = end

        async def hold_open() -> None:
            try:
                async with Fleet.connect(
                    fleet, at_end=at_end, ready_timeout_s=ready_timeout_s
                ) as opened:
                    ready.set_result(opened)
                    await end.wait()
            except Exception as error:
                if ready.done():
                    raise
                ready.set_exception(error)

        self._task = asyncio.create_task(hold_open())
        return await ready

    async def _finish(self) -> None:
        if self._end is None or self._task is None:
            return
        if self._is_connected:
            self._end.set()
            await self._task
            return

        # The connection still waits for its vehicles.
        self._task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._task


def _turn_signals_into_exceptions() -> None:
    """Let SIGTERM and SIGHUP end the program as an exception does.

    Then the fleet is left in the declared state.
    """
    try:
        for signal_number in termination_signals():
            if signal.getsignal(signal_number) is signal.SIG_DFL:
                # 128 + number is the exit code of a program that a signal has ended
                signal.signal(signal_number, lambda number, _: sys.exit(128 + number))
    except ValueError:
        return  # not the main thread, which alone may set signal handlers
