"""Links over long ways and through outages: after what time a link is open, and for how long nobody
hears anything when packets stop for a while.

The two nodes and the carrier between them are those of the ages (``bench.py``). An outage begins
when states have come for a while, loses every packet of both directions, and ends by itself. What
it costs is the age of the newest state, looked at 50 times a second, at its largest.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.bench.network.bad_link import BadLink, LinkQuality

SETTLE_S = 2.0  # of states, before they count
_BEFORE_OUTAGE_S = 0.5  # of those that count
_STARTS_S = 40.0  # for two processes to start, and the link to open

NO_NAMESPACE = "This computer allows no network namespaces with a tun device: run it as root."


@dataclass(frozen=True, slots=True)
class Carried:
    """What the listener saw of the publisher's states."""

    opened_s: float | None  # after the start of the bus until the first state; None: never
    ages_ms: Sequence[float]  # of the newest state, at each tick of the listener
    messages: int


@dataclass(frozen=True, slots=True)
class Opening:
    """How long a link takes to open over a long way."""

    scheme: str
    round_trip_ms: float
    opened_s: float | None


@dataclass(frozen=True, slots=True)
class Outage:
    """What an outage costs."""

    scheme: str
    lasts_s: float
    longest_age_s: float


def carry(
    path: Path,
    addresses: Sequence[str],
    quality: LinkQuality,
    *,
    seconds: float,
    seed: int = 1,
    outage_s: float = 0.0,
) -> Carried:
    """Let one node publish to another over a link, and return what arrived.

    Args:
        path: of the fleet file; its first vehicle publishes, its second listens.
        addresses: of the two, in their order.
        quality: of the link.
        seconds: for which ages are looked at.
        seed: of the losses.
        outage_s: for which nothing passes, once.

    Raises:
        OSError: this computer does not allow network namespaces.
    """
    nodes: list[subprocess.Popen[str]] = []
    parents: list[socket.socket] = []
    tuns: list[int] = []
    try:
        for index, address in enumerate(addresses):
            node, parent = _started(f"mav{index}", path, address, seconds)
            nodes.append(node)
            parents.append(parent)

        for parent in parents:
            _, received, _, _ = socket.recv_fds(parent, 16, 1)
            if not received:
                raise OSError(NO_NAMESPACE)
            tuns.append(received[0])

        carrier = BadLink(tuns[0], tuns[1], quality, seed)
        carrier.start()
        for parent in parents:
            parent.send(b"g")

        if outage_s > 0.0 and _is_heard(parents[1]):
            time.sleep(SETTLE_S + _BEFORE_OUTAGE_S)
            carrier.cut(True)
            time.sleep(outage_s)
            carrier.cut(False)

        output, _ = nodes[1].communicate(timeout=seconds + _STARTS_S)
        carrier.stop()
    finally:
        for node in nodes:
            node.kill()
            node.wait()
        for parent in parents:
            parent.close()
        for tun in tuns:
            os.close(tun)

    found: dict[str, Any] = json.loads(output.splitlines()[-1])
    return Carried(
        opened_s=found["opened_s"],
        ages_ms=found["ages_ms"],
        messages=found["messages"],
    )


def _started(
    name: str, path: Path, address: str, seconds: float
) -> tuple[subprocess.Popen[str], socket.socket]:
    """Return a node's process, and the socket to it."""
    parent, child = socket.socketpair()
    words = [name, str(path), f"{address}/24", str(seconds), str(child.fileno())]
    command = [sys.executable, "-m", "tests.bench.network.node", *words]
    node = subprocess.Popen(command, pass_fds=[child.fileno()], stdout=subprocess.PIPE, text=True)
    child.close()
    return node, parent


def _is_heard(listener: socket.socket) -> bool:
    """Wait until the listener has heard the first state; whether it did."""
    return listener.recv(1) == b"h"
