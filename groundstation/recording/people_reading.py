"""Reads where the motion capture saw the persons of the fleet file in a recorded flight."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from groundstation.recording.recorded_flight import PersonTrack
from groundstation.recording.timeline import Timeline
from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz

_TOPICS = frozenset(("mocap",))
_EVERY = 5  # one pose of so many is kept: a person is drawn by 10 poses a second
_LARGEST_M = 1e4


class _PoseRow(msgspec.Struct, gc=False):
    position_enu_m: Xyz
    is_tracked: bool = True


_POSES = msgspec.json.Decoder(_PoseRow)


def people_of(
    timeline: Timeline, fleet: FleetConfig | None, seconds: Callable[[int], float]
) -> dict[str, PersonTrack]:
    """Return the tracks of the persons who were seen, by name.

    Args:
        timeline: the open record.
        fleet: the fleet file beside the record; without it nobody is known to be a person.
        seconds: converts a stamp [ns] to the time of the flight [s].
    """
    if fleet is None or not fleet.people:
        return {}

    person_of = {body: name for name, body in fleet.people_bodies.items()}
    samples: dict[str, list[tuple[float, float, float, float]]] = {}
    for number in range(timeline.chunk_count):
        for raw in timeline.raw_channels(number, _TOPICS):
            name = person_of.get(raw.name)
            if name is None:
                continue
            own = samples.setdefault(name, [])
            for stamp_ns, data in zip(raw.stamps_ns[::_EVERY], raw.datas[::_EVERY], strict=True):
                position_enu_m = _position(data)
                if position_enu_m is not None:
                    own.append((seconds(stamp_ns), *position_enu_m))

    return {name: _track(own) for name, own in samples.items() if own}


def _position(data: bytes) -> Xyz | None:
    """Return the position of a pose; None if it was not tracked or cannot be decoded."""
    try:
        row = _POSES.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    if not row.is_tracked or not all(abs(value) < _LARGEST_M for value in row.position_enu_m):
        return None
    return row.position_enu_m


def _track(samples: list[tuple[float, float, float, float]]) -> PersonTrack:
    values = np.array(sorted(samples))
    return PersonTrack(time_s=values[:, 0], position_enu_m=values[:, 1:])
