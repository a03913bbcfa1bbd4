"""A link between two interfaces that delays, loses in bursts, doubles and reorders packets: what
netem does.
"""

from __future__ import annotations

import contextlib
import heapq
import os
import random
import select
import threading
import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """Quality of both directions."""

    delay_s: float = 0.020
    loss: float = 0.0  # share of the packets
    burst: float = 1.0  # mean number lost in a row; 1: each by itself
    duplicate: float = 0.0
    reorder: float = 0.0  # share that is held back for `reorder_s` more
    reorder_s: float = 0.020


class Direction:
    """One direction: the chain of Gilbert and Elliott, and what is on its way."""

    def __init__(self, quality: LinkQuality, seed: int) -> None:
        self._quality = quality
        self._random = random.Random(seed)
        self._is_lost = False
        self._on_way: list[tuple[float, int, bytes]] = []
        self._count = 0
        self.is_cut = False

    def push(self, now_s: float, packet: bytes) -> None:
        """Send a packet."""
        q = self._quality
        draw = self._random.random
        if q.burst > 1.0:
            leave = 1.0 / q.burst
            self._is_lost = draw() < (
                1.0 - leave if self._is_lost else leave * q.loss / (1.0 - q.loss)
            )
        else:
            self._is_lost = draw() < q.loss
        if self._is_lost or self.is_cut:
            return
        for _ in range(2 if draw() < q.duplicate else 1):
            self._count += 1
            late_s = q.delay_s + (q.reorder_s if draw() < q.reorder else 0.0)
            heapq.heappush(self._on_way, (now_s + late_s, self._count, packet))

    def pop(self, now_s: float) -> list[bytes]:
        """Return what has arrived."""
        packets = []
        while self._on_way and self._on_way[0][0] <= now_s:
            packets.append(heapq.heappop(self._on_way)[2])
        return packets


class BadLink:
    """Carries packets between two descriptors, in a thread of its own, until it is stopped."""

    def __init__(self, first: int, second: int, quality: LinkQuality, seed: int = 0) -> None:
        self._ways = {
            first: (second, Direction(quality, seed)),
            second: (first, Direction(quality, seed + 1)),
        }
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bad-link", daemon=True)

    def start(self) -> None:
        """Begin to carry packets."""
        self._thread.start()

    def cut(self, is_cut: bool) -> None:
        """Let nothing pass, or all again."""
        for _, direction in self._ways.values():
            direction.is_cut = is_cut

    def stop(self) -> None:
        """End; the descriptors stay open."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.is_set():
            readable, _, _ = select.select(list(self._ways), [], [], 0.001)
            now_s = time.monotonic()
            for source in readable:
                with contextlib.suppress(BlockingIOError, OSError):
                    self._ways[source][1].push(now_s, os.read(source, 65536))
            for target, direction in self._ways.values():
                for packet in direction.pop(time.monotonic()):
                    with contextlib.suppress(OSError):
                        os.write(target, packet)
