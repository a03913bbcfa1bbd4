"""The table of the flight: complete where it must be, and nobody else writes a flight."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from onboard.agent.warm_up import warm_up
from onboard.flight.context import FlightContext
from onboard.flight.flight_table import ROWS, TABLE
from onboard.flight.state_machine import accepts
from onboard.flight.types import FlightEvent, FlightStep
from onboard.safety.failsafe_table import TABLE as FAILSAFE_TABLE
from onboard.safety.failsafe_table import Action, Condition
from tests.onboard.agent.rig import fleet

ROOT = Path(__file__).parents[3]
EVENTS = {
    Action.LAND: FlightEvent.FAILSAFE_LAND,
    Action.PX4_LAND: FlightEvent.FAILSAFE_PX4_LAND,
    Action.DISARM: FlightEvent.FAILSAFE_DISARM,
    Action.STOP: FlightEvent.FAILSAFE_STOP,
}


def test_every_step_can_be_reached_and_left() -> None:
    reached = {FlightStep.WAITING} | {row.to for row in ROWS}
    for step in FlightStep:
        assert step in reached, step.name
        assert any(row.to not in (None, step) for row in ROWS if step in row.steps), step.name


def test_kill_is_possible_in_every_step() -> None:
    for step in FlightStep:
        assert accepts(step, "kill"), step.name


def test_a_row_without_a_predicate_hides_no_row_behind_it() -> None:
    for (step, event), rows in TABLE.items():
        assert all(row.when is not None for row in rows[:-1]), (step.name, event.name)


def test_what_the_failsafe_table_asks_for_is_possible_or_done_already() -> None:
    done = {
        Action.LAND: ("landing",),
        Action.PX4_LAND: ("landing",),
        Action.DISARM: (),
        Action.STOP: (),
    }
    for step in FlightStep:
        for condition in Condition:
            action = FAILSAFE_TABLE[step.situation, condition]
            if action not in EVENTS:
                continue
            is_possible = (step, EVENTS[action]) in TABLE
            assert is_possible or step.state in done[action], (step.name, condition.name)


def test_a_step_without_setpoints_is_never_flown_by_the_law() -> None:
    for step in FlightStep:
        if not step.is_streaming:
            assert step.control_mode.name == "GROUND", step.name


def _stores(path: Path) -> Iterator[ast.Attribute]:
    text = path.read_text(encoding="utf-8")
    if "flight." not in text:
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node


def test_nobody_outside_the_room_writes_a_flight_and_only_the_state_machine_writes_its_step() -> (
    None
):
    fields = set(FlightContext.__dataclass_fields__)
    for path in [
        *(ROOT / "onboard").rglob("*.py"),
        *(ROOT / "sitl" / "lockstep").rglob("*.py"),
        *ROOT.glob("tests/**/*.py"),
    ]:
        room = path.relative_to(ROOT).parent.as_posix()
        for node in _stores(path):
            owner = (
                node.value.attr
                if isinstance(node.value, ast.Attribute)
                else getattr(node.value, "id", "")
            )
            if owner.lstrip("_") != "flight" or node.attr not in fields:
                continue
            assert room == "onboard/flight", f"{path}:{node.lineno} writes a flight's {node.attr}"
            assert node.attr != "step" or path.name == "state_machine.py", (
                f"{path}:{node.lineno} writes the step"
            )


def test_the_throw_away_core_gets_into_the_air() -> None:
    assert warm_up(fleet(), "mav0")
