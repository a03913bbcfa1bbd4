"""What a process costs, as the kernel counts it (Linux): processor time and memory; and how busy the machine is."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 0.01
_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Usage:
    """Of one process since its start: processor time of all its threads, and memory that is resident now.

    own_mib: without the pages of files (libraries), which processes share and the kernel brings and takes as it likes.
    """

    cpu_s: float
    rss_mib: float
    own_mib: float


def usage(pid: int) -> Usage | None:
    """What a process has used; None when there is no such process."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except OSError:
        return None
    sizes = {line.partition(":")[0]: line.split() for line in status.splitlines() if line.startswith("Rss")}
    kib = {key: int(words[1]) for key, words in sizes.items()}
    page = os.sysconf("SC_PAGE_SIZE")
    return Usage(
        cpu_s=(int(fields[11]) + int(fields[12])) * _TICK_S,
        rss_mib=int(fields[21]) * page / _MIB,
        own_mib=kib.get("RssAnon", 0) / 1024.0,
    )


def processor_times() -> tuple[int, int]:
    """All and idle time of all processors so far, in the kernel's ticks."""
    numbers = [int(word) for word in Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:]]
    return sum(numbers[:8]), numbers[3] + numbers[4]


def busy_share(before: tuple[int, int], after: tuple[int, int]) -> float:
    """Share of all processors that was busy between two :func:`processor_times`."""
    return 1.0 - (after[1] - before[1]) / max(1, after[0] - before[0])


def has_precedence(pid: int) -> bool:
    """Whether the first thread of a process runs before those that take turns."""
    try:
        return os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
    except (OSError, AttributeError):
        return False
