"""A line, a step of a mission file and a call in Python are three ways to write one order."""

from __future__ import annotations

import inspect
from typing import Any

import msgspec
import pytest

from groundstation.mission_files.expected_course import resolved
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.group import Group
from groundstation.orders.grammar import parse
from groundstation.orders.intents import INTENTS, Intent
from onboard.config.fleet import FleetConfig

# a line -> the same order as a step of a mission file
STEPS: dict[str, dict[str, Any]] = {
    "arm mav0": {"do": "arm", "vehicles": "mav0"},
    "disarm 0-1": {"do": "disarm", "vehicles": "0-1"},
    "takeoff 1 1.2": {"do": "takeoff", "vehicles": "1", "height_m": 1.2},
    "move all 0 1 1.2 yaw 90 in 8": {
        "do": "move",
        "position_enu_m": [0.0, 1.0, 1.2],
        "yaw_deg": 90.0,
        "duration_s": 8.0,
    },
    "goto mav0 2 0 1 mav1 0 2 1": {
        "do": "goto",
        "goals": {"mav0": [2.0, 0.0, 1.0], "mav1": [0.0, 2.0, 1.0]},
    },
    "formation triangle 1.6 0 1 1 nearest turned 30": {
        "do": "formation",
        "name": "triangle",
        "spacing_m": 1.6,
        "position_enu_m": [0.0, 1.0, 1.0],
        "assign": "nearest",
        "rotation_deg": 30.0,
    },
    "rotate 90": {"do": "rotate", "angle_deg": 90.0},
    "yaw mav1 -90": {"do": "yaw", "vehicles": ["mav1"], "yaw_deg": -90.0},
    "home 0,2 1.5": {"do": "home", "vehicles": "0,2", "height_m": 1.5},
    "bring home 0,2 1.5": {"do": "bring_home", "vehicles": "0,2", "height_m": 1.5},
    "land": {"do": "land"},
    "hold mav2": {"do": "hold", "vehicles": "mav2"},
}
METHODS = {verb: verb for verb in INTENTS} | {"goto": "go_to"}


def step_of(table: dict[str, Any], fleet: FleetConfig) -> Intent:
    """Return the order of a step, flown when its vehicles can do it."""
    before = [{"do": "takeoff"}]
    if table["do"] in ("arm", "takeoff", "disarm"):
        before = []
    data = {"schema": 1, "step": [*before, table]}
    step = mission_from_mapping(data, path="test.toml", fleet=fleet).steps[-1]
    assert isinstance(step, Intent)
    return step


@pytest.mark.parametrize("line", STEPS)
def test_a_line_and_a_step_of_a_mission_file_make_the_same_order(
    line: str, fleet: FleetConfig
) -> None:
    step = step_of(STEPS[line], fleet)
    written = parse(line, fleet)
    from_file = resolved(step, fleet)
    assert msgspec.to_builtins(from_file) == msgspec.to_builtins(written)
    assert str(from_file) == str(written)


def test_each_verb_that_may_be_a_step_is_compared() -> None:
    compared = {table["do"] for table in STEPS.values()}
    assert compared == {verb for verb, intent in INTENTS.items() if intent.is_mission_step}


@pytest.mark.parametrize("verb", INTENTS)
def test_each_field_of_an_order_is_an_argument_of_its_method(verb: str) -> None:
    method = getattr(Group, METHODS[verb])
    arguments = inspect.signature(method).parameters
    intent = INTENTS[verb]

    # a speed is written in files only; planned fields are written nowhere
    fields = set(intent.__struct_fields__) - {"speed_m_s", *intent.planned_fields}
    if verb == "goto":
        fields -= {"vehicles"}  # its goals name them
    if verb == "swap":
        fields = fields - {"vehicles"} | {"vehicle", "spare"}
    assert fields == set(arguments) - {"self"}

    for field in msgspec.structs.fields(intent):
        if field.name not in fields or field.name == "timeout_s":
            continue
        argument = arguments[field.name]
        has_default = argument.default is not argument.empty
        if field.default is not msgspec.NODEFAULT and has_default:
            assert argument.default == field.default, field.name


def test_a_field_that_planning_fills_in_is_no_key_of_a_file(fleet: FleetConfig) -> None:
    for table, key in (
        ({**STEPS["rotate 90"], "center_enu_m": [0, 0, 1]}, "center_enu_m"),
        ({**STEPS["formation triangle 1.6 0 1 1 nearest turned 30"], "takes": {}}, "takes"),
    ):
        with pytest.raises(ValueError, match=f"unknown key .*{key}.*Known keys here"):
            step_of(table, fleet)
