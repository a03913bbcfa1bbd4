"""What carries packets between network namespaces: by their address, unless two hosts are cut off
from each other.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import threading
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from tests.bench.network import namespaces

_NO_NAMESPACE = b"-"


def join(path: str, address: str) -> socket.socket:
    """Move this process, which has one thread yet, into a namespace whose packets a hub carries;
    the line to the hub.

    Args:
        path: of the hub's socket.
        address: of this host, with the length of its prefix.

    Raises:
        OSError: this computer allows no network namespaces, or there is no hub.
    """
    line = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    line.connect(path)
    try:
        tun = namespaces.enter(address)
    except OSError:
        line.send(_NO_NAMESPACE)
        raise OSError(
            "This computer allows no network namespaces with a tun device: run it as root."
        ) from None
    socket.send_fds(line, [socket.inet_aton(address.partition("/")[0])], [tun])
    line.recv(1)  # packets are carried
    os.close(tun)
    return line


class Hub:
    """``with Hub(path, sides) as hub``: carries packets, in a thread of its own, until the block is
    left.

    Args:
        path: of the socket at which hosts join; also at which one of them says b"cut" and b"heal".
        sides: two groups of addresses, which hear nothing of each other while they are cut.
    """

    def __init__(self, path: Path, *sides: Iterable[str]) -> None:
        first, second = (frozenset(map(socket.inet_aton, side)) for side in sides)
        self._between = {(a, b) for a in first for b in second} | {
            (b, a) for a in first for b in second
        }
        self._tuns: dict[bytes, int] = {}  # by the host's address
        self._is_cut = False
        self.is_refused = False  # a host got no namespace
        self._ended = threading.Event()
        self._ready = selectors.DefaultSelector()
        self._door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._door.bind(str(path))
        self._door.listen(64)
        self._ready.register(self._door, selectors.EVENT_READ, self._take_host)
        self._thread = threading.Thread(target=self._run, name="hub", daemon=True)

    def __enter__(self) -> Hub:
        """Begin to carry."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._ended.set()
        self._thread.join()
        self._door.close()
        for tun in self._tuns.values():
            os.close(tun)

    def _run(self) -> None:
        from sitl.server import take_precedence  # not above: who joins has one thread

        take_precedence()  # the network waits for no program
        while not self._ended.is_set():
            for key, _ in self._ready.select(0.1):
                key.data()

    def _take_host(self) -> None:
        line, _ = self._door.accept()
        self._ready.register(line, selectors.EVENT_READ, lambda: self._take_word(line))

    def _take_word(self, line: socket.socket) -> None:
        """Take a host's interface, or its word; a host that has ended says b""."""
        word, tuns, _, _ = socket.recv_fds(line, 16, 1)
        for tun in tuns:
            self._tuns[word] = tun
            self._ready.register(tun, selectors.EVENT_READ, partial(self._carry, word, tun))
            line.send(b"g")
        self.is_refused |= word == _NO_NAMESPACE
        if word in (b"cut", b"heal"):
            self._is_cut = word == b"cut"
        elif not tuns:
            self._ready.unregister(line)
            line.close()

    def _carry(self, source: bytes, tun: int) -> None:
        # IPv6's own packets have no target here
        with contextlib.suppress(BlockingIOError, OSError):
            for _ in range(64):
                packet = os.read(tun, 65536)
                target = packet[16:20]
                if target in self._tuns and not (
                    self._is_cut and (source, target) in self._between
                ):
                    os.write(self._tuns[target], packet)
