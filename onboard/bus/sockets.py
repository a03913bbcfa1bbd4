"""Sockets that close at once.

Zenoh gives each of its TCP sockets ten seconds to deliver what is left at its end. For so long
``close()`` blocks the thread that calls it, and that is the thread of all network work: one peer
that hangs, or whose cable is cut, would take the bus away from all others.

Zenoh has no option for it, so it is changed from outside, on every socket of the process. The
kernel then delivers what is left, and nobody waits.
"""

from __future__ import annotations

import os
import socket
import struct
import threading

_LINGER = struct.Struct("ii")  # C's struct linger: on or off, seconds

# A peer is given up a second after it was heard last, hence later than its socket is seen here. A
# stranger who opens hundreds of connections is closed at once: until his sockets are seen here, his
# slow end of each holds up all others. So new sockets are looked for often, and more often after
# some were found (an agent has about twenty files: a look costs 0.1 ms).
_PERIOD_S = 0.1
_SOON_S = 0.01


class PromptSockets:
    """Lets all sockets of the process close at once, future ones included, until it is stopped."""

    def __init__(self) -> None:
        self._ended = threading.Event()

    def start(self) -> None:
        """Begin, in a thread of its own."""
        threading.Thread(target=self._run, name="bus-sockets", daemon=True).start()

    def stop(self) -> None:
        """Change the sockets that there are, and end."""
        self._ended.set()
        let_all_close_at_once()

    def _run(self) -> None:
        period_s = _PERIOD_S
        while not self._ended.wait(period_s):
            period_s = _PERIOD_S
            if let_all_close_at_once():
                period_s = _SOON_S


def let_all_close_at_once() -> int:
    """Let every socket that the process has now close at once.

    Returns:
        how many of them would have waited.
    """
    changed = 0
    for number in os.listdir("/proc/self/fd"):
        try:
            borrowed = socket.socket(socket.AF_INET, socket.SOCK_STREAM, 0, int(number))
        except OSError:
            continue

        try:
            option = borrowed.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size)
            is_on, _ = _LINGER.unpack(option)
            if is_on:
                borrowed.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
                changed += 1
        except OSError:
            continue  # no socket, or closed meanwhile
        finally:
            borrowed.detach()  # it stays zenoh's: it must not be closed here

    return changed
