"""The fleet file's [mocap]: what is wrong is named by its path."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest

from onboard.config.fleet import ConfigError, fleet_from_mapping

_PAPER = tomllib.loads((Path(__file__).parents[3] / "configs/fleets/paper.toml").read_text())
_VICON = {"source": "motioncapture", "type": "vicon", "hostname": "10.0.0.2"}


def _fleet(table: Any, **vehicle: object):
    data = copy.deepcopy(_PAPER)
    data["mocap"] = table
    data["vehicles"]["mav1"].update(vehicle)
    return fleet_from_mapping(data, path="fleet.toml")


def test_without_the_table_poses_come_from_the_bus() -> None:
    assert fleet_from_mapping(_PAPER).mocap.source == "bus"


def test_a_whole_table_is_read() -> None:
    mocap = _fleet(
        {
            **_VICON,
            "direct": True,
            "up": "y",
            "yaw_deg": 90,
            "offset_m": [1, 2, 0],
            "latency_s": 0.008,
        }
    ).mocap
    assert (mocap.direct, mocap.up, mocap.yaw_deg, mocap.offset_m) == (
        True,
        "y",
        90.0,
        (1.0, 2.0, 0.0),
    )


WRONG = [
    ({"sauce": "bus"}, "unknown key 'mocap.sauce'"),
    ({**_VICON, "type": "kinect"}, "mocap.type"),
    ({"source": "motioncapture"}, "'mocap.type' is missing"),
    ({"source": "motioncapture", "type": "vicon"}, "'mocap.hostname' is missing"),
    ({"hostname": "10.0.0.2"}, "'mocap.hostname' is given, but 'mocap.source' is 'bus'"),
    ({"direct": True}, "'mocap.direct' is given, but"),
    ({**_VICON, "latency_s": 2.0}, "'mocap.latency_s' is 2.0"),
    ({**_VICON, "latency_s": float("nan")}, "'mocap.latency_s' is nan"),
    ({**_VICON, "yaw_deg": 1e9}, "'mocap.yaw_deg'"),
    ({**_VICON, "offset_m": [0, float("inf"), 0]}, "'mocap.offset_m[1]'"),
    ({**_VICON, "offset_m": [0, 0]}, "mocap.offset_m"),
    ({**_VICON, "up": "x"}, "mocap.up"),
]


def test_a_wrong_table_is_refused_by_its_path() -> None:
    for table, words in WRONG:
        with pytest.raises(ConfigError) as error:
            _fleet(table)
        assert words in str(error.value), table
        assert str(error.value).startswith("fleet.toml: "), table


def test_two_vehicles_cannot_share_a_body_even_when_one_of_them_has_it_by_its_name() -> None:
    data = copy.deepcopy(_PAPER)
    del data["vehicles"]["mav0"]["mocap_body"]
    data["vehicles"]["mav1"]["mocap_body"] = "mav0"
    with pytest.raises(ConfigError, match="same mocap body 'mav0'"):
        fleet_from_mapping(data)


def test_a_body_that_cannot_be_a_part_of_a_key_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'vehicles\.mav1.mocap_body' is 'a/b'"):
        _fleet({}, mocap_body="a/b")


def test_vehicles_that_disagree_about_the_mocap_disagree_about_the_configuration() -> None:
    assert _fleet(_VICON).config_hash != _fleet({**_VICON, "yaw_deg": 90.0}).config_hash
