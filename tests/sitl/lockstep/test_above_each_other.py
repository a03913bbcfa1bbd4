"""Vehicles above each other, judged by ground truth in three dimensions."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from groundstation.recording.reader import read
from groundstation.shows.gallery import gallery_mission

GRID_S = 0.02


@pytest.mark.long
def test_vehicles_above_each_other_change_their_heights_and_are_apart_in_one_way_or_the_other(
    lockstep, tmp_path
):
    mission = gallery_mission("above", tmp_path)
    limits = mission.fleet.fleet
    flight = lockstep(mission.fleet, folder=tmp_path)
    verdict = flight.fly(mission)
    assert verdict.passed, verdict.sentences
    truths: dict[str, Any] = {}
    for sample in read(tmp_path, ("truth",)):
        truths.setdefault(sample.name, []).append(
            (1e-9 * sample.stamp_ns, *sample.values["position_enu_m"])
        )
    rows = {name: np.array(sorted(own)) for name, own in truths.items()}
    assert rows.keys() == mission.fleet.vehicles.keys()
    times_s = np.arange(
        max(own[0, 0] for own in rows.values()), min(own[-1, 0] for own in rows.values()), GRID_S
    )
    paths = [
        np.stack([np.interp(times_s, own[:, 0], own[:, k]) for k in (1, 2, 3)], -1)
        for own in rows.values()
    ]
    nearest_m = np.inf
    least_m = np.inf
    for one, other in itertools.combinations(paths, 2):
        beside_m = np.hypot(*(one - other)[:, :2].T)
        above_m = abs((one - other)[:, 2])
        assert (
            (beside_m >= limits.safety_distance_m) | (above_m >= limits.vertical_separation_m)
        ).all()
        nearest_m = min(nearest_m, beside_m.min())
        assert limits.vertical_separation_m is not None
        scale = limits.safety_distance_m / limits.vertical_separation_m
        least_m = min(least_m, np.maximum(beside_m, scale * above_m).min())
    assert nearest_m < 0.3  # they have been above each other
    assert abs(verdict.closest.distance_m - least_m) < 0.02
