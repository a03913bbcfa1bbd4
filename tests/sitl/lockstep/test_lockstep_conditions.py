"""Facts that only whole flights show: how soon the table acts on mocap and neighbours, and that
nobody is run into.
"""

from __future__ import annotations

import asyncio
import math

import pytest

from onboard.safety.failsafe_table import Condition
from sitl.faults.catalogue import Fault

MOCAP_LATENCY_S = 0.04  # from the exposure of a sample to the tick that has it


def _first(flight, name, condition):
    """Seconds at which a vehicle said a condition first; infinite if it never did."""
    code = condition.name.lower().replace("_", "-")
    stamps = [
        event.stamp_ns for event in flight.events if event.vehicle == name and event.code == code
    ]
    return (min(stamps) - 1_000_000_000) * 1e-9 if stamps else math.inf


def _begin(flight, text):
    async def begin():
        return asyncio.ensure_future(flight.client.order(text, 40.0))

    return flight.wait_for(begin())


def _ended(flight, order):
    async def wait():
        return await order

    return flight.wait_for(wait())


def _apart_m(flight, one, other):
    first, second = (flight.state.vehicles[name].truth.position_enu_m for name in (one, other))
    return math.dist(first[:2], second[:2])


@pytest.mark.long
@pytest.mark.failsafe("neighbour silent", step="flying")
def test_a_vehicle_whose_agent_dies_on_its_way_is_avoided_where_it_really_goes(lockstep, paper):
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.5)
    _begin(flight, "move mav1 1.5 2.5 1.5")
    flight.run(2.2)
    flight.agents["mav1"].kill()
    died_s = flight.time_s
    flight.run(0.5)
    x, y, _ = flight.state.vehicles["mav1"].truth.position_enu_m
    from_x, from_y, _ = flight.state.vehicles["mav2"].truth.position_enu_m
    # straight through it
    _begin(flight, f"move mav2 {2 * x - from_x:.2f} {2 * y - from_y:.2f} 1.5")
    nearest_m = math.inf
    for _ in range(200):
        flight.run(0.05)
        nearest_m = min(nearest_m, _apart_m(flight, "mav1", "mav2"))
    assert _first(flight, "mav2", Condition.NEIGHBOUR_SILENT) - died_s <= 0.3
    assert _first(flight, "mav2", Condition.NEIGHBOUR_UNSEEN) == math.inf
    assert nearest_m > 0.8
    mav2 = flight.state.vehicles["mav2"].truth.position_enu_m
    assert math.dist(mav2[:2], (2 * x - from_x, 2 * y - from_y)) < 0.2  # and it did get past
    assert not flight.simulation.emulator.world.collisions


@pytest.mark.long
@pytest.mark.failsafe("mocap takes it for another vehicle", step="flying")
def test_two_bodies_that_mocap_swaps_hold_within_150_ms_and_come_down_apart(lockstep, paper):
    flight = lockstep(paper, seed=2)
    flight.may_land_hard = True  # blind, with 1.3 m/s
    flight.takeoff(1.0)
    _begin(flight, "move mav1 0 -0.5 1")
    flight.run(1.5)
    begins_s = flight.time_s
    flight.inject(Fault("mocap_swapped", "mav1", at_s=begins_s, parameters={"other": "mav2"}))
    flight.run(0.25)
    for name in ("mav1", "mav2"):
        assert _first(flight, name, Condition.MOCAP_SWAPPED) - begins_s - MOCAP_LATENCY_S <= 0.15
        assert flight.agents[name].core.flight.state == "holding"
    flight.run(12.0)
    for name in ("mav1", "mav2"):
        assert flight.state.vehicles[name].truth.is_on_ground
        assert flight.agents[name].core.flight.reason.startswith("Own position lost")
    assert flight.agents["mav0"].core.flight.state == "flying"
    assert flight.min_separation_m > 0.8


@pytest.mark.long
@pytest.mark.failsafe("mocap repeats itself", step="flying")
def test_a_frozen_mocap_is_acted_on_within_150_ms_and_an_order_says_why_it_failed(lockstep, paper):
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    order = _begin(flight, "move mav1 0 -0.5 1")
    flight.run(1.0)
    begins_s = flight.time_s
    flight.inject(Fault("mocap_frozen", "mav1", at_s=begins_s, duration_s=0.2))
    flight.run(1.5)
    assert _first(flight, "mav1", Condition.MOCAP_FROZEN) - begins_s - MOCAP_LATENCY_S <= 0.15
    assert flight.agents["mav1"].core.flight.state == "holding"  # also now that it moves again
    result = _ended(flight, order)["mav1"]
    assert not result.is_done
    assert "Mocap repeats itself" in result.sentence
