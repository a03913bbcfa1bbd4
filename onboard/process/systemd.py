"""Messages to systemd: READY once, WATCHDOG while the control loop ticks, STATUS in a few words.

Only a completed tick may send them: when the loop hangs, no message comes, and systemd ends and
restarts the process. If systemd has not started the process, nothing is sent: sd_notify(3).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

_LONGEST_NS = 1_000_000_000  # longest time from one message to the next


class Notifier:
    """Sends messages to the socket that ``NOTIFY_SOCKET`` names; without one it does nothing.

    Args:
        environ: environment with NOTIFY_SOCKET, and with WATCHDOG_USEC, the longest time between
            two messages. Tests pass their own.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        path = environ.get("NOTIFY_SOCKET", "")
        is_abstract = path.startswith("@")
        self._address = "\0" + path[1:] if is_abstract else path

        self._every_ns = _LONGEST_NS
        watchdog_us = environ.get("WATCHDOG_USEC", "")
        if watchdog_us.isdigit():
            # a third, so that two messages may be lost
            third_ns = int(watchdog_us) * 1000 // 3
            self._every_ns = min(_LONGEST_NS, third_ns)

        self._socket: socket.socket | None = None
        if path:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

        self._sent_ns: int | None = None
        self._status = ""

    def alive(self, now_ns: int, status: str) -> None:
        """Report a completed tick; ``status`` is the state of the flight."""
        if self._socket is None:
            return

        lines = ["WATCHDOG=1", f"STATUS={status}"]
        if self._sent_ns is None:
            lines.insert(0, "READY=1")
        else:
            is_due = now_ns - self._sent_ns >= self._every_ns
            if not is_due and status == self._status:
                return

        try:
            self._socket.sendto("\n".join(lines).encode(), self._address)
        except OSError:
            return  # its queue is full, or systemd is gone: the next tick tries again

        self._sent_ns = now_ns
        self._status = status
