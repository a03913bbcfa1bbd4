"""Flies units of work with several processes or a Dask cluster, and keeps each result at once.

A run can therefore be interrupted at any time. If the processes or the cluster are lost, the units
that they were flying are flown again.
"""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from typing import Any, Protocol, TypeVar

from onboard.config.fleet import ConfigError
from onboard.rollout import batch as rollout_batch
from sitl.monte_carlo.law_map import unit_flights
from sitl.worker_pool import new_pool

Say = Callable[[str], None]
Row = dict[str, Any]  # one line of a file of results
_LOST = (BrokenExecutor, CancelledError)  # errors that mean the executor itself is gone
_WORKERS_S = 15.0  # longest wait for the first worker of a cluster
_ANSWER_S = 180.0  # longest wait until all workers have compiled the law


class Work(Protocol):
    """A unit of work: some flights of one cell.

    The result of one unit can decide whether its cell needs another. Therefore only one unit of
    each cell is in progress at a time.
    """

    @property
    def cell(self) -> Hashable:
        """The cell, which stands for flights with equal settings, as one point of a map."""


W = TypeVar("W", bound=Work)


def say(sentence: str) -> None:
    """Print a sentence of progress on standard error."""
    print(f"covey: {sentence}", file=sys.stderr, flush=True)


def fly_missing(
    missing: Callable[[], Sequence[W]],
    fly: Callable[[W], Row],
    keep: Callable[[Row], None],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    has_own_law: bool = False,
    tell: Say = say,
) -> None:
    """Fly units until none is missing.

    Args:
        missing: returns the units that are still to be flown, in their order.
        fly: flies one unit and returns its row; with several processes it runs in one of them.
        keep: keeps the row of a unit; called in this process, one row at a time.
        jobs: number of processes on this machine.
        scheduler: address of a Dask scheduler, whose workers fly instead of these processes.
        has_own_law: whether vehicles fly by a user's own law.
        tell: called with each sentence about executors.

    Raises:
        ConfigError: the scheduler does not answer, or the package for it is missing.
    """
    executors = _executors(jobs, scheduler, tell, has_own_law=has_own_law)
    executor, width = next(executors)

    while missing():
        try:
            for row in _flown(executor, width, missing, fly):
                keep(row)
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


def _flown(
    executor: Executor, width: int, missing: Callable[[], Sequence[W]], fly: Callable[[W], Row]
) -> Iterator[Row]:
    """Yield the row of each unit as soon as it is flown.

    The caller keeps each row before it asks for the next one, so that ``missing`` knows of it. At
    most ``width`` units are under way at the same time, and only one of each cell.
    """
    pending: dict[Future[Row], W] = {}
    while True:
        under_way = {unit.cell for unit in pending.values()}
        for unit in missing():
            if len(pending) >= width:
                break
            if unit.cell not in under_way:
                pending[executor.submit(fly, unit)] = unit
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
    """Return whether an error means that the executor is lost, so that another can replace it."""
    if isinstance(error, ConfigError):
        return False
    if isinstance(error, _LOST):
        return True
    # a cluster that is lost can raise any exception
    return scheduler is not None and isinstance(error, Exception)


def _reason(error: BaseException, scheduler: str | None) -> str:
    """Return why flights were lost, as the first half of a sentence."""
    if scheduler is None:
        return "a process has ended before its time (out of memory?);"

    loss = "has lost its workers"
    if isinstance(error, (*_LOST, OSError)):
        loss = "is gone"
    return (
        f"the scheduler at {scheduler} {loss} ({type(error).__name__}); "
        "the work goes on with processes here, and"
    )


# The executors


def _executors(
    jobs: int, scheduler: str | None, tell: Say, *, has_own_law: bool
) -> Iterator[tuple[Executor, int]]:
    """Yield executors, each with the number of units that it flies at a time.

    The caller takes the next executor when the present one is lost.

    Raises:
        ConfigError: the last executor is lost, too.
    """
    if scheduler is not None:
        yield cluster(scheduler)

    tell("compiling the law for this machine, if that was not done before")
    rollout_batch.warm_up(has_own_law=has_own_law)
    if jobs == 1:
        yield _SameProcess(), 1
    for _ in range(3):
        yield new_pool(jobs), jobs

    raise ConfigError("three times a process has ended before its time. Fly with fewer --jobs.")


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


def cluster(address: str) -> tuple[Executor, int]:
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
