"""Sessions of the bus that end with a block, and waiting for what arrives over them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from onboard.bus.session import BusSession


@contextmanager
def started(session: BusSession) -> Iterator[BusSession]:
    """Start a session, and stop it with the block."""
    session.start()
    try:
        yield session
    finally:
        session.stop()


def until(condition: Callable[[], object], timeout_s: float = 10.0) -> bool:
    """Wait for a condition; whether it came true in time."""
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.005)
    return True
