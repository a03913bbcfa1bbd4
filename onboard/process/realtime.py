"""Settings of the process that keep delays out of the control loop.

Python's collector runs on the ground only. Log lines are written by a thread of their own, because
whoever reads them may hang. Python's lock changes hands quickly. On a drone's own computer the
loop's thread may take precedence over everything else.
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

# Who waits for Python's lock gets it within this time. It is longer than a tick takes, so that a
# tick need not hand the lock over to a callback halfway and wait for a thread that has no
# precedence. It is short beside the period, whoever else computes.
_SWITCH_S = 0.002

_REALTIME_PRIORITY = 10
_HELPERS_PRIORITY = 5
_LEAST_FREE_BYTES = 50_000_000
_HUNG_US = 1_000_000  # of computing without a pause; the control loop pauses in each tick


class _Lines(logging.handlers.QueueHandler):
    """Hands records over; what does not fit is dropped, because the writer hangs already."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def log_elsewhere(name: str, level: str) -> logging.handlers.QueueListener:
    """Return a listener that writes the log to stderr from a thread of its own.

    Its ``stop()`` writes what is left.

    Args:
        name: of the vehicle, in each line.
        level: of the log.
    """
    writer = logging.StreamHandler(PlainStream(sys.stderr))
    writer.setFormatter(logging.Formatter(f"%(asctime)s {name} %(levelname)s %(message)s"))

    lines: queue.Queue[logging.LogRecord] = queue.Queue(_MAX_LINES)
    handed_over = _Lines(lines)
    handed_over.setFormatter(logging.Formatter("%(message)s"))  # the writer adds the rest
    logging.basicConfig(level=level, handlers=[handed_over], force=True)

    listener = logging.handlers.QueueListener(lines, writer)
    listener.start()
    return listener


def settle() -> None:
    """Collect once after everything is loaded, and never again unasked.

    A collection in flight would cost ticks. Without one only what refers to itself stays, which the
    agent's code does not make tick by tick. What is there now is never looked at again.
    :func:`tidy` collects the rest while nothing flies.
    """
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    gc.disable()


def tidy() -> None:
    """Collect what has come since :func:`settle`; for the ground."""
    gc.collect()


def is_disk_full() -> bool:
    """Return whether the disk that our log goes to has no room left.

    A log that is no file goes to no disk; then the one of the working directory counts.
    """
    try:
        is_file = stat.S_ISREG(os.fstat(2).st_mode)
        disk = os.statvfs(2 if is_file else ".")
    except OSError:
        return False
    return disk.f_bavail * disk.f_frsize < _LEAST_FREE_BYTES


def take_precedence() -> str:
    """Let the calling thread run before everything else here; return a sentence about the result.

    The other threads that there are come next: one that has Python's lock and waits for a processor
    holds up the loop, however first that is. Threads that start from now on do not: what they do
    may wait.
    """
    try:
        threads = {int(name) for name in os.listdir("/proc/self/task")}
        for thread in threads - {threading.get_native_id()}:
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(_HELPERS_PRIORITY))

        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_REALTIME_PRIORITY))
    except (OSError, AttributeError) as error:
        return (
            f"The loop runs without real-time priority ({error}): "
            f"allow it with LimitRTPRIO={_REALTIME_PRIORITY}."
        )
    return f"The loop runs with real-time priority {_REALTIME_PRIORITY}."


def end_when_hung() -> None:
    """Let the kernel end this process when a thread with precedence computes without a pause.

    Somebody's own law that never returns would take a processor from everybody else on this
    machine, for instance from the emulator. After a second the kernel ends the process; where the
    law was is written to stderr.
    """
    with contextlib.suppress(OSError, ValueError, AttributeError):  # only Linux has this limit
        faulthandler.register(signal.SIGXCPU, all_threads=False, chain=True)
        _, highest = resource.getrlimit(resource.RLIMIT_RTTIME)
        resource.setrlimit(resource.RLIMIT_RTTIME, (_HUNG_US, highest))
