"""Settings of the process that keep delays out of the control loop.

Garbage is collected only while the vehicle is on the ground. A separate thread writes the log
lines, because the program that reads them may hang. Python's lock passes quickly from one thread to
the next. On a drone's companion computer the control loop's thread may have real-time priority.
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

_MAX_LINES = 2000  # largest number of log lines that wait for the writing thread

# Time after which a thread must hand over Python's lock (GIL) to a waiting thread. It is longer
# than the computation of a tick, so that other threads do not interrupt a tick. It is short
# compared with the tick period, so that the loop soon gets the lock back.
_SWITCH_S = 0.002

_REALTIME_PRIORITY = 10  # priority of the control loop's thread
_HELPERS_PRIORITY = 5  # priority of the other threads
_MIN_FREE_BYTES = 50_000_000  # a disk with less free space is full
_HUNG_US = 1_000_000  # longest computation without a pause; the control loop pauses at each tick


class _LinesHandler(logging.handlers.QueueHandler):
    """Passes records on to the writing thread; drops them while the queue is full."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def log_in_thread(name: str, level: str) -> logging.handlers.QueueListener:
    """Return a listener that writes the log to stderr in a separate thread.

    Its ``stop()`` writes the remaining lines.

    Args:
        name: name of the vehicle, which is in each line.
        level: lowest level of the lines.
    """
    writer = logging.StreamHandler(PlainStream(sys.stderr))
    writer.setFormatter(logging.Formatter(f"%(asctime)s {name} %(levelname)s %(message)s"))

    lines: queue.Queue[logging.LogRecord] = queue.Queue(_MAX_LINES)
    handler = _LinesHandler(lines)
    handler.setFormatter(logging.Formatter("%(message)s"))  # the writer adds time, name and level
    logging.basicConfig(level=level, handlers=[handler], force=True)

    listener = logging.handlers.QueueListener(lines, writer)
    listener.start()
    return listener


def stop_garbage_collection() -> None:
    """Collect garbage once after everything is loaded, and switch automatic collections off.

    A collection in flight would delay ticks. Without collections, only objects in reference cycles
    stay in memory, and the agent's ticks do not create such objects. Later collections do not
    examine the objects that exist now. :func:`collect_garbage` collects newer objects while the
    vehicle is on the ground.
    """
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    gc.disable()


def collect_garbage() -> None:
    """Collect the garbage since :func:`stop_garbage_collection`. Call this only on the ground."""
    gc.collect()


def is_disk_full() -> bool:
    """Return whether the disk with the log file (stderr) has no space left.

    If stderr is not a file, the disk of the working directory is checked.
    """
    try:
        if stat.S_ISREG(os.fstat(2).st_mode):
            disk = os.statvfs(2)
        else:
            disk = os.statvfs(".")
    except OSError:
        return False
    return disk.f_bavail * disk.f_frsize < _MIN_FREE_BYTES


def set_realtime_priority() -> str:
    """Give the calling thread real-time priority, and return a sentence about the result.

    The other threads of the process get a lower real-time priority. Otherwise such a thread could
    hold Python's lock while it waits for a processor, and delay the loop. Threads that start later
    get no real-time priority, because their work may wait.
    """
    try:
        threads = {int(name) for name in os.listdir("/proc/self/task")}
        for thread in threads - {threading.get_native_id()}:
            with contextlib.suppress(ProcessLookupError):  # the thread has just ended
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
    """Let the kernel end this process when a real-time thread computes for too long.

    A user's avoidance law that never returns would block a processor for all other programs on this
    computer, for instance the emulator. After a second, the kernel ends the process, and the law's
    stack is written to stderr.
    """
    with contextlib.suppress(OSError, ValueError, AttributeError):  # only Linux has this limit
        faulthandler.register(signal.SIGXCPU, all_threads=False, chain=True)
        _, highest = resource.getrlimit(resource.RLIMIT_RTTIME)
        resource.setrlimit(resource.RLIMIT_RTTIME, (_HUNG_US, highest))
