"""Threads that Python did not start: those of MAVSDK and Zenoh, on which callbacks run."""

from __future__ import annotations

import ctypes
import threading

_thread_local = threading.local()


def keep_thread_state() -> None:
    """Keep Python's state of the calling thread until the process ends.

    Every callback calls this first. Otherwise each callback of such a thread would create and
    delete that state. Each time, 16 KiB would be mapped and unmapped, which interrupts all
    processors. ``PyGILState_Ensure`` without ``PyGILState_Release`` keeps the state, which takes
    about a kilobyte per thread.

    The thread's owner must end the thread, or its callbacks, before the interpreter ends. The links
    and the bus do this when they stop.
    """
    if not hasattr(_thread_local, "is_kept"):
        _thread_local.is_kept = True
        ctypes.pythonapi.PyGILState_Ensure()
