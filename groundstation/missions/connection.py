"""The flight that a script connects with.

A script connects with a host. By default the host is the real agents of the script's fleet.
``covey fly script`` and the lockstep fixture set another host. So the same script can fly in
simulated time, with emulated PX4s or with hardware.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import runpy
import sys
import threading
from collections.abc import AsyncIterator, Callable, Collection, Coroutine, Iterator, Sequence
from concurrent import futures
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any, NoReturn, Protocol, TypeVar

from groundstation.client.client import FleetClient
from groundstation.missions.lasting_output import cancelled_by_termination_signals, lasting_output
from groundstation.recording.channels import RECORDED
from groundstation.recording.writer import RecordEnd, RecordWriter
from groundstation.verdict.observations import FlightObservations
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet

READY_TIMEOUT_S = 30.0
# Why a coroutine cannot call a verb of a blocking fleet.
INSIDE_COROUTINE = (
    "its verbs wait, and a coroutine may not: nothing of the flight would go on meanwhile. In a "
    "function for fleet.run use the fleet that it gets, with await; in asyncio.run use "
    "Fleet.connect."
)
_THREAD_END_S = 5.0  # longest wait for the end of the thread of a blocking script
# Longest wait for the end of a call that is cancelled. A mission may catch its cancellation, and
# vehicles that follow another one hold before they end.
_CANCELLED_S = 3.0
T = TypeVar("T")


class Host(Protocol):
    """A flight that scripts connect with."""

    config: FleetConfig
    ready_timeout_s: float
    say: Callable[[str], None]
    flown: FlightObservations | None  # observations of the last script that has ended
    at_end: str  # state in which a script leaves vehicles that still fly

    def opened(self) -> AbstractAsyncContextManager[FleetClient]:
        """Open the ground's end of the bus."""

    def call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine of a blocking script to its end, in the flight's time."""

    def end_calls(self) -> None:
        """Stop what :meth:`call` has started; a second call of this method does nothing."""

    def end_record(self) -> RecordEnd | None:
        """Finish the record and return how it has ended; None if nothing was recorded."""


class _Script:
    """A script that :func:`run_script` runs, with a record and a verdict."""

    has_connected = False  # whether its first connection has begun

    def __init__(self) -> None:
        self.after_last_line: Callable[[], None] = lambda: None


_hosts: list[Host] = []  # hosts that have been set; the last one is in force
_scripts: list[_Script] = []  # scripts under way; the last one connects
_to_close: list[Callable[[], None]] = []  # connections of blocking scripts


def close_at_end(close: Callable[[], None]) -> None:
    """Register a connection to be closed at the end of the script, or of the program."""
    if not _to_close:
        atexit.register(close_all)
    _to_close.append(close)


def close_all() -> None:
    """Close the connections of blocking scripts that are still open."""
    while _to_close:
        close = _to_close.pop()
        close()


def call_after_last_line(function: Callable[[], None]) -> None:
    """Register a function to be called when the script that runs has come to its end by itself.

    It is not called after an exception or Ctrl-C, nor in a program that :func:`run_script` does not
    run.
    """
    if _scripts:
        _scripts[-1].after_last_line = function


def script_name() -> str:
    """Return the name of the program's script; "script" if it has none, as in a notebook."""
    path = Path(sys.argv[0])
    is_of_library = path.stem.startswith(("_", "ipykernel"))
    if path.suffix != ".py" or is_of_library:
        return "script"
    return path.stem


def run_script(path: str | Path, arguments: Sequence[str], host: Host) -> None:
    """Run a Python script that connects with a flight, as ``python PATH ARGUMENTS`` would.

    Args:
        path: path of the script.
        arguments: arguments for its ``sys.argv``.
        host: the flight.
    """
    former_argv = sys.argv
    former_sys_path = list(sys.path)
    script = _Script()
    _scripts.append(script)
    sys.argv = [str(path), *arguments]
    sys.path.insert(0, str(Path(path).resolve().parent))
    try:
        with hosted(host):
            try:
                _run_to_last_line(path)
                script.after_last_line()
            finally:
                close_all()
    finally:
        _scripts.remove(script)
        sys.argv = former_argv
        sys.path[:] = former_sys_path


