"""Messages to systemd: READY once, WATCHDOG while the control loop ticks, STATUS in a few words.

Only completed ticks send them. So if the loop hangs, no message is sent, and systemd restarts the
process. If systemd has not started the process, nothing is sent. See sd_notify(3).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

_LONGEST_NS = 1_000_000_000  # longest time from one message to the next


class Notifier:
    """Sends messages to systemd's socket.

    Args:
        environ: environment. NOTIFY_SOCKET is the path of systemd's socket; without it nothing is
            sent. WATCHDOG_USEC is the longest time between two messages.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        path = environ.get("NOTIFY_SOCKET", "")
        self._address = path
        if path.startswith("@"):  # an abstract socket, which has no file
            self._address = "\0" + path[1:]

        self._every_ns = _LONGEST_NS  # time from one message to the next
        watchdog_us = environ.get("WATCHDOG_USEC", "")
        if watchdog_us.isdigit():
            # a third of WATCHDOG_USEC, so that two messages may be lost
            third_ns = int(watchdog_us) * 1000 // 3
            self._every_ns = min(_LONGEST_NS, third_ns)

        self._socket: socket.socket | None = None
        if path:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

        self._sent_ns: int | None = None  # time of the last message; None before the first
        self._status = ""  # status in the last message

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
            return  # the socket's queue is full, or systemd is gone; the next tick tries again

        self._sent_ns = now_ns
        self._status = status
