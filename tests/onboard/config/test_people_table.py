"""The fleet file's [people]: what is wrong is named by its path, and the hash covers the table."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest

from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping

_PAPER = tomllib.loads((Path(__file__).parents[3] / "configs/fleets/paper.toml").read_text())


def _fleet(people: Any) -> FleetConfig:
    data = copy.deepcopy(_PAPER)
    data["people"] = people
    return fleet_from_mapping(data, path="fleet.toml")


def test_a_person_has_the_body_of_his_name_and_a_circle_of_arms_length() -> None:
    fleet = _fleet({"anna": {}, "ben": {"mocap_body": "cap3", "radius_m": 0.6}})
    assert fleet.people_bodies == {"anna": "anna", "ben": "cap3"}
    assert fleet.people["anna"].radius_m == 0.4
    assert fleet.config_hash != fleet_from_mapping(_PAPER).config_hash


WRONG = [
    ({"anna": {"radius": 1.0}}, "unknown key 'people.anna.radius'"),
    ({"anna": {"radius_m": 0.0}}, "'people.anna.radius_m' is 0.0"),
    ({"anna": {"radius_m": float("nan")}}, "'people.anna.radius_m' is nan"),
    ({"anna b": {}}, "'people.anna b'"),
    ({"anna": {"mocap_body": "a b"}}, "'people.anna.mocap_body' is 'a b'"),
    ({"mav1": {"mocap_body": "cap"}}, "'people.mav1' has the name of a vehicle"),
    (
        {"anna": {"mocap_body": "mav1"}},
        "'people.anna' and 'vehicles.mav1' have the same mocap body 'mav1'",
    ),
    (
        {"anna": {}, "ben": {"mocap_body": "anna"}},
        "'people.ben' and 'people.anna' have the same mocap body 'anna'",
    ),
    ({"anna": {"walk_m_s": 30.0}}, "'people.anna.walk_m_s' is 30.0"),
    ({"anna": {"walk_enu_m": [[0.0, float("inf")]]}}, "'people.anna.walk_enu_m'"),
    ([{"name": "anna"}], "people"),
]


@pytest.mark.parametrize(("people", "words"), WRONG)
def test_what_is_wrong_is_named(people: Any, words: str) -> None:
    with pytest.raises(ConfigError) as error:
        _fleet(people)
    assert words in str(error.value)


def test_people_need_a_motion_capture() -> None:
    data = copy.deepcopy(_PAPER)
    data["people"] = {"anna": {}}
    data["types"]["ardrone"]["mocap_required"] = False
    for vehicle in data["vehicles"].values():
        vehicle.pop("mocap_body")
    with pytest.raises(ConfigError, match="'people' needs a motion capture"):
        fleet_from_mapping(data, path="fleet.toml")
