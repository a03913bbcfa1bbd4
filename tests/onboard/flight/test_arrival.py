"""When a climb ends at its height, in calm air and in gusts that move who has arrived."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import Order
from onboard.flight import effects, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from tests.onboard.agent.rig import fleet

_START_NS = 10**9
_TICK_NS = 20_000_000
_HEIGHT_M = 1.0


def _arrives_after_s(miss_m: float, gust_m_s2: float, *, near_after_s: float = 99.0) -> float:
    """Return when a vehicle has arrived that stays beside its goal, and later comes near to it."""
    config = fleet()
    vehicle = config.vehicles["mav0"]
    order = Order(
        order_id="o", author="x", kind="takeoff", stamp_ns=0, deadline_ns=0, height_m=_HEIGHT_M
    )
    flight = FlightContext(
        config,
        vehicle,
        step=FlightStep.CLIMB,
        order=order,
        step_ns=_START_NS,
        steady_since_ns=_START_NS,
    )
    snapshot = Snapshot(is_armed=True, mode="OFFBOARD", landed=Landed.IN_AIR)
    still = (0.0, 0.0, 0.0)
    view = FlightView(
        now_ns=_START_NS,
        position_enu_m=still,
        velocity_enu_m_s=still,
        has_position=True,
        snapshot=snapshot,
        expected_gust_m_s2=gust_m_s2,
    )
    effects.lift_off(flight, view)

    for tick in range(1, 500):
        since_s = 0.02 * tick
        x_m = miss_m if since_s < near_after_s else 0.0
        now_ns = _START_NS + tick * _TICK_NS
        state_machine.advance(
            flight, replace(view, now_ns=now_ns, position_enu_m=(x_m, 0.0, _HEIGHT_M))
        )
        if flight.step is FlightStep.ARRIVED:
            return since_s
    return float("inf")


@pytest.mark.parametrize("gust_m_s2", [0.0, 0.5])
def test_at_its_goal_it_has_arrived_after_half_a_second(gust_m_s2: float) -> None:
    assert _arrives_after_s(0.05, gust_m_s2) == pytest.approx(0.5, abs=0.05)


def test_in_calm_air_it_never_arrives_beside_its_goal() -> None:
    assert _arrives_after_s(0.18, 0.0) == float("inf")


def test_moved_by_gusts_it_waits_until_it_is_as_near_as_in_calm_air() -> None:
    assert _arrives_after_s(0.18, 0.5, near_after_s=1.2) == pytest.approx(1.2, abs=0.05)


def test_moved_by_gusts_for_seconds_it_has_arrived_where_it_is() -> None:
    assert _arrives_after_s(0.18, 0.5) == pytest.approx(8.0, abs=0.05)
    assert _arrives_after_s(0.60, 0.5) == float("inf")
