"""Settings of the process that keep delays out of the control loop.

Python's collector runs on the ground only. Log lines are written by a thread of their own, since
the reader may hang. Python's lock changes hands quickly. On a drone's own computer the loop's
thread may take precedence.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import logging
import logging.handlers
import os
import queue
import resource
import signal
import stat
import sys
import threading

from onboard.plain_text import PlainStream

_MAX_LINES = 2000
# Who waits for Python's lock gets it within this time: longer than a tick takes, so that the tick
# need not hand it over to a callback halfway and wait for a thread that has no precedence; short
# beside the period, whoever else computes.
_SWITCH_S = 0.002
_REALTIME_PRIORITY, _HELPERS_PRIORITY = 10, 5
_LEAST_FREE_BYTES = 50_000_000
_HUNG_US = 1_000_000  # of computing without a pause; the control loop pauses in each tick


class _Lines(logging.handlers.QueueHandler):
    """Hands records over; what does not fit is dropped, because the writer hangs already."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def log_elsewhere(name: str, level: str) -> logging.handlers.QueueListener:
    """Log to stderr from a thread of its own; ``stop()`` of what is returned writes what is left."""
    lines: queue.Queue[logging.LogRecord] = queue.Queue(_MAX_LINES)
    writer = logging.StreamHandler(PlainStream(sys.stderr))
    writer.setFormatter(logging.Formatter(f"%(asctime)s {name} %(levelname)s %(message)s"))
    listener = logging.handlers.QueueListener(lines, writer)
    handed_over = _Lines(lines)
    handed_over.setFormatter(logging.Formatter("%(message)s"))  # the writer adds the rest
    logging.basicConfig(level=level, handlers=[handed_over], force=True)
    listener.start()
    return listener


def settle() -> None:
    """After everything is loaded: collect once, never look at what is there now again, and never
    collect unasked.

    A collection in flight would cost ticks; without one only what refers to itself stays, which the
    agent's code does not make tick by tick. :func:`tidy` collects while nothing flies.
    """
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    gc.disable()


def tidy() -> None:
    """Collect what has come since :func:`settle`; for the ground."""
    gc.collect()


def is_disk_full() -> bool:
    """Whether the disk that our log goes to, or else the working directory's, has no room left."""
    try:
        is_file = stat.S_ISREG(os.fstat(2).st_mode)
        disk = os.statvfs(2 if is_file else ".")
    except OSError:
        return False
    return disk.f_bavail * disk.f_frsize < _LEAST_FREE_BYTES


def take_precedence() -> str:
    """Let the calling thread run before everything else on this machine; return a sentence about
    whether it may.

    The other threads that there are come next: one that has Python's lock and waits for a processor
    holds up the loop, however first that is. Threads that start from now on do not: what they do
    may wait.
    """
    try:
        for thread in {int(name) for name in os.listdir("/proc/self/task")} - {
            threading.get_native_id()
        }:
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(_HELPERS_PRIORITY))
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_REALTIME_PRIORITY))
    except (OSError, AttributeError) as error:
        return f"The loop runs without real-time priority ({error}): allow it with LimitRTPRIO={_REALTIME_PRIORITY}."
    return f"The loop runs with real-time priority {_REALTIME_PRIORITY}."


def end_when_hung() -> None:
    """Let the kernel end this process once a thread that has precedence computes for a second
    without a pause.

    Somebody's own law that never returns would take a processor from everybody else on this
    machine, for instance from the emulator. Where it was is written to stderr.
    """
    with contextlib.suppress(OSError, ValueError, AttributeError):  # only Linux has this limit
        faulthandler.register(signal.SIGXCPU, all_threads=False, chain=True)
        _, highest = resource.getrlimit(resource.RLIMIT_RTTIME)
        resource.setrlimit(resource.RLIMIT_RTTIME, (_HUNG_US, highest))
