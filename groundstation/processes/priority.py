"""Raises the priority of a ground that flies a mission, if the system allows it.

Agents take real-time priority. A ground also draws, plans and records, so it only gets a larger
share of a busy computer. Without that, a starved ground would receive telemetry late and count its
agents as silent. Processes that the ground starts do not inherit the priority.
"""

from __future__ import annotations

import contextlib
import os

# About ten times the share of an ordinary program. Agents and emulator still run first, since they
# have real-time priority.
_NICE = -10


def take_priority() -> str:
    """Let all threads of this process run before ordinary programs.

    Threads that start later inherit it, processes do not.

    Returns:
        A sentence about the result.
    """
    try:
        for thread in [int(name) for name in os.listdir("/proc/self/task")]:
            with contextlib.suppress(ProcessLookupError):  # the thread has just ended
                policy = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(thread, policy, os.sched_param(0))
                os.setpriority(os.PRIO_PROCESS, thread, _NICE)
    except (OSError, AttributeError) as error:
        return (
            f"This ground runs without priority ({error}): "
            f"add to /etc/security/limits.conf: USER - nice {_NICE}."
        )
    return f"This ground runs with priority (nice {_NICE})."
