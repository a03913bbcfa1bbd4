"""What is in the way of a vehicle that does not arrive at its goal."""

from __future__ import annotations

import pytest

from groundstation.fleet.state import FleetState, fold, initial
from groundstation.orders.obstruction import in_the_way
from onboard.config.fleet import FleetConfig
from tests.groundstation.conftest import telemetry

S = 1_000_000_000
GOAL = (1.5, 0.0, 1.0)
STANDING = {
    "state": "ready",
    "is_airborne": False,
    "is_armed": False,
    "position_enu_m": (1.5, 0.2, 0.0),
}


def _state(fleet: FleetConfig, **flying: object) -> FleetState:
    """mav1 was seen at the goal of mav0 at 0 s, and mav0 flies at 10 s."""
    state = fold(initial(fleet), telemetry("mav1", **STANDING), 0)
    flies = telemetry("mav0", position_enu_m=(0.0, 0.0, 1.0), **flying)
    return fold(state, flies, 10 * S)


@pytest.mark.parametrize("is_heard", [True, False])
def test_a_vehicle_without_a_position_is_in_the_way_where_it_was_last_seen(
    fleet: FleetConfig, is_heard: bool
) -> None:
    state = _state(fleet)
    if is_heard:
        lost = telemetry("mav1", **STANDING, is_position_valid=False, sequence=2)
        state = fold(state, lost, 10 * S)
    assert in_the_way(fleet, state, "mav0", GOAL, 10 * S) == (
        "It is 1.50 m from its goal. In its way: mav1 on the ground, last seen 1.51 m from it and"
        " 0.20 m from the goal."
    )
    known = fold(state, telemetry("mav1", **STANDING, sequence=3), 10 * S)
    assert "mav1 on the ground, 1.51 m from it" in in_the_way(fleet, known, "mav0", GOAL, 10 * S)


def test_a_vehicle_without_a_position_that_another_one_replaces_is_not_in_the_way(
    fleet: FleetConfig,
) -> None:
    stands_in = telemetry(
        "mav2", stands_in_for="mav1", position_enu_m=(0.0, -3.0, 1.0), is_airborne=True
    )
    state = fold(_state(fleet), stands_in, 10 * S)
    assert "Nothing known is in its way." in in_the_way(fleet, state, "mav0", GOAL, 10 * S)


def test_a_vehicle_that_gives_way_to_one_beside_its_way_is_not_said_to_have_a_free_way(
    fleet: FleetConfig,
) -> None:
    state = _state(fleet, avoids="mav2", intervention_m_s2=1.25)
    assert in_the_way(fleet, state, "mav0", (-1.5, 0.0, 1.0), 10 * S) == (
        "It is 1.50 m from its goal. It gives way to mav2 by 1.2 m/s²."
    )


@pytest.mark.parametrize(
    ("knows_its_place", "words"),
    [
        (True, "which is on the ground."),
        (False, "which is on the ground, and its place is not known exactly."),
    ],
)
def test_a_vehicle_that_is_kept_from_one_on_the_ground_says_so(
    fleet: FleetConfig, knows_its_place: bool, words: str
) -> None:
    """One that has landed without a position is avoided far around its last place."""
    state = _state(fleet, avoids="mav1", intervention_m_s2=0.9)
    landed = telemetry("mav1", **STANDING, is_position_valid=knows_its_place, sequence=2)
    state = fold(state, landed, 10 * S)
    assert in_the_way(fleet, state, "mav0", (-1.5, 0.0, 1.0), 10 * S).endswith(
        f"It gives way to mav1 by 0.9 m/s², {words}"
    )
