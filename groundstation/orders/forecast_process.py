"""Processes that compute forecasts; the console's own process only waits for the result.

Parent and child exchange pickled messages over the child's standard input and output; the length of
each message precedes it. A child answers one request after the other. It ends when its input ends,
so no child remains when the parent is killed.

There are two kinds of child. The compiled child flies an order ahead four times within half a
second, but it has to compile first. That takes seconds with numba's cache, and more than a minute
the first time on a machine. Until then the interpreted child answers: it runs the same functions
without compilation, and flies the order ahead once.

A process pool of the standard library is not used, because its workers cannot be cancelled, and
live on when their parent is killed.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import signal
import struct
import sys
from collections.abc import Mapping, Sequence

from groundstation.orders.forecast import SEEDS, Forecast, Leg, forecast
from onboard.config.fleet import FleetConfig
from onboard.rollout import batch

_LENGTH = struct.Struct("<I")  # length of a message, before the message itself
_NICENESS = 10
_LIMIT_S = 120.0  # longest wait for an answer
_INTERPRETED = "--interpreted"
_NO_NUMBA = {"COVEY_NUMBA": "0"}  # environment of the interpreted child; `batch` reads it


class ForecastFailed(RuntimeError):
    """No forecast could be computed: a sentence with the reason."""


class _Child:
    """One process that computes.

    Args:
        process: process that was just started; its first message says that it is ready to compute.
    """

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.is_ready = False
        self.is_computing = False
        self._becoming_ready = asyncio.create_task(self._await_ready())
        self._becoming_ready.add_done_callback(_retrieve_exception)

    @classmethod
    async def started(cls, *arguments: str, environment: Mapping[str, str]) -> _Child:
        """Start a child.

        Args:
            arguments: arguments of its command line.
            environment: variables besides those of this process.
        """
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "groundstation.orders.forecast_process",
            *arguments,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,  # the terminal is the console's
            start_new_session=True,  # a Ctrl-C at the terminal is the console's, too
            env={**os.environ, **environment},
        )
        return cls(process)

    @property
    def has_ended(self) -> bool:
        """Whether the process has ended."""
        return self.process.returncode is not None

    async def ready(self) -> None:
        """Wait until the child can compute.

        Raises:
            OSError, EOFError: the child has ended.
        """
        await asyncio.shield(self._becoming_ready)

    async def answer(self, request: bytes) -> object:
        """Wait until the child is ready, send it a request and return its answer.

        Raises:
            OSError, EOFError, TimeoutError: the child has ended or did not answer.
        """
        await self.ready()
        assert self.process.stdin is not None

        self.is_computing = True
        self.process.stdin.write(_LENGTH.pack(len(request)) + request)
        async with asyncio.timeout(_LIMIT_S):
            answer = await self._message()
        self.is_computing = False  # it stays True without an answer, and the child is then ended
        return answer

    def kill(self) -> None:
        """End the child; a second call does nothing."""
        self._becoming_ready.cancel()
        if not self.has_ended:
            with contextlib.suppress(ProcessLookupError):
                self.process.kill()

    async def _await_ready(self) -> None:
        await self._message()
        self.is_ready = True

    async def _message(self) -> object:
        assert self.process.stdout is not None
        (length,) = _LENGTH.unpack(await self.process.stdout.readexactly(_LENGTH.size))
        return pickle.loads(await self.process.stdout.readexactly(length))


class Forecaster:
    """Sends requests to its children, and starts them when they are needed."""

    def __init__(self) -> None:
        self._compiled: _Child | None = None
        self._interpreted: _Child | None = None  # exists while the other child compiles
        self._turn = asyncio.Lock()  # one request at a time

    @property
    def pid(self) -> int | None:
        """Process id of the child that computes with compiled code; None when there is none."""
        return None if self._compiled is None else self._compiled.process.pid

    async def start(self) -> None:
        """Start the compiled child ahead of the first request."""
        async with self._turn:
            await self._compiled_child()

    async def ready(self) -> None:
        """Wait until requests are answered by compiled code.

        Raises:
            OSError, EOFError: the child has ended.
        """
        async with self._turn:
            child = await self._compiled_child()
        await child.ready()

    async def forecast(
        self, fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False
    ) -> Forecast:
        """Compute a forecast in a child.

        A cancellation kills the child that computes; the next request starts a new one. A child
        that still compiles goes on.

        Args:
            fleet: the fleet file.
            legs: legs of all vehicles with a known position.
            is_takeoff: whether the order is a take-off.

        Returns:
            Result of :func:`groundstation.orders.forecast.forecast`.

        Raises:
            ForecastFailed: the children ended or did not answer.
        """
        request = pickle.dumps((fleet, dict(legs), is_takeoff))

        async with self._turn:
            try:
                child = await self._compiled_child()
                if child.is_ready:
                    answer = await child.answer(request)
                else:
                    answer = await self._first_answer(child, request)
            except (OSError, EOFError, TimeoutError) as error:
                raise ForecastFailed(
                    f"The forecast could not be computed ({type(error).__name__}). Try again, or "
                    "start the console with --no-preview and watch closely."
                ) from None
            finally:
                self._end_useless_children()

        if isinstance(answer, str):
            raise ForecastFailed(f"The forecast could not be computed: {answer}")
        assert isinstance(answer, Forecast)
        return answer

    async def stop(self) -> None:
        """End the children; a second call does nothing."""
        children = [child for child in (self._compiled, self._interpreted) if child is not None]
        self._compiled = None
        self._interpreted = None
        for child in children:
            child.kill()
            await child.process.wait()

    async def _compiled_child(self) -> _Child:
        """Return the compiled child; start it if there is none, or if it has ended."""
        if self._compiled is None or self._compiled.has_ended:
            self._compiled = await _Child.started(environment={})
        return self._compiled

    async def _first_answer(self, compiled: _Child, request: bytes) -> object:
        """Return the answer of the child that answers first, while the compiled one compiles.

        Raises:
            OSError, EOFError, TimeoutError: no child has answered.
        """
        if self._interpreted is None or self._interpreted.has_ended:
            self._interpreted = await _Child.started(_INTERPRETED, environment=_NO_NUMBA)

        answers = [
            asyncio.create_task(child.answer(request)) for child in (self._interpreted, compiled)
        ]
        try:
            # Wait for the first answer, or for the first failure.
            with contextlib.suppress(OSError, EOFError, TimeoutError):
                await next(iter(asyncio.as_completed(answers)))

            # If the compiled child has begun to compute in the meantime, wait for its answer, which
            # comes soon and is made of more flights.
            interpreted_answer, compiled_answer = answers
            has_answer = interpreted_answer.done() and interpreted_answer.exception() is None
            if has_answer and not compiled.is_computing:
                return interpreted_answer.result()

            with contextlib.suppress(OSError, EOFError, TimeoutError):
                return await compiled_answer
            return await interpreted_answer
        finally:
            for task in answers:
                task.cancel()

    def _end_useless_children(self) -> None:
        """End a child whose request was cancelled, and an interpreted child that is not needed."""
        compiled = self._compiled
        if compiled is not None and compiled.is_computing:
            compiled.kill()
            self._compiled = None

        interpreted = self._interpreted
        is_compilation_over = compiled is not None and compiled.is_ready
        if interpreted is not None and (interpreted.is_computing or is_compilation_over):
            interpreted.kill()
            self._interpreted = None


def _retrieve_exception(task: asyncio.Task[None]) -> None:
    """Retrieve the exception of a task, so that asyncio does not report it as never retrieved."""
    if not task.cancelled():
        task.exception()


def main() -> int:
    """Run a child: report that it is ready, then answer requests until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICENESS)

    seeds: Sequence[int] = SEEDS
    if _INTERPRETED in sys.argv[1:]:
        seeds = SEEDS[:1]
    else:
        batch.warm_up()
    _send("ready")

    source = sys.stdin.buffer
    while True:
        head = source.read(_LENGTH.size)
        if len(head) < _LENGTH.size:
            return 0
        (length,) = _LENGTH.unpack(head)
        fleet, legs, is_takeoff = pickle.loads(source.read(length))

        answer: Forecast | str
        try:
            answer = forecast(fleet, legs, is_takeoff=is_takeoff, seeds=seeds)
        except (ArithmeticError, ValueError, IndexError) as error:
            answer = f"{type(error).__name__}: {error}"
        _send(answer)


def _send(message: object) -> None:
    data = pickle.dumps(message)
    sys.stdout.buffer.write(_LENGTH.pack(len(data)) + data)
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    raise SystemExit(main())
