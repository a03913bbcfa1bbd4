"""How PX4 has left the mode that a flight needs, and since when its heartbeats say so."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from onboard.autopilot import Snapshot
from onboard.bus.schema import Order
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep
from onboard.supervision.offboard_monitor import OffboardMonitor
from onboard.supervision.tick_facts import ModeLoss
from tests.onboard.agent.rig import fleet

S = 1_000_000_000
BEGIN_NS = 5 * S
FLEET = fleet()
OFFBOARD = Snapshot(is_armed=True, mode="OFFBOARD")
# two messages in a row about a pilot's sticks
STICKS: dict[str, Any] = {"sticks_ns": BEGIN_NS, "sticks_before_ns": BEGIN_NS - S // 10}


class Flown:
    """A flight whose setpoints PX4 has taken, and the ticks of its monitor."""

    def __init__(self, step: FlightStep) -> None:
        self.monitor = OffboardMonitor()
        self.flight = FlightContext(FLEET, FLEET.vehicles["mav0"], step=FlightStep.ARM_OFFBOARD)
        assert self.tick(BEGIN_NS - S) is ModeLoss.NONE
        self.flies(step=step)

    def flies(self, **facts: Any) -> None:
        """Give the flight other facts, as its own room does."""
        for name, value in facts.items():
            setattr(self.flight, name, value)

    def tick(
        self, now_ns: int = BEGIN_NS, *, is_on_ground: bool = False, **changes: Any
    ) -> ModeLoss:
        """Take a tick with a heartbeat of now, unless changes name another one."""
        snapshot = replace(OFFBOARD, **{"heartbeat_ns": now_ns, **changes})
        return self.monitor.update(now_ns, snapshot, self.flight, is_on_ground=is_on_ground)


@pytest.mark.parametrize("step", [FlightStep.LIFTOFF, FlightStep.LEG, FlightStep.HOLDING])
@pytest.mark.parametrize(
    ("changes", "loss"),
    [
        ({}, ModeLoss.NONE),
        ({"is_armed": False}, ModeLoss.DISARMED),
        ({"is_armed": False, "mode": "HOLD"}, ModeLoss.DISARMED),
        ({"mode": "POSCTL", **STICKS}, ModeLoss.BY_HAND),
        ({"mode": "POSCTL", **STICKS, "is_failsafe": True}, ModeLoss.BY_HAND),
        ({"mode": "POSCTL"}, ModeLoss.LEFT),
        ({"mode": "HOLD", **STICKS}, ModeLoss.LEFT),
        ({"mode": "RETURN_TO_LAUNCH", "is_failsafe": True}, ModeLoss.FAILSAFE),
    ],
)
def test_a_flight_loses_offboard_in_four_ways(
    step: FlightStep, changes: dict[str, Any], loss: ModeLoss
) -> None:
    assert Flown(step).tick(**changes) is loss


@pytest.mark.parametrize("step", [FlightStep.ARM_OFFBOARD, FlightStep.TAKEOFF_OFFBOARD])
def test_before_offboard_only_a_pilot_with_sticks_takes_a_vehicle(step: FlightStep) -> None:
    assert Flown(step).tick(mode="HOLD", **STICKS) is ModeLoss.NONE
    assert Flown(step).tick(mode="POSCTL") is ModeLoss.NONE
    assert Flown(step).tick(mode="POSCTL", **STICKS, is_armed=False) is ModeLoss.NONE
    assert Flown(step).tick(mode="POSCTL", **STICKS) is ModeLoss.BY_HAND


def test_in_a_descent_a_px4_that_has_disarmed_is_down_and_not_lost() -> None:
    assert Flown(FlightStep.DESCENT).tick(is_armed=False) is ModeLoss.NONE


@pytest.mark.parametrize(("heartbeat_ns", "loss"), [(0, ModeLoss.NONE), (1, ModeLoss.LEFT)])
def test_a_heartbeat_counts_when_it_is_newer_than_the_step_that_needs_offboard(
    heartbeat_ns: int, loss: ModeLoss
) -> None:
    flown = Flown(FlightStep.LEG)
    since_ns = BEGIN_NS - S
    assert flown.tick(mode="HOLD", heartbeat_ns=since_ns + heartbeat_ns) is loss


@pytest.mark.parametrize(
    ("step", "loss"),
    [
        (FlightStep.TAKEOVER, ModeLoss.NONE),
        (FlightStep.LANDED, ModeLoss.NONE),
        (FlightStep.FAILED, ModeLoss.BY_HAND),
    ],
)
def test_where_offboard_is_not_needed_only_a_silent_flight_sees_who_flies_by_hand(
    step: FlightStep, loss: ModeLoss
) -> None:
    flown = Flown(step)
    assert flown.tick(mode="POSCTL", **STICKS) is loss
    assert flown.tick(mode="POSCTL") is ModeLoss.NONE

    # the step after it begins with a heartbeat of its own
    flown.flies(step=FlightStep.LEG)
    assert flown.tick(mode="POSCTL") is ModeLoss.NONE
    assert flown.tick(BEGIN_NS + 1, mode="POSCTL") is ModeLoss.LEFT


# -- while PX4 lands


def landing(reason: str = "") -> Flown:
    """Return a flight whose PX4 has confirmed that it lands."""
    flown = Flown(FlightStep.PX4_LANDING)
    order = Order(
        order_id="1",
        author="ada",
        kind="land",
        stamp_ns=BEGIN_NS,
        deadline_ns=0,
        reason=reason,
    )
    flown.flies(order=order)
    assert flown.tick(mode="LAND") is ModeLoss.NONE
    return flown


def test_px4_may_take_a_while_to_begin_its_landing() -> None:
    assert Flown(FlightStep.PX4_LANDING).tick() is ModeLoss.NONE


@pytest.mark.parametrize(
    ("changes", "is_on_ground", "loss"),
    [
        ({"mode": "LAND"}, False, ModeLoss.NONE),
        ({"mode": "HOLD"}, False, ModeLoss.LEFT),
        ({"mode": "HOLD"}, True, ModeLoss.NONE),
        ({"mode": "HOLD", "is_failsafe": True}, False, ModeLoss.NONE),
    ],
)
def test_px4_leaves_its_landing_in_the_air_and_not_by_its_own_failsafe(
    changes: dict[str, Any], is_on_ground: bool, loss: ModeLoss
) -> None:
    flown = landing()
    assert flown.tick(is_on_ground=is_on_ground, **changes) is loss
    # and it is said as long as it is so
    assert flown.tick(is_on_ground=is_on_ground, **changes) is loss


@pytest.mark.parametrize(
    ("reason", "is_on_ground", "loss"),
    [
        ("the wind is too strong", False, ModeLoss.BY_HAND),
        ("the wind is too strong", True, ModeLoss.NONE),
        ("", False, ModeLoss.LEFT),  # a person has ordered it to land, and takes it back
    ],
)
def test_a_pilot_takes_over_a_landing_that_no_person_has_ordered(
    reason: str, is_on_ground: bool, loss: ModeLoss
) -> None:
    flown = landing(reason=reason)
    assert flown.tick(mode="POSCTL", is_on_ground=is_on_ground, **STICKS) is loss


@pytest.mark.parametrize("between", [FlightStep.LANDED, FlightStep.FAILED, FlightStep.HOLDING])
def test_the_next_landing_is_confirmed_anew(between: FlightStep) -> None:
    flown = landing()
    flown.flies(step=between)
    flown.tick()
    flown.flies(step=FlightStep.PX4_LANDING)
    assert flown.tick() is ModeLoss.NONE


def test_after_px4s_landing_a_flight_needs_a_new_heartbeat() -> None:
    flown = landing()
    flown.flies(step=FlightStep.HOLDING)
    assert flown.tick(mode="LAND") is ModeLoss.NONE
    assert flown.tick(BEGIN_NS + 1, mode="LAND") is ModeLoss.LEFT
