"""Formations whose slots are assigned anew, with a spare that has the place of another vehicle."""

from __future__ import annotations

import msgspec
import pytest

from groundstation.fleet import state as fleet_state
from groundstation.orders.grammar import parse
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.plan import PlannedOrder, plan_order
from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz
from tests.groundstation.conftest import telemetry

PAIR = {"mav0": (-1.0, 0.0, 0.0), "mav1": (1.0, 0.0, 0.0)}


@pytest.fixture
def pair(fleet: FleetConfig) -> FleetConfig:
    """A fleet of three whose formation has slots for two; the third is the spare."""
    return msgspec.structs.replace(fleet, formations={"pair": PAIR})


def flying(pair: FleetConfig) -> fleet_state.FleetState:
    """The spare mav2 flies in the place of mav1, each vehicle beside the slot of the other."""
    state = fleet_state.initial(pair)
    for message in (
        telemetry("mav0", state="flying", is_airborne=True, position_enu_m=(1.2, 0.0, 1.0)),
        telemetry("mav1", disabled_by="ada", position_enu_m=(5.0, 5.0, 0.0)),
        telemetry(
            "mav2",
            state="flying",
            is_airborne=True,
            position_enu_m=(-1.2, 0.0, 1.0),
            stands_in_for="mav1",
        ),
    ):
        message = msgspec.structs.replace(message, goal_position_enu_m=message.position_enu_m)
        state = fleet_state.fold(state, message, 1000)
    return state


def ordered(
    pair: FleetConfig, state: fleet_state.FleetState, line: str, held: HeldFormation
) -> PlannedOrder:
    return plan_order(parse(line, pair), pair, state, held=held, author="ada", now_ns=2000)


def goals(planned: PlannedOrder) -> dict[str, Xyz | None]:
    assert not planned.refusals
    return {name: order.position_enu_m for name, order in planned.orders.items()}


def test_a_move_keeps_the_slots_that_a_spare_and_the_others_have_got(pair: FleetConfig) -> None:
    state = flying(pair)
    taken_up = ordered(pair, state, "formation pair 0 0 1 nearest", HeldFormation("pair"))
    assert goals(taken_up) == {"mav0": (1.0, 0.0, 1.0), "mav2": (-1.0, 0.0, 1.0)}

    moved = ordered(pair, state, "move all 0 1 1", taken_up.held)
    assert goals(moved) == {"mav0": (1.0, 1.0, 1.0), "mav2": (-1.0, 1.0, 1.0)}


def test_a_preview_with_a_spare_keeps_its_goals_when_it_is_planned_again(pair: FleetConfig) -> None:
    state = flying(pair)
    first = ordered(pair, state, "formation pair 0 0 1 nearest", HeldFormation("pair"))
    again = plan_order(
        first.intent, pair, state, held=HeldFormation("pair"), author="ada", now_ns=3000
    )
    assert goals(again) == goals(first)


def test_vehicles_that_were_not_assigned_anew_keep_their_slots_in_the_next_move(
    fleet: FleetConfig,
) -> None:
    triangle = HeldFormation("triangle")
    some = plan_order(
        parse("formation triangle 0-1 0 0 1 nearest", fleet),
        fleet,
        None,
        held=triangle,
        author="ada",
        now_ns=0,
    )
    moved = plan_order(
        parse("move all 0 0.5 1", fleet), fleet, None, held=some.held, author="ada", now_ns=0
    )
    assert set(goals(some)) == {"mav0", "mav1"}
    assert set(goals(moved)) == {"mav0", "mav1", "mav2"}


def test_a_spare_without_a_slot_that_an_order_names_is_refused(pair: FleetConfig) -> None:
    state = fleet_state.initial(pair)
    for name, start_enu_m in (("mav0", (1.0, 0.0, 1.0)), ("mav1", (-1.0, 0.0, 1.0))):
        message = telemetry(name, state="flying", is_airborne=True, position_enu_m=start_enu_m)
        state = fleet_state.fold(state, message, 1000)
    state = fleet_state.fold(state, telemetry("mav2", position_enu_m=(5.0, 5.0, 0.0)), 1000)

    to_all = ordered(pair, state, "formation pair 0 0.5 1", HeldFormation("pair"))
    assert set(goals(to_all)) == {"mav0", "mav1"}
    named = ordered(pair, state, "formation pair 0-2 0 0.5 1", HeldFormation("pair"))
    assert "has no slot" in named.refusals["mav2"]
    assert not named.orders
