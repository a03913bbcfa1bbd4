"""Threads that Python did not start: those of MAVSDK and Zenoh, on which callbacks run."""

from __future__ import annotations

import ctypes
import threading

_known = threading.local()


def keep_thread_state() -> None:
    """Keep Python's state of the calling thread until the process ends.

    Every callback calls this first. Otherwise each callback of a foreign thread creates that state
    and deletes it again: 16 KiB are mapped and unmapped each time, which interrupts all processors.
    ``PyGILState_Ensure`` is called here without ``PyGILState_Release``, which keeps the state. It
    takes about a kilobyte per thread.

    The owner of the thread must end the thread, or its callbacks, before the interpreter ends. The
    links and the bus do so when they stop.
    """
    if not hasattr(_known, "is_kept"):
        _known.is_kept = True
        ctypes.pythonapi.PyGILState_Ensure()
