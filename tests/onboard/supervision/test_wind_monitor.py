"""What counts as being pushed about: more than the gusts in which the vehicle may fly."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

import pytest
from msgspec.structs import replace

from onboard.config.fleet import load_fleet
from onboard.config.wind_limit import (
    GUST_SHARE,
    GUSTY,
    largest_push_m_s2,
    tilt_acceleration_m_s2,
    wind_limit_m_s,
)
from onboard.localization.own_state import OwnState
from onboard.supervision.tick_context import TickContext
from onboard.supervision.wind_monitor import WindFacts, WindMonitor
from sitl.physics.wind import Wind, WindSettings

FLEET = load_fleet("sih")
VEHICLE = FLEET.vehicles["mav0"]


@dataclass
class Own:
    """The part of the own state that the monitor reads."""

    gust_m_s2: float
    wind_enu_m_s: tuple[float, float] = (0.0, 0.0)


def context_of(**facts: Any) -> TickContext:
    return TickContext(own=None, **facts)  # type: ignore[arg-type]


def looked(
    monitor: WindMonitor, wind_enu_m_s: tuple[float, float] = (0.0, 0.0), **facts: Any
) -> WindFacts:
    return monitor.facts(cast(OwnState, Own(0.0, wind_enu_m_s)), context_of(**facts))


def hovering(gust_m_s2: float, scatter_m: float) -> WindFacts:
    """Return the facts after a long hover beside the setpoint."""
    monitor = WindMonitor(FLEET, VEHICLE)
    context = context_of(setpoint_miss_m=scatter_m)
    for _ in range(1000):
        monitor.update(context, 0.02)
    return monitor.facts(cast(OwnState, Own(gust_m_s2)), context)


# scatters of SIH's vehicles that hovered for 20 s in these gusts, the largest of three
@pytest.mark.parametrize(("wind_m_s", "scatter_m"), [(2.0, 0.084), (2.7, 0.117), (3.0, 0.153)])
def test_in_the_gusts_of_a_wind_that_is_allowed_nobody_counts_as_pushed_about(
    wind_m_s: float, scatter_m: float
) -> None:
    assert wind_m_s < wind_limit_m_s(FLEET, VEHICLE) + 0.05
    gust_m_s2 = GUST_SHARE * wind_m_s * VEHICLE.drag_1_s
    assert not hovering(gust_m_s2, scatter_m).is_pushed_about


def test_who_scatters_by_more_than_others_keep_in_its_gusts_is_pushed_about() -> None:
    assert hovering(0.3, 0.30).is_pushed_about
    assert not hovering(0.1, 0.20).is_pushed_about  # something else than gusts moves it
    assert hovering(0.9, 0.0).is_pushed_about


def flown(
    monitor: WindMonitor, miss_m: float, seconds: float, *, is_law_active: bool = False
) -> WindFacts:
    """Return the facts after some time at one distance from the setpoint, in gusts of 0.2 m/s^2."""
    context = context_of(setpoint_miss_m=miss_m, is_law_active=is_law_active)
    for _ in range(round(seconds / 0.02)):
        monitor.update(context, 0.02)
    return monitor.facts(cast(OwnState, Own(0.2)), context)


def test_the_way_back_after_the_law_has_moved_a_vehicle_is_no_scatter() -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    flown(monitor, 0.05, 5.0)
    flown(monitor, 0.5, 1.0, is_law_active=True)
    assert not flown(monitor, 0.45, 2.5).is_pushed_about
    assert not flown(monitor, 0.04, 0.1).is_pushed_about


def test_who_does_not_come_back_after_the_law_has_acted_is_pushed_about() -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    flown(monitor, 0.05, 5.0)
    flown(monitor, 0.5, 1.0, is_law_active=True)
    assert flown(monitor, 0.45, 5.0).is_pushed_about


def test_scatter_counts_again_as_soon_as_the_vehicle_is_back() -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    flown(monitor, 0.05, 5.0)
    flown(monitor, 0.5, 1.0, is_law_active=True)
    flown(monitor, 0.04, 0.1)
    assert flown(monitor, 0.45, 2.0).is_pushed_about


def first_above(winds_m_s: Iterable[float]) -> float:
    """Return the mean wind at which it is above first, looked at ten times a second; NaN: never."""
    monitor = WindMonitor(FLEET, VEHICLE)
    context = context_of()
    for wind_m_s in winds_m_s:
        facts = monitor.facts(cast(OwnState, Own(0.0, (wind_m_s, 0.0))), context)
        if facts.is_above:
            return wind_m_s
    return math.nan


def test_a_wind_that_rises_is_above_sooner_than_one_that_is_there() -> None:
    limit_m_s = wind_limit_m_s(FLEET, VEHICLE)
    there = [0.01 * step for step in range(600)]  # each of them for long
    at_m_s = first_above(wind for wind in there for _ in range(400))
    assert at_m_s == pytest.approx(GUSTY * limit_m_s, abs=0.02)

    # to twice the limit within 20 s
    rising = [0.1 * second * limit_m_s / 10.0 for second in range(200)]
    assert 0.9 * limit_m_s < first_above(rising) < 1.15 * limit_m_s


@pytest.mark.parametrize("seed", range(5))
def test_gusts_of_a_wind_that_is_allowed_are_no_rise(seed: int) -> None:
    settings = WindSettings((2.6, 0.0, 0.0), gust_std_m_s=GUST_SHARE * 2.6)
    gusty = Wind(1, settings, seed=seed, step_s=0.1)
    mean_m_s = 2.6
    means_m_s = []
    for _ in range(1200):
        mean_m_s += 0.05 * (gusty.step()[0, 1] - mean_m_s)  # over two seconds
        means_m_s.append(float(mean_m_s))
    assert math.isnan(first_above(means_m_s))


# the wind that takes all of the tilt
SPENT_M_S = tilt_acceleration_m_s2(VEHICLE) / VEHICLE.drag_1_s


def test_the_first_wind_that_is_known_is_no_rise() -> None:
    assert not looked(WindMonitor(FLEET, VEHICLE), (0.6 * SPENT_M_S, 0.0)).is_rising


def test_a_rise_between_the_first_two_looks_counts_from_their_plain_mean() -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    looked(monitor)
    # half of it above the mean, and that for eight sixths more
    assert looked(monitor, (0.6 * SPENT_M_S, 0.0)).is_rising


def test_a_wind_that_is_known_again_is_no_rise() -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    for _ in range(100):
        looked(monitor)
    looked(monitor, (math.nan, math.nan))
    assert not looked(monitor, (0.6 * SPENT_M_S, 0.0)).is_rising


def test_a_vehicle_of_little_drag_has_a_wind_that_takes_its_tilt_too() -> None:
    slender = replace(VEHICLE, drag_1_s=0.05)
    spent_m_s = tilt_acceleration_m_s2(slender) / slender.drag_1_s
    assert looked(WindMonitor(FLEET, slender), (spent_m_s, 0.0)).is_rising


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_push_at_its_bound_is_seen_in_each_direction(axis: int, sign: float) -> None:
    push_enu_m_s2 = [0.0, 0.0, 0.0]
    push_enu_m_s2[axis] = sign * largest_push_m_s2(VEHICLE)
    monitor = WindMonitor(FLEET, VEHICLE)
    assert looked(monitor, disturbance_enu_m_s2=tuple(push_enu_m_s2)).is_at_bound
    assert not looked(monitor, disturbance_enu_m_s2=(0.0, 0.0, push_enu_m_s2[axis])).is_at_bound


def test_the_scatter_is_of_this_hover_without_the_laws_evasions() -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    assert looked(monitor).scatter_m == 0.0
    monitor.update(context_of(setpoint_miss_m=0.3, is_law_active=True), 0.02)
    monitor.update(context_of(setpoint_miss_m=math.nan), 0.02)
    assert looked(monitor).scatter_m == 0.0

    monitor.update(context_of(setpoint_miss_m=0.3), 5.0)  # longer than it averages
    assert looked(monitor).scatter_m == pytest.approx(0.3)
    monitor.reset()
    assert looked(monitor).scatter_m == 0.0


def test_scatter_counts_from_the_first_tick_of_a_hover_on() -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    for _ in range(2):
        monitor.update(context_of(setpoint_miss_m=0.3), 0.02)
        # one of a hundred ticks over which it averages
        assert looked(monitor).scatter_m == pytest.approx(0.1 * 0.3)
        monitor.reset()


@pytest.mark.parametrize(("seconds", "is_back"), [(2.98, False), (3.02, True)])
def test_the_way_back_after_the_law_has_acted_takes_three_seconds_at_most(
    seconds: float, is_back: bool
) -> None:
    monitor = WindMonitor(FLEET, VEHICLE)
    monitor.update(context_of(is_law_active=True), 0.02)
    scatter_m = flown(monitor, 0.3, seconds).scatter_m
    assert (scatter_m > 0.0) is is_back


@pytest.mark.parametrize(("share", "is_rising"), [(0.42, False), (0.48, True)])
def test_a_rise_of_three_seconds_is_expected_to_go_on_for_ten(
    share: float, is_rising: bool
) -> None:
    """The mean of six seconds has missed 0.61 of the step then, and 1.7 times that is to come."""
    monitor = WindMonitor(FLEET, VEHICLE)
    for _ in range(600):
        looked(monitor)
    for _ in range(30):
        facts = looked(monitor, (share * SPENT_M_S, 0.0))
    assert facts.is_rising is is_rising
    assert facts.is_above is is_rising


def test_a_rising_wind_is_strong_before_it_is_above_its_limit() -> None:
    limit_m_s = wind_limit_m_s(FLEET, VEHICLE)
    monitor = WindMonitor(FLEET, VEHICLE)
    for _ in range(100):
        assert not looked(monitor, (0.5 * limit_m_s, 0.0)).is_strong

    # half a second of a rise that would go on to 1.2 times the limit
    for step in range(5):
        facts = looked(monitor, ((0.5 + 0.1 * step) * limit_m_s, 0.0))
    assert facts.is_strong
    assert not facts.is_above


def test_a_wind_far_above_the_limit_counts_although_it_does_not_rise() -> None:
    there = (1.1 * GUSTY * wind_limit_m_s(FLEET, VEHICLE), 0.0)
    facts = looked(WindMonitor(FLEET, VEHICLE), there)
    assert (facts.is_above, facts.is_rising) == (True, False)


def test_calm_air_has_no_gusts_and_moves_nobody() -> None:
    assert WindFacts().gust_words == "gusts of 0.0 m/s^2, 0.00 m in hover"
