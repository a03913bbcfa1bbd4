"""A recorded flight knows where the motion capture saw the persons of its fleet file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from groundstation.recording.flight_reading import read_flight
from groundstation.report.payload import payload
from sitl.emulator.walk import position_at
from sitl.lockstep.flight import Lockstep
from tests.groundstation.report.made_up import opened

_PAPER = Path(__file__).parents[3] / "configs/fleets/paper.toml"
_WALK = ((-3.0, 2.0), (3.0, 2.0))
_PEOPLE = """
[people.anna]
mocap_body = "cap1"
radius_m = 0.5
walk_enu_m = [[-3.0, 2.0], [3.0, 2.0]]
walk_m_s = 0.7

[people.ben]
"""


def test_the_track_of_a_person_is_read_and_who_was_never_seen_has_none(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(_PAPER.read_text(encoding="utf-8") + _PEOPLE, encoding="utf-8")
    folder = tmp_path / "flight"
    with Lockstep(fleet, seed=1, folder=folder) as lockstep:
        lockstep.run(4.0)
    (folder / "fleet.toml").write_text(fleet.read_text(encoding="utf-8"), encoding="utf-8")

    flight = read_flight(folder)
    assert list(flight.people) == ["anna"]
    track = flight.people["anna"]
    assert track.time_s.size > 20
    assert (track.time_s[1:] > track.time_s[:-1]).all()

    header, curves = opened(payload(flight, made_by="test"))
    assert header["fleet"]["people"] == [{"name": "anna", "radius_m": 0.5}]
    assert np.nanmax(np.abs(curves["person0/y"] - 2.0)) < 0.02

    # the record begins a moment after the emulator
    begin_s = float(track.time_s[0])
    first = track.position_enu_m[0]
    started_s = (first[0] - _WALK[0][0]) / 0.7 - begin_s
    for time_s, position in zip(track.time_s, track.position_enu_m, strict=True):
        place = position_at(_WALK, 0.7, float(time_s) + started_s)
        assert math.dist(place, position) == pytest.approx(0.0, abs=0.05)
