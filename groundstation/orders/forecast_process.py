"""A process that computes forecasts; the console's own process only waits for the result.

Requests and results are pickled between a parent and the child that it started itself, each behind
its length. The child answers one request after the other and ends with its input, so that none is
left behind whatever happens to the parent.

This is no process pool of the standard library, for two measured reasons (Python 3.11): its workers
cannot be cancelled, so a new forecast waits for the old one to end, and a worker lives on when its
parent is killed.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import signal
import struct
import sys
from collections.abc import Mapping

from groundstation.orders.forecast import Forecast, Leg, forecast
from onboard.config.fleet import FleetConfig
from onboard.rollout import batch

_LENGTH = struct.Struct("<I")
_NICENESS = 10
_LIMIT_S = 120.0  # the very first start on a machine compiles for half a minute of a processor


class ForecastFailed(RuntimeError):
    """No forecast could be computed: a sentence with the reason."""


class Forecaster:
    """Sends requests to the child; starts it for the first request, and again when it has ended."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._turn = asyncio.Lock()  # one request at a time

    @property
    def pid(self) -> int | None:
        """Process id of the child; None when there is none."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start the child ahead of the first request: its imports take a second."""
        async with self._turn:
            await self._started()

    async def forecast(
        self, fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False
    ) -> Forecast:
        """Compute a forecast in the child.

        A cancellation kills the child, and the next request starts anew.

        Args:
            fleet: the fleet file.
            legs: of all vehicles with a known position.
            is_takeoff: whether the order is a take-off.

        Returns:
            As :func:`groundstation.orders.forecast.forecast`.

        Raises:
            ForecastFailed: the child ended or did not answer.
        """
        request = pickle.dumps((fleet, dict(legs), is_takeoff))

        async with self._turn:
            process = await self._started()
            is_answered = False
            try:
                answer = await _answer_of(process, request)
                is_answered = True
            except (OSError, EOFError, TimeoutError) as error:
                raise ForecastFailed(
                    f"The forecast could not be computed ({type(error).__name__}). Try again, or "
                    "start the console with --no-preview and watch closely."
                ) from None
            finally:
                if not is_answered:
                    self._kill()

        if isinstance(answer, str):
            raise ForecastFailed(f"The forecast could not be computed: {answer}")
        assert isinstance(answer, Forecast)
        return answer

    async def stop(self) -> None:
        """End the child; a second call does nothing."""
        process = self._process
        self._kill()
        if process is not None:
            await process.wait()

    async def _started(self) -> asyncio.subprocess.Process:
        """Return the child, started anew where it has ended."""
        if self._process is not None and self._process.returncode is None:
            return self._process

        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "groundstation.orders.forecast_process",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,  # the terminal is the console's
            start_new_session=True,  # a Ctrl-C at the terminal is the console's, too
        )
        return self._process

    def _kill(self) -> None:
        process = self._process
        self._process = None
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()


async def _answer_of(process: asyncio.subprocess.Process, request: bytes) -> object:
    """Send a request to the child and return its answer.

    Raises:
        OSError, EOFError, TimeoutError: the child ended or did not answer.
    """
    assert process.stdin is not None
    assert process.stdout is not None

    process.stdin.write(_LENGTH.pack(len(request)) + request)
    async with asyncio.timeout(_LIMIT_S):
        (length,) = _LENGTH.unpack(await process.stdout.readexactly(_LENGTH.size))
        return pickle.loads(await process.stdout.readexactly(length))


def main() -> int:
    """Answer requests until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICENESS)
    batch.warm_up()

    source = sys.stdin.buffer
    sink = sys.stdout.buffer
    while True:
        head = source.read(_LENGTH.size)
        if len(head) < _LENGTH.size:
            return 0
        (length,) = _LENGTH.unpack(head)
        fleet, legs, is_takeoff = pickle.loads(source.read(length))

        answer: Forecast | str
        try:
            answer = forecast(fleet, legs, is_takeoff=is_takeoff)
        except (ArithmeticError, ValueError, IndexError) as error:
            answer = f"{type(error).__name__}: {error}"

        data = pickle.dumps(answer)
        sink.write(_LENGTH.pack(len(data)) + data)
        sink.flush()


if __name__ == "__main__":
    raise SystemExit(main())
