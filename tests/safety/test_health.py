"""Health: freshness bounds, and mocap bodies that jump, freeze and swap."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.safety import health
from onboard.safety.health import Freshness, MocapFault, MocapMemory, MocapParams

PARAMS = MocapParams()
TICK_NS = 20_000_000


@pytest.mark.parametrize(
    ("age_ms", "expected"),
    [(0, Freshness.FRESH), (60, Freshness.FRESH), (61, Freshness.LATE), (300, Freshness.LATE), (301, Freshness.STALE)],
)
def test_age_decides_freshness(age_ms: int, expected: Freshness) -> None:
    now = 10**12
    got = health.freshness(now, now - age_ms * 1_000_000, late_after_s=0.06, stale_after_s=0.3)
    assert got is expected


def test_what_was_never_seen_is_missing_and_a_stamp_from_the_future_is_fresh() -> None:
    assert health.freshness(5, None, late_after_s=1.0, stale_after_s=2.0) is Freshness.MISSING
    assert health.freshness(5, 10, late_after_s=1.0, stale_after_s=2.0) is Freshness.FRESH
    assert health.age_s(5, None) == float("inf")


def path(body: int, tick: int, rng: np.random.Generator) -> np.ndarray:
    """Two vehicles that fly circles at about 1 m/s, 1.2 m apart at least, seen with 3 mm of noise."""
    angle = 0.02 * tick + np.pi * body
    return np.array([np.cos(angle), np.sin(angle), 1.0]) * [1.0, 1.0, 1.0] + 0.003 * rng.normal(size=3)


def settled(ticks: int = 100, seed: int = 0) -> tuple[MocapMemory, np.random.Generator]:
    rng = np.random.default_rng(seed)
    memory = health.initial(2)
    for tick in range(ticks):
        for body in range(2):
            memory, fault = health.watch(memory, body, path(body, tick, rng), (tick + 1) * TICK_NS, params=PARAMS)
            assert fault is MocapFault.NONE
    return memory, rng


def test_ordinary_flight_is_believed_for_minutes() -> None:
    settled(ticks=6000, seed=1)


def test_swapped_bodies_are_called_swapped_at_the_first_sample() -> None:
    memory, rng = settled()
    for body in range(2):
        memory, fault = health.watch(memory, body, path(1 - body, 100, rng), 101 * TICK_NS, params=PARAMS)
        assert fault is MocapFault.SWAPPED


def test_swapped_bodies_stay_swapped_while_it_lasts_and_recover() -> None:
    memory, rng = settled()
    for tick in range(100, 108):
        for body in range(2):
            memory, fault = health.watch(memory, body, path(1 - body, tick, rng), (tick + 1) * TICK_NS, params=PARAMS)
            assert fault is MocapFault.SWAPPED
    memory, fault = health.watch(memory, 0, path(0, 108, rng), 109 * TICK_NS, params=PARAMS)
    assert fault is MocapFault.NONE


def test_a_jump_to_nowhere_is_a_jump_and_does_not_move_the_expectation() -> None:
    memory, rng = settled()
    before = memory.position_enu_m.copy()
    memory, fault = health.watch(memory, 0, np.array([3.0, 3.0, 1.0]), 101 * TICK_NS, params=PARAMS)
    assert fault is MocapFault.JUMPED
    assert np.array_equal(memory.position_enu_m, before)
    memory, fault = health.watch(memory, 0, path(0, 101, rng), 102 * TICK_NS, params=PARAMS)
    assert fault is MocapFault.NONE


def test_identical_samples_are_called_frozen_within_a_tenth_of_a_second() -> None:
    memory, rng = settled()
    stuck = path(0, 100, rng)
    faults = []
    for tick in range(100, 112):
        memory, fault = health.watch(memory, 0, stuck, (tick + 1) * TICK_NS, params=PARAMS)
        faults.append(fault)
    assert faults[0] is MocapFault.NONE
    assert MocapFault.FROZEN in faults[:6]
    assert all(fault is not MocapFault.NONE for fault in faults[5:])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_sample_that_is_not_finite_is_invalid(bad: float) -> None:
    memory, _ = settled(10)
    same, fault = health.watch(memory, 0, np.array([bad, 0.0, 0.0]), 11 * TICK_NS, params=PARAMS)
    assert fault is MocapFault.INVALID
    assert same is memory


def test_a_repeated_or_older_stamp_is_invalid() -> None:
    memory, rng = settled(10)
    for stamp in (10 * TICK_NS, 9 * TICK_NS):
        assert health.watch(memory, 0, path(0, 10, rng), stamp, params=PARAMS)[1] is MocapFault.INVALID


def test_after_a_gap_a_body_is_believed_where_it_can_have_flown() -> None:
    memory, rng = settled()
    memory, fault = health.watch(memory, 0, path(0, 150, rng), 151 * TICK_NS, params=PARAMS)
    assert fault is MocapFault.NONE
