"""A motion capture for tests: enough of OptiTrack's NatNet 3.0 protocol that its clients take it
for Motive.

Written from the facts of the protocol: a command port that answers a greeting and a question for
the bodies' names, and frames by unicast to the port that the greeting told.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping

_CONNECT = 0
_SERVER_INFO = 1
_ASK_NAMES = 4
_NAMES = 5
_FRAME = 7
_TICKS_PER_S = 10_000_000

# position [m], quaternion xyzw
Pose = tuple[tuple[float, float, float], tuple[float, float, float, float]]


class NatNetServer:
    """Streams ``bodies()`` at ``rate_hz`` to whoever has greeted; a body that is None is not
    tracked.

    Args:
        names: of the bodies, in the order of their ids.
        bodies: called for each frame.
    """

    def __init__(
        self,
        names: list[str],
        bodies: Callable[[], Mapping[str, Pose | None]],
        *,
        rate_hz: float = 100.0,
    ) -> None:
        self._names = names
        self._bodies = bodies
        self._period_s = 1.0 / rate_hz
        self._command = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._command.bind(("127.0.0.1", 0))
        self._command.settimeout(0.05)
        self.port: int = self._command.getsockname()[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._data_port: int = probe.getsockname()[1]
        self.is_streaming = threading.Event()
        self.is_streaming.set()
        self._has_client = threading.Event()
        self._stopped = threading.Event()
        self._threads = [
            threading.Thread(target=each, daemon=True) for each in (self._answer, self._stream)
        ]

    def __enter__(self) -> NatNetServer:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        for thread in self._threads:
            thread.join()
        self._command.close()

    def _answer(self) -> None:
        while not self._stopped.is_set():
            try:
                data, sender = self._command.recvfrom(4096)
            except TimeoutError:
                continue
            (kind,) = struct.unpack_from("<H", data)
            if kind == _CONNECT:
                body = b"Motive".ljust(256, b"\0") + bytes((3, 0, 0, 0)) + bytes((3, 0, 0, 0))
                body += struct.pack("<QHB4s", _TICKS_PER_S, self._data_port, False, bytes(4))
                self._command.sendto(struct.pack("<HH", _SERVER_INFO, len(body)) + body, sender)
            elif kind == _ASK_NAMES:
                body = struct.pack("<i", len(self._names))
                for number, name in enumerate(self._names):
                    body += struct.pack("<i", 1) + name.encode() + b"\0"
                    body += struct.pack("<iifff", number, -1, 0.0, 0.0, 0.0) + struct.pack("<i", 0)
                self._command.sendto(struct.pack("<HH", _NAMES, len(body)) + body, sender)
                self._has_client.set()

    def _stream(self) -> None:
        number = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not self._stopped.wait(self._period_s):
                if self._has_client.is_set() and self.is_streaming.is_set():
                    number += 1
                    out.sendto(self._frame(number), ("127.0.0.1", self._data_port))

    def _frame(self, number: int) -> bytes:
        now = int(time.monotonic() * _TICKS_PER_S)
        body = struct.pack("<iii", number, 0, 0)  # no marker sets, no unlabelled markers
        poses = self._bodies()
        body += struct.pack("<i", len(self._names))
        for place, name in enumerate(self._names):
            pose = poses.get(name)
            position, quaternion = (
                pose if pose is not None else ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            )
            body += struct.pack("<i3f4f", place, *position, *quaternion) + struct.pack(
                "<fh", 0.001, pose is not None
            )
        # skeletons, labelled markers, force plates, devices
        body += struct.pack("<iiii", 0, 0, 0, 0)
        body += (
            struct.pack("<IId", 0, 0, time.monotonic())
            + struct.pack("<QQQ", now, now, now)
            + struct.pack("<hi", 0, 0)
        )
        return struct.pack("<HH", _FRAME, len(body)) + body
