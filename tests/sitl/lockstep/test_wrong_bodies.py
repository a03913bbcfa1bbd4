"""Vehicles whose mocap bodies are turned or exchanged, in the air and between flights."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from onboard.config.fleet import FleetConfig
from sitl.faults.catalogue import Fault

_PROMISE_M = 0.8
_ASTRAY_M = 3.0  # it brakes, and lands by dead reckoning
_HARD_M_S = 1.2
_PAIR = ("mav1", "mav2")


def _place_m(flight: Any, name: str) -> tuple[float, float]:
    x, y, _ = flight.state.vehicles[name].truth.position_enu_m
    return x, y


def _begin(flight: Any, text: str) -> asyncio.Future[Any]:
    async def begin() -> asyncio.Future[Any]:
        return asyncio.ensure_future(flight.client.order(text, 40.0))

    order: asyncio.Future[Any] = flight.wait_for(begin())
    return order


def _not_ready(flight: Any, name: str) -> str:
    return " ".join(flight.agents[name].core.preflight.not_ready)


def _lose_then_swap(flight: Any, lost_s: float) -> None:
    """Cover two bodies for a time; then each one's poses are those of the other."""
    at_s = flight.time_s
    if lost_s > 0.0:
        for name in _PAIR:
            flight.inject(Fault("mocap_lost", name, at_s=at_s, duration_s=lost_s))
    one, other = _PAIR
    swapped = {"other": other}
    flight.inject(Fault("mocap_swapped", one, at_s=at_s + lost_s, parameters=swapped))


@pytest.mark.failsafe("own position jumped", step="flying")
@pytest.mark.parametrize("yaw_deg", [40.0, -90.0, 180.0])
def test_a_vehicle_whose_body_is_seen_turned_lands_where_it_is(
    lockstep: Any, paper: FleetConfig, yaw_deg: float
) -> None:
    """With the wrong heading it would steer away from its goal, faster and faster."""
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    _begin(flight, "move mav1 0 -0.5 1")
    flight.run(1.0)
    begun_m = _place_m(flight, "mav1")
    flight.inject(
        Fault("mocap_flipped", "mav1", at_s=flight.time_s, parameters={"yaw_deg": yaw_deg})
    )
    flight.run(12.0)

    assert flight.state.is_landed("mav1")
    assert math.dist(_place_m(flight, "mav1"), begun_m) < _ASTRAY_M
    assert all(touchdown.speed_m_s < _HARD_M_S for touchdown in flight.touchdowns)
    assert flight.min_separation_m >= _PROMISE_M
    assert "position jumped" in _not_ready(flight, "mav1")


@pytest.mark.failsafe("own position lost", step="flying")
def test_bodies_that_come_back_exchanged_after_a_short_loss_are_not_believed(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    _lose_then_swap(flight, 0.5)
    flight.run(12.0)

    assert all(flight.state.is_landed(name) for name in _PAIR)
    assert all(touchdown.speed_m_s < _HARD_M_S for touchdown in flight.touchdowns)
    assert flight.min_separation_m >= _PROMISE_M
    for name in _PAIR:
        assert "came back somewhere else" in _not_ready(flight, name)


@pytest.mark.parametrize(
    ("lost_s", "words"), [(0.0, "position jumped"), (3.0, "on the take-off spot of")]
)
def test_bodies_that_are_exchanged_between_two_flights_refuse_the_second_one(
    lockstep: Any, paper: FleetConfig, lost_s: float, words: str
) -> None:
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    flight.order("land all")
    flight.run(2.0)
    assert not any(_not_ready(flight, name) for name in paper.enabled_names)

    _lose_then_swap(flight, lost_s)
    flight.run(lost_s + 15.0)
    for name in _PAIR:
        assert words in _not_ready(flight, name)
