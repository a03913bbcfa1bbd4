"""Flies the units of the map, in several processes or on a Dask cluster.

Each unit is kept in the file of results as soon as it is flown, so a run can be interrupted at any
time. If the processes or the cluster are lost, the units that they were flying are flown again.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from typing import Any

from onboard.config.fleet import ConfigError
from onboard.rollout import batch as rollout_batch
from sitl.monte_carlo.law_map import unit_flights
from sitl.monte_carlo.law_map.cells import STAGES, Cell, Unit
from sitl.monte_carlo.law_map.results_file import ResultsFile

Say = Callable[[str], None]
_SAY_EVERY_S = 5.0
_LOST = (BrokenExecutor, CancelledError, OSError)  # errors that mean the executor itself is gone
_WORKERS_S = 15.0  # longest wait for the first worker of a cluster
_ANSWER_S = 180.0  # longest wait until all workers have compiled the law


def say(sentence: str) -> None:
    """Print a sentence of progress on standard error."""
    print(f"covey: {sentence}", file=sys.stderr, flush=True)


def has_failed(cell: Cell, file: ResultsFile) -> bool:
    """Return whether vehicles have come too near to each other in any stage of a cell."""
    for stage in range(len(STAGES)):
        row = file.rows.get((cell.key, stage))
        if row is not None and row["below"]:
            return True
    return False


def missing(cells: Iterable[Cell], stages: int, file: ResultsFile) -> list[Unit]:
    """Return the units that are still to be flown, in the order in which they are flown.

    The screening of all cells comes first, then the further stages cell by cell. Nothing more is
    flown in a cell that has failed.
    """
    screenings = []
    further = []
    for cell in cells:
        if has_failed(cell, file):
            continue
        for stage in range(stages):
            if (cell.key, stage) in file.rows:
                continue
            if stage == 0:
                screenings.append(Unit(cell, stage))
            else:
                further.append(Unit(cell, stage))
    return screenings + further


def run(
    cells: list[Cell],
    file: ResultsFile,
    *,
    stages: int,
    jobs: int = 1,
    scheduler: str | None = None,
    tell: Say = say,
) -> None:
    """Fly the missing units of the map, and keep each of them when it is done.

    Args:
        cells: cells of the map.
        file: file of results.
        stages: number of stages to fly, from the first on.
        jobs: number of processes on this machine.
        scheduler: address of a Dask scheduler, whose workers fly instead of these processes.
        tell: called with each sentence of progress.

    Raises:
        ConfigError: the scheduler does not answer, or the package for it is missing.
    """
    progress = _MapProgress(cells, stages, file, tell)
    executors = _executors(jobs, scheduler, tell)
    executor, width = next(executors)

    while missing(cells, stages, file):
        try:
            for row in _flown(executor, width, cells, stages, file):
                file.add(row)
                progress.tell()
        except BaseException as error:
            _stop(executor)
            if not _has_lost_executor(error, scheduler):
                raise
            tell(
                f"{_reason(error, scheduler)} what was in the air is flown again; "
                "nothing counts twice"
            )
            executor, width = next(executors)
            scheduler = None

    executor.shutdown()
    progress.tell(is_last=True)


def _flown(
    executor: Executor, width: int, cells: list[Cell], stages: int, file: ResultsFile
) -> Iterator[unit_flights.MapRow]:
    """Yield each row when its unit is flown; the caller keeps it before it asks for the next.

    At most ``width`` units are flown at the same time, and only one stage of a cell, because a
    stage is flown only if the one before it has not failed.
    """
    pending: dict[Future[unit_flights.MapRow], Unit] = {}
    while True:
        under_way = {unit.cell for unit in pending.values()}
        for unit in missing(cells, stages, file):
            if len(pending) >= width:
                break
            if unit.cell not in under_way:
                pending[executor.submit(unit_flights.fly, unit)] = unit
                under_way.add(unit.cell)

        if not pending:
            return
        for future in wait(pending, return_when=FIRST_COMPLETED).done:
            del pending[future]
            yield future.result()


def _stop(executor: Executor) -> None:
    """Stop an executor; errors of a cluster that is gone are ignored."""
    if isinstance(executor, ProcessPoolExecutor):
        executor.shutdown(wait=False, cancel_futures=True)
    else:
        with contextlib.suppress(Exception):
            executor.shutdown(wait=False)


def _has_lost_executor(error: BaseException, scheduler: str | None) -> bool:
    """Return whether an error means that the executor is lost, so that another one can go on."""
    if isinstance(error, ConfigError):
        return False
    if isinstance(error, _LOST):
        return True
    # a cluster that is lost can raise any exception
    return scheduler is not None and isinstance(error, Exception)


def _reason(error: BaseException, scheduler: str | None) -> str:
    """Return why flights were lost, as the first half of a sentence."""
    if scheduler is None:
        return "a process of the map has ended before its time (out of memory?);"

    loss = "has lost its workers"
    if isinstance(error, _LOST):
        loss = "is gone"
    return (
        f"the scheduler at {scheduler} {loss} ({type(error).__name__}); "
        "the map goes on with processes here, and"
    )


# The executors


def _executors(jobs: int, scheduler: str | None, tell: Say) -> Iterator[tuple[Executor, int]]:
    """Yield an executor, and how many units it flies at a time.

    The next one is taken when the one before it is lost.

    Raises:
        ConfigError: the last one is lost, too.
    """
    if scheduler is not None:
        yield _cluster(scheduler)

    tell("compiling the law for this machine, if that was not done before")
    rollout_batch.warm_up()
    if jobs == 1:
        yield _SameProcess(), 1
    for _ in range(3):
        spawn = multiprocessing.get_context("spawn")
        yield ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_end_with_parent), jobs

    raise ConfigError(
        "three times a process of the map has ended before its time. Fly with fewer --jobs."
    )


class _SameProcess(Executor):
    """Runs each function in this process, at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function and return its result, or its exception, as a future that is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 raised when the result is read, as by executors
            future.set_exception(error)
        return future


