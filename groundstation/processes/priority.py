"""Priority of a ground that flies a mission, where the system allows one.

Agents take real-time priority. A ground draws, plans and records beside its orders, so it only gets
a larger share of a busy computer: a ground that is starved hears its agents late, and would blame
them. What it starts does not inherit the priority.
"""

from __future__ import annotations

import contextlib
import os

# About ten times the share of an ordinary program; agents and emulator come before it by their
# real-time priority.
_NICE = -10


def take_priority() -> str:
    """Let all threads of this process run before ordinary programs.

    Threads that start later inherit it, processes do not.

    Returns:
        A sentence about the result.
    """
    try:
        for thread in [int(name) for name in os.listdir("/proc/self/task")]:
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                policy = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(thread, policy, os.sched_param(0))
                os.setpriority(os.PRIO_PROCESS, thread, _NICE)
    except (OSError, AttributeError) as error:
        return (
            f"This ground runs without priority ({error}): "
            f"add to /etc/security/limits.conf: USER - nice {_NICE}."
        )
    return f"This ground runs with priority (nice {_NICE})."
