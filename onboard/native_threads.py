"""Threads that Python did not start: those of MAVSDK and of Zenoh, on which callbacks run."""

from __future__ import annotations

import ctypes
import threading

_known = threading.local()


def keep_thread_state() -> None:
    """Let the calling thread keep what Python knows of it until the process ends; call it first in a callback.

    Otherwise every callback of a foreign thread makes that anew and throws it away: 16 KiB mapped, touched and unmapped
    each time, of which all the processors have to hear. A call of ``PyGILState_Ensure`` that is never undone is how one
    says so; without more callbacks it keeps a kilobyte and nothing else. Who owns the thread must end it, or its
    callbacks, before the interpreter ends, which the links and the bus do when they stop.
    """
    if not hasattr(_known, "is_kept"):
        _known.is_kept = True
        ctypes.pythonapi.PyGILState_Ensure()
