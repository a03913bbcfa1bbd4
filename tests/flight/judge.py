"""An independent judge: reads a record with mcap's reader, shares no code with the recorder."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray


def truth(folder: Path) -> dict[str, NDArray[np.float64]]:
    """Per vehicle an array (T, 4): seconds, x, y, z in fleet ENU, from the channels
    ``truth/<vehicle>``.
    """
    tracks: dict[str, list[list[float]]] = {}
    with (folder / "flight.mcap").open("rb") as stream:
        for _schema, channel, message in make_reader(stream).iter_messages():
            kind, _, name = channel.topic.partition("/")
            if kind == "truth":
                sample = json.loads(message.data)
                tracks.setdefault(name, []).append(
                    [message.log_time * 1e-9, *sample["position_enu_m"]]
                )
    return {name: np.array(sorted(rows)) for name, rows in tracks.items()}


def topics(folder: Path) -> set[str]:
    """All channel names of the record."""
    with (folder / "flight.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return {channel.topic for channel in summary.channels.values()}


def min_separation_m(folder: Path, airborne_above_m: float = 0.1) -> float:
    """Smallest horizontal distance between centres while at least one of the two flies, linearly
    interpolated.
    """
    tracks = truth(folder)
    worst = math.inf
    for a, b in itertools.combinations(tracks.values(), 2):
        t = np.arange(max(a[0, 0], b[0, 0]), min(a[-1, 0], b[-1, 0]), 0.02)
        first, second = (
            [np.interp(t, track[:, 0], track[:, i]) for i in (1, 2, 3)] for track in (a, b)
        )
        flying = np.maximum(first[2], second[2]) > airborne_above_m
        distance = np.hypot(first[0] - second[0], first[1] - second[1])[flying]
        worst = min(worst, float(distance.min(initial=math.inf)))
    return worst
