"""Reads where the motion capture saw the persons of the fleet file in a recorded flight."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from groundstation.recording.recorded_flight import PersonTrack
from groundstation.recording.timeline import RawChannel
from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz

_TOPICS = frozenset(("mocap",))
_EVERY = 5  # one pose in this many is kept; 10 a second are enough to draw a person
_LARGEST_M = 1e4


class _PoseRow(msgspec.Struct, gc=False):
    position_enu_m: Xyz
    is_tracked: bool = True


_POSES = msgspec.json.Decoder(_PoseRow)


class PeopleTracks:
    """Collects the poses of the persons of a fleet file, channel by channel.

    Args:
        fleet: the fleet file beside the record; without it nobody is known to be a person.
    """

    def __init__(self, fleet: FleetConfig | None) -> None:
        bodies: dict[str, str] = {}
        if fleet is not None:
            bodies = fleet.people_bodies
        self._person_of = {body: name for name, body in bodies.items()}
        self._samples: dict[str, list[tuple[int, Xyz]]] = {}  # person -> stamps and positions

    @property
    def topics(self) -> frozenset[str]:
        """Topics that have to be read; none without persons."""
        return _TOPICS if self._person_of else frozenset()

    def add(self, raw: RawChannel) -> None:
        """Add the poses of one channel of these topics."""
        name = self._person_of.get(raw.name)
        if name is None:
            return

        samples = self._samples.setdefault(name, [])
        kept = zip(raw.stamps_ns[::_EVERY], raw.datas[::_EVERY], strict=True)
        for stamp_ns, data in kept:
            position_enu_m = _position(data)
            if position_enu_m is not None:
                samples.append((stamp_ns, position_enu_m))

    def tracks(self, seconds: Callable[[int], float]) -> dict[str, PersonTrack]:
        """Return the tracks of the persons who were seen, by name.

        Args:
            seconds: converts a stamp [ns] to the time of the flight [s].
        """
        tracks = {}
        for name, samples in self._samples.items():
            if samples:
                samples.sort()
                tracks[name] = PersonTrack(
                    time_s=np.array([seconds(stamp_ns) for stamp_ns, _ in samples]),
                    position_enu_m=np.array([position_enu_m for _, position_enu_m in samples]),
                )
        return tracks


def _position(data: bytes) -> Xyz | None:
    """Return the position of a pose; None if it was not tracked or cannot be decoded."""
    try:
        row = _POSES.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    if not row.is_tracked or not all(abs(value) < _LARGEST_M for value in row.position_enu_m):
        return None
    return row.position_enu_m
