"""Processes that fly simulated flights for this one, and end with it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from onboard.config.config_error import ConfigError


def new_pool(jobs: int) -> ProcessPoolExecutor:
    """Return a pool of this number of processes, which end even if this process is killed."""
    # spawned, not forked, because the threads of compiled code do not survive a fork
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_end_with_parent)


@contextlib.contextmanager
def worker_pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool; an error or an interrupt drops what has not begun.

    Args:
        jobs: number of processes.

    Raises:
        ConfigError: a process has ended before its time.
    """
    with new_pool(jobs) as pool:
        try:
            yield pool
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, BrokenProcessPool):
                raise ConfigError(
                    "A process has ended before its time (out of memory?). Fly with fewer --jobs."
                ) from None
            raise


def _end_with_parent() -> None:
    """Let this worker process end when its parent is killed, instead of waiting forever."""

    def _watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=_watch, daemon=True).start()
