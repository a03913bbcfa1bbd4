"""Fences in every picture of a fleet: console, report, live page, viewers and the plan figure."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from groundstation.console.plan_drawing import Window, draw_background
from groundstation.figures.data import FlightData
from groundstation.figures.plan_figure import draw
from groundstation.recording.flight_reading import read_flight
from groundstation.report.payload import payload
from groundstation.viewers.scene_messages import static_scene
from groundstation.web.live_messages import fleet_message
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.config.flight_space import flight_space_of, outlines_of
from tests.groundstation.report.made_up import opened, rows, write

FENCES = """
[[fences]]
name = "field"
keep = "in"
polygon_enu_m = [[-3, -3], [3, -3], [0, 3.5], [-3, 3]]
height_m = [0.0, 2.5]

[[fences]]
name = "tree"
keep = "out"
circle = { center_enu_m = [1, -2.5], radius_m = 0.2 }
"""
CORNERS = [(-3.0, -3.0), (3.0, -3.0), (0.0, 3.5), (-3.0, 3.0)]


def text_of(fences: str) -> str:
    return Path("configs/fleets/paper.toml").read_text() + fences


def fleet(fences: str = FENCES) -> FleetConfig:
    return fleet_from_mapping(tomllib.loads(text_of(fences)))


def check_areas(areas: list[dict[str, Any]]) -> None:
    field, tree = areas
    assert (field["name"], field["keeps_in"]) == ("field", True)
    assert [tuple(corner) for corner in field["corners_enu_m"]] == CORNERS
    assert (field["low_m"], field["high_m"]) == (0.0, 2.5)

    # a circle has corners all around, and heights as far as the box's
    assert (tree["name"], tree["keeps_in"]) == ("tree", False)
    away_m = np.hypot(*(np.array(tree["corners_enu_m"]) - (1.0, -2.5)).T)
    assert away_m == pytest.approx(0.2)
    assert (tree["low_m"], tree["high_m"]) == (0.0, 3.0)


def test_a_report_and_a_live_page_have_the_areas_of_the_fleet(tmp_path: Path) -> None:
    folder = write(tmp_path / "flight", rows(length_s=2.0), fleet=text_of(FENCES))
    report, _ = opened(payload(read_flight(folder), made_by="a test"))
    check_areas(report["fleet"]["areas"])
    check_areas(fleet_message(fleet(), can_order=False)["areas"])
    assert fleet_message(fleet(""), can_order=False)["areas"] == []


def test_viewers_get_an_outline_below_and_above_for_each_area() -> None:
    entities = {one.id: one for one in static_scene(fleet(), 1).entities}
    (field_id,) = [one for one in entities if "field" in one]
    below, above = entities[field_id].lines
    assert [(one.x, one.y, one.z) for one in below.points] == [(*one, 0.0) for one in CORNERS]
    assert {one.z for one in above.points} == {2.5}
    assert len(static_scene(fleet(""), 1).entities) == len(entities) - 2


def test_the_console_draws_the_edges_of_a_field() -> None:
    window = Window(x_m=0.0, y_m=0.0, scale=8.0, width=40, height=20)

    def drawn(fences: str) -> str:
        return "\n".join(
            "".join(segment.text for segment in strip)
            for strip in draw_background(window, fleet(fences)).strips()
        )

    with_fences = drawn(FENCES).splitlines()
    without = drawn("").splitlines()
    changed = [row for row, line in enumerate(with_fences) if line != without[row]]
    # the slanted edge crosses rows from the northern corner, 3.5 m above the middle, to the south
    assert min(changed) <= 4
    assert max(changed) >= 15
    assert len(changed) > 10


def test_the_plan_figure_has_a_patch_and_a_name_for_each_area() -> None:
    flight = FlightData(
        title="made up",
        tracks=(),
        safety_distance_m=0.8,
        grid_s=np.arange(0.0, 2.0, 0.02),
        pairs=(),
        take_off_s=0.0,
        outlines=flight_space_of(fleet()).outlines(),
    )
    (axes,) = draw(flight).axes
    shapes = [patch.get_xy()[:-1].tolist() for patch in axes.patches]
    assert [tuple(corner) for corner in shapes[0]] == CORNERS
    assert len(shapes[1]) == 48
    assert {text.get_text() for text in axes.texts} >= {"field", "tree"}


OBSTACLES = """
[[obstacles]]
name = "wall"
polygon_enu_m = [[-0.1, 1], [0.1, 1], [0.1, 4], [-0.1, 4]]

[[obstacles]]
name = "pillar"
circle = { center_enu_m = [1, -3], radius_m = 0.25 }
"""


def test_the_live_page_and_the_plan_have_the_obstacles_too() -> None:
    with_obstacles = fleet(OBSTACLES)
    wall, pillar = fleet_message(with_obstacles, can_order=False)["areas"]
    assert (wall["name"], wall["keeps_in"]) == ("wall", False)
    assert [tuple(corner) for corner in wall["corners_enu_m"]] == [
        (-0.1, 1.0),
        (0.1, 1.0),
        (0.1, 4.0),
        (-0.1, 4.0),
    ]
    away_m = np.hypot(*(np.array(pillar["corners_enu_m"]) - (1.0, -3.0)).T)
    assert away_m == pytest.approx(0.25)
    assert (pillar["low_m"], pillar["high_m"]) == (0.0, 3.0)  # as high as the box

    names = [outline.name for outline in outlines_of(fleet(FENCES + OBSTACLES))]
    assert names == ["field", "tree", "wall", "pillar"]
