"""Goals of missions in latitude and longitude."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.orders.degrees import goal_enu_m
from groundstation.orders.intents import Goto, Move
from onboard.config.earth import Origin, latitude_longitude_deg
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping

ORIGIN = {"latitude_deg": 47.397742, "longitude_deg": 8.545594, "altitude_m": 489.4}


def fleet(origin: Any = ORIGIN) -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fleet"]["origin"] = origin
    return fleet_from_mapping(data, path="fleet.toml")


def at(x: float, y: float, z: float) -> list[float]:
    return [*latitude_longitude_deg(Origin(**ORIGIN), x, y), z]


def steps_of(*steps: dict[str, Any], origin: Any = ORIGIN) -> Any:
    takeoff = {"do": "takeoff", "height_m": 1.0}
    table = {"schema": 1, "step": [takeoff, *steps, {"do": "land"}]}
    return mission_from_mapping(table, path="m.toml", fleet=fleet(origin)).steps


def test_a_goal_in_degrees_is_the_same_goal_in_metres_also_within_other_steps() -> None:
    move = {"do": "move", "vehicles": "mav0", "position_deg": at(-1.0, 1.0, 1.2)}
    goto = {"do": "goto", "goals_deg": {"mav1": at(0.5, 0.5, 1.0)}}
    _, first, block, _ = steps_of(move, {"do": "repeat", "times": 2, "steps": [goto]})
    assert isinstance(first, Move)
    assert first.position_enu_m == pytest.approx((-1.0, 1.0, 1.2), abs=1e-6)
    (inner,) = block.steps
    assert isinstance(inner, Goto)
    assert inner.goals["mav1"] == pytest.approx((0.5, 0.5, 1.0), abs=1e-6)


@pytest.mark.parametrize(
    ("keys", "origin", "words"),
    [
        ({"position_deg": [47.4, 8.5]}, ORIGIN, "needs .latitude, longitude, height."),
        ({"position_deg": [47.4, "8", 1]}, ORIGIN, "needs .latitude, longitude, height."),
        ({"position_deg": [8.545594, 47.397742, 1.0]}, ORIGIN, "in this order"),
        ({"position_deg": [147.0, 8.5, 1.0]}, ORIGIN, "within -90 to 90"),
        ({"position_deg": [float("nan"), 8.5, 1.0]}, ORIGIN, "within -90 to 90"),
        ({"position_deg": at(0, 1, 1), "position_enu_m": [0, 1, 1]}, ORIGIN, "has both"),
        ({"position_deg": at(0, 1, 1)}, "mocap", "need fleet.origin"),
    ],
)
def test_what_is_no_goal_on_earth_is_refused_in_words(
    keys: dict[str, Any], origin: Any, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        steps_of({"do": "move", "vehicles": "mav0", **keys}, origin=origin)


def test_a_goal_outside_of_a_fence_is_refused_as_one_in_metres_is() -> None:
    with pytest.raises(ConfigError, match="outside the geofence"):
        steps_of({"do": "move", "vehicles": "mav0", "position_deg": at(50.0, 0.0, 1.0)})
    x, y, z = goal_enu_m(fleet(), *at(3.0, -2.0, 5.0))
    assert (x, y, z) == pytest.approx((3.0, -2.0, 5.0), abs=1e-6)