def _end_with_parent() -> None:
    """Let this worker process end when its parent process is killed.

    Otherwise it would wait for work for ever.
    """

    def _watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=_watch, daemon=True).start()


def _cluster(address: str) -> tuple[Executor, int]:
    """Return an executor on a Dask cluster, and how many units it flies at a time.

    Raises:
        ConfigError: the package is missing, no scheduler answers, or its workers cannot fly, or fly
            another version.
    """
    try:
        import distributed
    except ModuleNotFoundError:
        raise ConfigError(
            f"--scheduler {address}: this needs the package 'distributed', which is not installed. "
            "Install it here and on the workers: pip install distributed"
        ) from None

    # hides its tracebacks, because the errors below say in words what is wrong
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client: Any = distributed.Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"--scheduler {address}: no Dask scheduler answers there ({error}). Start one with "
            "'dask scheduler', or leave the option out to fly on this machine."
        ) from None

    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
        tasks = []
        for worker in client.ncores():
            tasks.append(client.submit(unit_flights.version, workers=[worker], pure=False))
        distributed.wait(tasks, timeout=_ANSWER_S)
        others = {*client.gather(tasks)} - {unit_flights.version()}
    except Exception as error:  # noqa: BLE001 a worker can raise any exception
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ConfigError(
            f"--scheduler {address}: its workers cannot fly ({reason}). Start them with "
            f"'dask worker {address}', with Covey of this version installed where they run."
        ) from None

    if others:
        raise ConfigError(
            f"--scheduler {address}: a worker flies version {', '.join(sorted(others))} of law, "
            f"vehicles or processor, and here it is {unit_flights.version()}: such flights are not "
            "added up. Install the same there."
        )

    executor: Executor = client.get_executor(pure=False)
    cores = sum(client.ncores().values())
    return executor, 2 * max(1, cores)  # one unit flies on each core, and one waits


class _MapProgress:
    """Reports now and then how much of the map is flown, and how much time is left."""

    def __init__(self, cells: list[Cell], stages: int, file: ResultsFile, tell: Say) -> None:
        self._cells = cells
        self._stages = stages
        self._file = file
        self._tell = tell
        self._began_s = time.monotonic()
        self._last_said_s = self._began_s
        self._work_at_first = self._work_left()

    def _work_left(self) -> float:
        """Return the work (flights times weight) that is left if no further cell fails."""
        units = missing(self._cells, self._stages, self._file)
        return sum(unit.flights * unit.cell.weight for unit in units)

    def tell(self, *, is_last: bool = False) -> None:
        """Report the progress, unless the last report is less than some seconds old."""
        now_s = time.monotonic()
        if not is_last and now_s - self._last_said_s < _SAY_EVERY_S:
            return
        self._last_said_s = now_s

        rows = self._file.rows
        failed = sum(1 for cell in self._cells if has_failed(cell, self._file))
        complete = sum(1 for cell in self._cells if (cell.key, self._stages - 1) in rows)
        flown = sum(row["flights"] for row in rows.values())

        work_left = self._work_left()
        work_done = self._work_at_first - work_left
        left_s = 0.0
        if work_done > 0.0:
            left_s = (now_s - self._began_s) * work_left / work_done

        sentence = (
            f"law map: {complete + failed} of {len(self._cells)} cells done ({failed} failed), "
            f"{flown} flights"
        )
        if work_left:
            sentence += f", at most {left_s / 60.0:.0f} min left"
        self._tell(sentence)
