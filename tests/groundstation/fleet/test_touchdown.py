"""The vertical speed at a first contact with the ground, and how large it may be."""

from __future__ import annotations

import msgspec
import pytest
from msgspec.structs import replace

from groundstation.fleet.state import fold, fold_truths, initial
from groundstation.fleet.touchdown import (
    LIMIT_BLIND_M_S,
    LIMIT_BY_POSES_M_S,
    LIMIT_BY_PX4_M_S,
    LIMIT_BY_SATELLITES_M_S,
    MAX_KEPT,
    Touchdown,
)
from onboard.config.fleet import load_fleet
from tests.groundstation.conftest import telemetry
from tests.groundstation.fleet.test_state import truth

FLEET = load_fleet("paper")
VEHICLE = FLEET.vehicles["mav0"]
BY_SATELLITES = msgspec.structs.replace(VEHICLE, mocap_required=False)


def landed(**changes: object) -> list[Touchdown]:
    """Fold telemetry, a flight and a contact with 0.9 m/s."""
    state = initial(FLEET)
    state = fold(state, telemetry("mav0", **{"mode": "OFFBOARD", **changes}), 1)

    state = fold(state, truth("mav0", 1, 0.0), 2)
    contact = msgspec.structs.replace(truth("mav0", 2, 0.0), touchdowns=1, touchdown_m_s=0.9)
    state = fold(state, contact, 3)
    state = fold(state, msgspec.structs.replace(contact, stamp_ns=3), 4)
    return list(state.touchdowns)


def test_each_contact_counts_once() -> None:
    (touchdown,) = landed()
    assert touchdown.speed_m_s == 0.9
    assert touchdown.is_hard(VEHICLE)
    assert not touchdown.is_hard(BY_SATELLITES)


@pytest.mark.parametrize(
    "changes", [{"is_position_valid": False}, {"conditions": ("own position lost",)}]
)
def test_a_landing_without_a_position_may_be_harder(changes: dict[str, object]) -> None:
    (touchdown,) = landed(**changes)
    assert touchdown.limit_m_s(VEHICLE) == LIMIT_BLIND_M_S
    assert not touchdown.is_hard(VEHICLE)


@pytest.mark.parametrize(("seen_before_s", "is_blind"), [(0.2, True), (1.5, False)])
def test_who_sees_again_just_before_the_ground_comes_down_as_it_did_without(
    seen_before_s: float, is_blind: bool
) -> None:
    state = fold(initial(FLEET), telemetry("mav0", sequence=1, is_position_valid=False), 1)
    state = fold(state, telemetry("mav0", sequence=2, mode="OFFBOARD"), 2)

    contact_ns = round(seen_before_s * 1e9)
    state = fold(state, telemetry("mav0", sequence=3, mode="OFFBOARD"), contact_ns - 2)
    state = fold(state, truth("mav0", 1, 0.0), contact_ns - 1)
    contact = msgspec.structs.replace(truth("mav0", 2, 0.0), touchdowns=1, touchdown_m_s=0.9)
    state = fold(state, contact, contact_ns)
    assert state.touchdowns[0].is_blind == is_blind


@pytest.mark.parametrize(("age_s", "is_blind"), [(0.25, False), (0.6, True)])
def test_a_vehicle_that_is_cut_off_may_have_lost_its_position(age_s: float, is_blind: bool) -> None:
    state = fold(initial(FLEET), telemetry("mav0", mode="OFFBOARD"), 1)
    contact_ns = round(age_s * 1e9)
    state = fold(state, truth("mav0", 1, 0.0), contact_ns - 1)
    contact = msgspec.structs.replace(truth("mav0", 2, 0.0), touchdowns=1, touchdown_m_s=0.9)
    state = fold(state, contact, contact_ns)
    assert state.touchdowns[0].is_blind is is_blind


@pytest.mark.parametrize(
    "changes", [{"mode": "LAND"}, {"autopilot_age_s": 2.0}, {"state": "failed"}]
)
def test_a_landing_by_px4_alone_is_judged_by_what_px4_can(changes: dict[str, object]) -> None:
    (touchdown,) = landed(**changes)
    assert touchdown.limit_m_s(VEHICLE) == LIMIT_BY_PX4_M_S


def test_what_the_simulator_knows_of_px4_counts_before_a_mode_that_is_told_once_a_second() -> None:
    state = fold(initial(FLEET), telemetry("mav0", mode="OFFBOARD"), 1)
    state = fold(state, truth("mav0", 1, 0.0), 2)
    contact = msgspec.structs.replace(
        truth("mav0", 2, 0.0), touchdowns=1, touchdown_m_s=0.9, is_flown_by_agent=False
    )
    (touchdown,) = fold(state, contact, 3).touchdowns
    assert touchdown.limit_m_s(VEHICLE) == LIMIT_BY_PX4_M_S


def test_each_way_to_fly_has_its_limit() -> None:
    touchdown = Touchdown("mav0", 1, 0.9)
    assert touchdown.limit_m_s(VEHICLE) == LIMIT_BY_POSES_M_S
    assert touchdown.limit_m_s(BY_SATELLITES) == LIMIT_BY_SATELLITES_M_S


def test_who_has_lost_thrust_falls() -> None:
    fall = Touchdown("mav0", 1, 5.0, had_thrust=False)
    assert not fall.is_hard(VEHICLE)
    assert fall.has_fallen(VEHICLE)
    assert "mav0 fell, and hit the ground with 5.00 m/s" in fall.sentence(VEHICLE)


def test_who_ends_its_thrust_on_the_ground_has_not_fallen() -> None:
    assert not Touchdown("mav0", 1, 0.3, had_thrust=False).has_fallen(VEHICLE)


def test_a_contact_counts_when_its_ground_truth_comes_twice_in_a_batch() -> None:
    state = fold(initial(FLEET), truth("mav0", 1, 0.0), 1)
    contact = msgspec.structs.replace(truth("mav0", 2, 0.0), touchdowns=1, touchdown_m_s=0.9)

    state = fold_truths(state, (contact, contact), 2)

    assert [touchdown.speed_m_s for touchdown in state.touchdowns] == [0.9]


def test_falls_and_hard_landings_outlast_any_number_of_soft_ones() -> None:
    fall = Touchdown("mav0", 1, 5.0, had_thrust=False)
    hard = Touchdown("mav1", 2, 0.9)
    by_px4 = Touchdown("mav2", 3, 1.2, is_by_px4=True)

    state = replace(initial(FLEET), touchdowns=(fall, by_px4, hard, *[by_px4] * (MAX_KEPT - 3)))
    state = fold(state, truth("mav0", 1, 0.0), 1)
    for number in (1, 2):
        contact = replace(
            truth("mav0", 1 + number, 0.0), touchdowns=number, touchdown_m_s=2.0, had_thrust=False
        )
        state = fold(state, contact, 1 + number)

    assert len(state.touchdowns) == MAX_KEPT
    assert state.touchdowns[:2] == (fall, hard)
    assert [touchdown.speed_m_s for touchdown in state.touchdowns[-2:]] == [2.0, 2.0]