def _run_to_last_line(path: str | Path) -> None:
    """Run a Python file; ``sys.exit()`` without a failure counts as its last line."""
    try:
        runpy.run_path(str(path), run_name="__main__")
    except SystemExit as end:
        if end.code not in (None, 0):
            raise


def check_first_connection() -> None:
    """Refuse a second connection of a script, whose record and verdict are of one.

    Raises:
        ConfigError: the script that runs has connected before.
    """
    if _scripts and _scripts[-1].has_connected:
        raise ConfigError(
            "The script has connected with its fleet before. Its record and its verdict are of one "
            "connection: fly everything in one block of Fleet.connect, or in several scripts."
        )


def note_connection() -> None:
    """Note that the connection of a script has begun."""
    if _scripts:
        _scripts[-1].has_connected = True


@contextlib.contextmanager
def hosted(host: Host) -> Iterator[None]:
    """Let scripts connect with this host while the block runs."""
    _hosts.append(host)
    try:
        yield
    finally:
        _hosts.remove(host)


def host_of(fleet: FleetConfig | str | Path | None) -> Host:
    """Return the host that has been set, or else a host for the real agents of a fleet.

    Args:
        fleet: a fleet file or its path; it is ignored when a host has been set.

    Raises:
        ConfigError: no host has been set, and no fleet is given.
    """
    if _hosts:
        return _hosts[-1]

    if fleet is None:
        raise ConfigError(
            'Which fleet? Name its file where the script connects, with fleet="FILE" in the '
            "parentheses, or start it with: covey fly script SCRIPT --fleet FILE"
        )
    if not isinstance(fleet, FleetConfig):
        fleet = load_fleet(fleet)
    return RealTime(fleet)


def refuse_call(coroutine: Coroutine[Any, Any, Any], why: str) -> NoReturn:
    """Refuse a call of a blocking script, of which nothing is done.

    Args:
        coroutine: what was to be run.
        why: why it cannot be run, and what to do, in sentences.

    Raises:
        ConfigError: always.
    """
    coroutine.close()  # otherwise Python warns that it was never awaited
    raise ConfigError(f"BlockingFleet: {why}")


