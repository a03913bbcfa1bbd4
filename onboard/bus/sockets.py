"""Sockets that close at once.

Zenoh sets a linger time of ten seconds on each of its TCP sockets: ``close()`` waits up to this
time for the remaining bytes to be delivered. Meanwhile it blocks the thread of all network work. So
a single peer that hangs or loses its cable would cut all others off from the bus.

Zenoh has no option for the linger time, so it is switched off here, on every socket of the process.
The kernel then delivers the remaining bytes, and no thread waits.
"""

from __future__ import annotations

import os
import socket
import struct
import threading

_LINGER = struct.Struct("ii")  # C's struct linger: on or off, seconds

# If a connection is closed before a search finds its socket, it delays all other links until then.
# One search costs an agent 0.1 ms.
_PERIOD_S = 0.1  # from one search for new sockets to the next
_SOON_S = 0.01  # the same after a search that found new sockets


class PromptSockets:
    """Lets all sockets of the process close at once, including those opened later."""

    def __init__(self) -> None:
        self._ended = threading.Event()

    def start(self) -> None:
        """Begin to search for sockets, in a thread."""
        threading.Thread(target=self._run, name="bus-sockets", daemon=True).start()

    def stop(self) -> None:
        """Change the sockets that exist now, and end the search."""
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
        number of sockets that had a linger time before.
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
            continue  # not a socket, or closed meanwhile
        finally:
            borrowed.detach()  # the descriptor belongs to zenoh and must not be closed here

    return changed
