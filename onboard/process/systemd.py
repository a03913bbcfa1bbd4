"""Messages to systemd: READY once, WATCHDOG while the control loop ticks, STATUS in a word; nothing
elsewhere.

Only a live tick may call this: a loop that hangs sends nothing, and systemd ends and restarts the
process.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

_LONGEST_NS = 1_000_000_000


class Notifier:
    """The datagram socket of ``NOTIFY_SOCKET``; without one every call does nothing.

    Args:
        environ: for tests; NOTIFY_SOCKET, and WATCHDOG_USEC, the time within which a message is
            due.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        path = environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path
        within = environ.get("WATCHDOG_USEC", "")
        # a third of the time allowed: two may be lost
        self._every_ns = (
            min(_LONGEST_NS, int(within) * 1000 // 3) if within.isdigit() else _LONGEST_NS
        )
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if path else None
        if self._socket is not None:
            self._socket.setblocking(False)
        self._sent_ns: int | None = None
        self._status = ""

    def alive(self, now_ns: int, status: str) -> None:
        """Report a completed tick; ``status`` is the state of the flight."""
        if self._socket is None:
            return
        is_first = self._sent_ns is None
        if (
            not is_first
            and status == self._status
            and now_ns - (self._sent_ns or 0) < self._every_ns
        ):
            return
        lines = [*(["READY=1"] if is_first else []), "WATCHDOG=1", f"STATUS={status}"]
        try:
            self._socket.sendto("\n".join(lines).encode(), self._address)
        except OSError:
            return  # its queue is full, or systemd is gone: the next tick tries again
        self._sent_ns, self._status = now_ns, status
