"""Processor time and memory of a process, and how busy the machine is."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass

import psutil

_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Usage:
    """Of one process since its start."""

    cpu_s: float  # processor time of all its threads
    rss_mib: float  # memory that is resident now
    # without the pages of files (libraries), which processes share and the kernel takes as it likes
    own_mib: float


def usage(pid: int) -> Usage | None:
    """Return the cost of a process so far; None when there is no such process."""
    try:
        process = psutil.Process(pid)
        with process.oneshot():
            times = process.cpu_times()
            memory = process.memory_info()
    except psutil.Error:
        return None

    return Usage(
        cpu_s=times.user + times.system,
        rss_mib=memory.rss / _MIB,
        own_mib=(memory.rss - memory.shared) / _MIB,
    )


def processor_times() -> tuple[float, float]:
    """Return all and idle time of all processors so far [s]."""
    times = psutil.cpu_times()
    idle_s = times.idle + times.iowait
    busy_s = times.user + times.nice + times.system + times.irq + times.softirq + times.steal
    return busy_s + idle_s, idle_s


def busy_share(before: tuple[float, float], after: tuple[float, float]) -> float:
    """Return the share of all processors that was busy between two :func:`processor_times`."""
    all_before_s, idle_before_s = before
    all_after_s, idle_after_s = after
    past_s = all_after_s - all_before_s
    if past_s <= 0.0:
        return 0.0
    return 1.0 - (idle_after_s - idle_before_s) / past_s


def has_precedence(pid: int) -> bool:
    """Whether the first thread of a process runs before those that take turns."""
    with contextlib.suppress(OSError, AttributeError):
        policy = os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK
        return policy in (os.SCHED_FIFO, os.SCHED_RR)
    return False
