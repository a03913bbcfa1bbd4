"""Vehicles above each other, judged by ground truth in three dimensions."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.shows.gallery import gallery_mission
from onboard.config.fleet import load_fleet
from tests.groundstation.recorded import read

GRID_S = 0.02
ROOT = Path(__file__).resolve().parents[3]


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


@pytest.mark.long
def test_every_second_vehicle_passes_above_the_others_where_the_fleet_allows_it(lockstep, tmp_path):
    fleet = load_fleet(ROOT / "configs" / "fleets" / "above.toml")
    fleet = replace(fleet, law=replace(fleet.law, passing_heights=2))
    goals = {"mav0": [2.0, 2.0, 1.0], "mav1": [-0.1, 2.5, 1.0], "mav2": [-2.0, 2.0, 1.0]}
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "goto", "goals": goals},
        {"do": "land"},
    ]
    mapping = {"schema": 1, "step": steps, "expect": {"all_landed": True}}
    mission = mission_from_mapping(mapping, path="passing.toml", fleet=fleet)

    verdict = lockstep(fleet, folder=tmp_path).fly(mission)

    assert verdict.passed, verdict.sentences
    assert verdict.closest.distance_m > fleet.fleet.safety_distance_m
    top_m = dict.fromkeys(goals, 0.0)
    for sample in read(tmp_path, ("truth",)):
        top_m[sample.name] = max(top_m[sample.name], sample.values["position_enu_m"][2])
    assert top_m["mav1"] == pytest.approx(2.5, abs=0.1)
    assert max(top_m["mav0"], top_m["mav2"]) < 1.2