class RealTime:
    """Host that connects with running agents over the bus.

    Args:
        config: the fleet file.
        folder: folder of the record; None: no record is written.
        ready_timeout_s: longest wait for the vehicles [s].
        say: function that receives each line of progress.
    """

    def __init__(
        self,
        config: FleetConfig,
        *,
        folder: Path | None = None,
        ready_timeout_s: float = READY_TIMEOUT_S,
        say: Callable[[str], None] = print,
    ) -> None:
        self.config = config
        self.folder = folder
        self.ready_timeout_s = ready_timeout_s
        self.say = say
        self.flown: FlightObservations | None = None
        self.at_end = "land"
        self._record: RecordWriter | None = None
        self._loop: asyncio.AbstractEventLoop | None = None  # event loop of a blocking script
        self._thread: threading.Thread | None = None  # thread of that event loop

    @contextlib.asynccontextmanager
    async def opened(self) -> AsyncIterator[FleetClient]:
        """Open the bus, and begin the record if a folder is set.

        SIGTERM and SIGHUP, of a terminal that closes, end the script as Ctrl-C does. Output that
        nobody reads any more ends nothing.
        """
        client = FleetClient(self.config, extra_topics=RECORDED if self.folder is not None else ())
        record = self._begin_record(client)
        self._record = record

        try:
            await client.start()
            client.announce_recording(record is not None and record.failure is None)
            with cancelled_by_termination_signals(), lasting_output():
                yield client
        finally:
            await client.stop()
            if record is not None:
                await asyncio.to_thread(record.stop)

    def _begin_record(self, client: FleetClient) -> RecordWriter | None:
        """Start the record of a client, and return it; return None without a folder."""
        if self.folder is None:
            return None

        record = RecordWriter(
            self.folder,
            on_failure=lambda sentence: client.publish_event("critical", "record_failed", sentence),
            on_warning=lambda sentence: client.publish_event("warning", "record_full", sentence),
        )
        record.start()
        client.add_sink(record.put)
        return record

    def call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine in the thread of the event loop, and return its result.

        The loop has a separate thread, so that it reads the bus even while the script computes.
        Ctrl-C, and an exception that a signal becomes, cancel the coroutine before they end the
        script: what it orders would otherwise go on while the end of the script lands vehicles.

        Raises:
            ConfigError: it is called in that thread, which would wait for itself; or the calls
                have been ended meanwhile.
        """
        if threading.current_thread() is self._thread:
            refuse_call(coroutine, INSIDE_COROUTINE)
        if self._loop is None:
            self._loop = _ThreadLoop()
            self._thread = threading.Thread(
                target=_run, args=(self._loop,), name="fleet", daemon=True
            )
            self._thread.start()

        tasks: list[asyncio.Task[Any]] = []

        async def run() -> T:
            task = asyncio.current_task()
            assert task is not None
            tasks.append(task)
            return await coroutine

        loop = self._loop
        try:
            return asyncio.run_coroutine_threadsafe(run(), loop).result()
        except futures.CancelledError as error:
            if self._loop is loop:
                raise
            raise ConfigError(
                "The script's flight has ended during this call, because its connection was "
                "closed. Let threads end before it."
            ) from error
        except BaseException:
            # A task that has failed needs no end, for which it would wait after `end_calls`. One
            # that a signal interrupts here may not have begun yet, and is in the list by then.
            has_ended = bool(tasks) and tasks[0].done()
            if not has_ended:
                asyncio.run_coroutine_threadsafe(_end(tasks), loop).result()
            raise

    def end_record(self) -> RecordEnd | None:
        """Return how the record has ended; None if nothing was recorded."""
        return None if self._record is None else self._record.end

    def end_calls(self) -> None:
        """End the calls of other threads, which would wait for ever, and the event loop's thread.

        A second call does nothing.
        """
        loop = self._loop
        thread = self._thread
        self._loop = None
        if loop is not None and thread is not None:
            asyncio.run_coroutine_threadsafe(_end_others(), loop).result()
            loop.call_soon_threadsafe(loop.stop)
            thread.join(_THREAD_END_S)


def _run(loop: asyncio.AbstractEventLoop) -> None:
    """Run an event loop until it is stopped, also after a coroutine has called ``sys.exit``."""
    while True:
        try:
            loop.run_forever()
        except SystemExit:
            continue  # asyncio passes it on to whoever waits for the coroutine, once the loop runs
        return


async def _end(tasks: Collection[asyncio.Task[Any]]) -> None:
    """Cancel tasks, and wait until they have ended, but not for long."""
    for task in tasks:
        task.cancel()
    if tasks:
        await asyncio.wait(tasks, timeout=_CANCELLED_S)


async def _end_others() -> None:
    """Cancel all other tasks of the event loop, and wait for their ends, but not for long."""
    await _end([task for task in asyncio.all_tasks() if task is not asyncio.current_task()])


class _ThreadLoop(asyncio.SelectorEventLoop):
    """An event loop that can still close the bus while the interpreter ends.

    At that time Python refuses to start a thread. The loop then runs the function by itself.
    """

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Any], *args: Any
    ) -> asyncio.Future[Any]:
        try:
            return super().run_in_executor(executor, func, *args)
        except RuntimeError:
            future = self.create_future()
            future.set_result(func(*args))
            return future
