"""The validator of a body's samples: jumps, repetitions, lateness and clocks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.localization.pose_validator import PoseValidator, PoseVerdict, Px4Evidence

TICK_NS = 20_000_000
START_NS = 10**9
LEVEL = (1.0, 0.0, 0.0, 0.0)


def vec3(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


CONTRADICTED = Px4Evidence(is_contradicted=True)


def circle(
    tick: int, rng: np.random.Generator, noise_m: float = 0.003
) -> tuple[float, float, float]:
    """A vehicle that flies round a circle of 1 m at 1 m/s."""
    angle = 0.02 * tick
    return vec3(np.array([math.cos(angle), math.sin(angle), 1.0]) + noise_m * rng.normal(size=3))


def judge(
    validator: PoseValidator, tick: int, position: tuple[float, float, float], **changes: Any
) -> PoseVerdict:
    stamp_ns = changes.get("stamp_ns", START_NS + tick * TICK_NS)
    return validator.judge(
        position,
        changes.get("attitude", LEVEL),
        stamp_ns,
        changes.get("received_ns", stamp_ns + TICK_NS),
        evidence=changes.get("evidence", Px4Evidence()),
    )


def settled(
    ticks: int = 100, seed: int = 0, noise_m: float = 0.003
) -> tuple[PoseValidator, np.random.Generator]:
    rng = np.random.default_rng(seed)
    validator = PoseValidator()
    for tick in range(ticks):
        judge(validator, tick, circle(tick, rng, noise_m))
    return validator, rng


def test_ordinary_flight_is_believed_for_minutes_and_over_lost_samples() -> None:
    rng = np.random.default_rng(1)
    validator = PoseValidator()
    for tick in range(10_000):
        if rng.random() > 0.2:
            assert judge(validator, tick, circle(tick, rng)) is PoseVerdict.ACCEPTED


def test_a_noisier_capture_is_learned_within_two_seconds() -> None:
    validator, rng = settled(100, noise_m=0.03)
    assert (
        sum(
            judge(validator, tick, circle(tick, rng, 0.03)) is not PoseVerdict.ACCEPTED
            for tick in range(100, 600)
        )
        < 5
    )


@given(
    jump_m=st.floats(0.1, 50.0),
    direction_rad=st.floats(-math.pi, math.pi),
    seed=st.integers(0, 1000),
)
def test_a_jump_is_rejected_at_its_first_sample_and_leaves_the_expected_motion(
    jump_m: float, direction_rad: float, seed: int
) -> None:
    validator, rng = settled(seed=seed)
    x, y, z = circle(100, rng)
    there = (x + jump_m * math.cos(direction_rad), y + jump_m * math.sin(direction_rad), z)
    assert judge(validator, 100, there) is PoseVerdict.JUMPED
    assert validator.jumps == 1
    assert validator.jumped_to_enu_m == there
    assert judge(validator, 101, circle(101, rng)) is PoseVerdict.ACCEPTED
    assert validator.jumps == 0


def test_after_a_jump_for_good_the_new_place_is_believed_only_where_nobody_contradicts() -> None:
    for evidence in (CONTRADICTED, Px4Evidence(is_contradicted=False)):
        validator, rng = settled()
        verdicts = []
        for tick in range(100, 250):
            x, y, z = circle(tick, rng)
            verdicts.append(judge(validator, tick, (x + 1.0, y - 1.0, z), evidence=evidence))
        assert (verdicts[-1] is PoseVerdict.JUMPED) == evidence.is_contradicted


def test_a_single_wild_sample_costs_no_good_one_after_it_whatever_another_source_says() -> None:
    validator, rng = settled()
    assert judge(validator, 100, (9.0, 9.0, 1.0)) is PoseVerdict.JUMPED
    for tick in range(101, 110):
        assert (
            judge(validator, tick, circle(tick, rng), evidence=CONTRADICTED) is PoseVerdict.ACCEPTED
        )


def test_a_jump_that_lasts_is_three_in_a_row_within_a_tenth_of_a_second() -> None:
    validator, rng = settled()
    for tick in range(100, 103):
        x, y, z = circle(tick, rng)
        judge(validator, tick, (x + 1.0, y, z))
    assert validator.jumps == 3


def test_a_body_that_hits_the_floor_is_believed_all_the_way_and_when_it_lies_there() -> None:
    validator = PoseValidator()
    rng = np.random.default_rng(0)
    for tick in range(100):
        fallen_s = max(0.0, 0.02 * (tick - 50))
        height_m = max(0.0, 1.0 - 4.9 * fallen_s**2)
        position = vec3(np.array([0.0, 0.0, height_m]) + 0.003 * rng.normal(size=3))
        assert judge(validator, tick, position) is PoseVerdict.ACCEPTED


def test_after_a_gap_a_body_is_believed_where_it_can_have_flown() -> None:
    validator, rng = settled()
    assert judge(validator, 150, circle(150, rng)) is PoseVerdict.UNCONFIRMED
    assert judge(validator, 151, circle(151, rng)) is PoseVerdict.ACCEPTED


def test_an_old_sample_with_a_new_stamp_after_an_outage_costs_the_true_ones_nothing() -> None:
    validator, rng = settled()
    old = circle(99, rng)
    assert judge(validator, 200, old) is PoseVerdict.UNCONFIRMED
    verdicts = [judge(validator, tick, circle(tick, rng)) for tick in range(201, 210)]
    assert verdicts == [PoseVerdict.UNCONFIRMED, *[PoseVerdict.ACCEPTED] * 8]


@pytest.mark.parametrize("outage_s", [0.5, 2.0])
def test_samples_after_an_outage_that_px4_excludes_need_half_a_second_of_agreement(
    outage_s: float,
) -> None:
    """After a short outage PX4 is right."""
    validator, rng = settled()
    begin = 100 + round(outage_s / 0.02)
    verdicts = [
        judge(validator, tick, circle(tick, rng), evidence=CONTRADICTED)
        for tick in range(begin, begin + 30)
    ]
    if outage_s < 1.0:
        assert verdicts == [PoseVerdict.UNCONFIRMED] * 30
        assert validator.doubts == 0
    else:
        assert verdicts == [PoseVerdict.UNCONFIRMED] * 24 + [PoseVerdict.ACCEPTED] * 6
        assert validator.doubts == 1


@pytest.mark.parametrize("jump_deg", [-170.0, 15.0, 25.0])
def test_a_heading_that_px4_does_not_explain_is_a_jump(jump_deg: float) -> None:
    validator, rng = settled()
    evidence = Px4Evidence(heading_jump_rad=math.radians(jump_deg))
    half_rad = math.radians(0.5 * jump_deg)
    flipped = (math.cos(half_rad), 0.0, 0.0, math.sin(half_rad))
    verdicts = [
        judge(validator, tick, circle(tick, rng), attitude=attitude, evidence=evidence)
        for tick, attitude in ((130, flipped), (131, flipped), (132, LEVEL), (133, LEVEL))
    ]
    # of a body that has not turned, PX4's heading has jumped
    assert verdicts[3] is PoseVerdict.ACCEPTED
    assert (verdicts[1] is PoseVerdict.ACCEPTED) == (abs(jump_deg) < 20.0)


def test_a_body_that_turns_round_between_two_samples_is_another_one() -> None:
    validator, rng = settled()
    half = math.sqrt(0.5)
    assert (
        judge(validator, 100, circle(100, rng), attitude=(half, 0.0, 0.0, half))
        is PoseVerdict.JUMPED
    )
    assert (
        judge(validator, 101, circle(101, rng), attitude=(-1.0, 0.0, 0.0, 0.0))
        is PoseVerdict.ACCEPTED
    )  # the same attitude


def test_identical_samples_are_frozen_within_a_tenth_of_a_second() -> None:
    validator, rng = settled()
    stuck = circle(100, rng)
    verdicts = [judge(validator, tick, stuck) for tick in range(100, 110)]
    assert verdicts[0] is PoseVerdict.ACCEPTED
    first = verdicts.index(PoseVerdict.FROZEN)
    assert (first - 1) * 20 <= 100  # ms after the first repetition
    assert all(verdict is PoseVerdict.FROZEN for verdict in verdicts[first:])
    assert validator.is_frozen
    judge(validator, 110, circle(110, rng))
    assert not validator.is_frozen


def test_late_samples_are_called_late_within_a_tenth_of_a_second_and_one_straggler_is_not() -> None:
    validator, rng = settled()
    judge(validator, 100, circle(100, rng), received_ns=START_NS + 100 * TICK_NS + 150_000_000)
    assert not validator.is_late
    for tick in range(101, 120):
        judge(validator, tick, circle(tick, rng))
    for tick in range(120, 126):
        judge(
            validator, tick, circle(tick, rng), received_ns=START_NS + tick * TICK_NS + 140_000_000
        )
    assert validator.is_late


def test_a_jump_of_the_senders_clock_is_noticed_when_it_has_lasted_for_a_moment() -> None:
    validator, rng = settled()
    assert validator.clock_jump_ns == 0
    heard_ns = []
    for tick in range(100, 130):
        stamp_ns = START_NS + (tick - 50) * TICK_NS
        now_ns = START_NS + tick * TICK_NS
        judge(validator, tick, circle(tick, rng), stamp_ns=stamp_ns, received_ns=now_ns)
        heard_ns += [now_ns] if validator.clock_jump_ns == now_ns else []
    assert heard_ns == [START_NS + (100 + 15) * TICK_NS]  # once, 0.3 s after it


def test_samples_that_a_busy_machine_held_up_are_no_jump_of_a_clock() -> None:
    validator, rng = settled()
    for tick in range(100, 150):  # nothing for a second, then all of it at once, and in time again
        judge(validator, tick, circle(tick, rng), received_ns=START_NS + max(tick, 149) * TICK_NS)
    for tick in range(150, 200):
        judge(validator, tick, circle(tick, rng))
    assert validator.clock_jump_ns == 0


@pytest.mark.parametrize("wrong_s", [2.0, 60.0])
@pytest.mark.parametrize("back_m", [0.0, 0.4])
def test_a_vehicle_that_stands_after_a_flight_is_believed_again_only_where_it_stood(
    wrong_s: float, back_m: float
) -> None:
    landed = Px4Evidence(is_after_landing=True)
    rng = np.random.default_rng(3)
    validator = PoseValidator()

    def seen(east_m: float, ticks: range) -> PoseVerdict:
        for tick in ticks:
            position = vec3(np.array([east_m, 0.0, 0.0]) + 0.001 * rng.normal(size=3))
            verdict = judge(validator, tick, position, evidence=landed)
        return verdict

    wrong_ticks = round(wrong_s / 0.02)
    assert seen(0.0, range(100)) is PoseVerdict.ACCEPTED
    assert seen(2.0, range(100, 100 + wrong_ticks)) is PoseVerdict.JUMPED
    back = seen(back_m, range(100 + wrong_ticks, 200 + wrong_ticks))
    assert (back is PoseVerdict.ACCEPTED) == (back_m == 0.0)

    # people may have carried it, and covered its markers
    later = range(300 + wrong_ticks, 400 + wrong_ticks)
    assert seen(back_m, later) is PoseVerdict.ACCEPTED


@pytest.mark.parametrize("off_s", [0.0, 60.0])
def test_px4s_heading_may_drift_while_the_mocap_is_off(off_s: float) -> None:
    validator, rng = settled()
    half_rad = math.radians(15.0)
    turned = (math.cos(half_rad), 0.0, 0.0, math.sin(half_rad))
    evidence = Px4Evidence(heading_jump_rad=math.radians(30.0))
    begin = 100 + round(off_s / 0.02)
    for tick in range(begin, begin + 3):
        verdict = judge(validator, tick, circle(tick, rng), attitude=turned, evidence=evidence)
    assert (verdict is PoseVerdict.ACCEPTED) == (off_s > 0.0)
