"""Climbs and landings that make no progress: high ones have the time that they need, and no place
is insisted on.
"""

from __future__ import annotations

import pytest

from onboard.agent_commands import Publish
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import Event, Order
from onboard.flight import effects, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from tests.onboard.agent.rig import fleet

_START_NS = 10**9


def ends(step: FlightStep, height_m: float, top_m: float) -> tuple[float, str, FlightStep]:
    """When an order ends for a vehicle that stays at one height [s], with which sentence, and in
    which step.
    """
    config = fleet()
    order = Order(
        order_id="o", author="x", kind="takeoff", stamp_ns=0, deadline_ns=0, height_m=top_m
    )
    flight = FlightContext(
        config, config.vehicles["mav0"], step=step, order=order, step_ns=_START_NS
    )
    effects.lift_off(flight, _view(_START_NS, 0.0))
    effects.climb_on(flight, _view(_START_NS, 0.0))
    for second in range(1, 400):
        now_ns = _START_NS + second * 10**9
        state_machine.advance(flight, _view(now_ns, height_m))
        for command in flight.take_commands():
            if (
                isinstance(command, Publish)
                and isinstance(command.message, Event)
                and command.message.order_outcome
            ):
                return (now_ns - _START_NS) * 1e-9, command.message.sentence, flight.step
    return 0.0, "", flight.step


def _view(now_ns: int, height_m: float, *, x_m: float = 0.0, sinks_m_s: float = 0.0) -> FlightView:
    snapshot = Snapshot(
        heartbeat_ns=now_ns, is_armed=True, mode="LAND", landed=Landed.IN_AIR, landed_ns=now_ns
    )
    return FlightView(
        now_ns=now_ns,
        position_enu_m=(x_m, 0.0, height_m),
        velocity_enu_m_s=(0.0, 0.0, -sinks_m_s),
        has_position=True,
        snapshot=snapshot,
    )


# 30 m are planned for 62 s
@pytest.mark.parametrize(("top_m", "after_s"), [(1.0, 41.0), (30.0, 187.0)])
def test_a_climb_that_makes_no_progress_holds(top_m: float, after_s: float) -> None:
    time_s, sentence, step = ends(FlightStep.CLIMB, 0.5, top_m)
    assert time_s == pytest.approx(after_s)
    assert sentence == f"Not at its height after {after_s:.0f} s; holding."
    assert step is FlightStep.HOLDING


@pytest.mark.parametrize(("height_m", "after_s"), [(1.25, 63.0), (40.25, 141.0)])
def test_a_landing_by_px4_has_two_seconds_more_for_each_metre_that_is_left(
    height_m: float, after_s: float
) -> None:
    time_s, sentence, step = ends(FlightStep.PX4_LANDING, height_m, 1.0)
    assert time_s == pytest.approx(after_s)
    assert sentence == f"PX4 has not landed after {after_s:.0f} s: land it with the transmitter."
    assert step is FlightStep.PX4_LANDING


@pytest.mark.parametrize(
    ("beside_m", "sinks_m_s", "lands_at_m"),
    [(0.8, 0.0, 0.8), (0.3, 0.0, 0.0), (0.8, 0.4, 0.0)],  # kept off; hardly beside; on its way down
)
def test_who_is_kept_off_its_landing_place_lands_where_it_is_within_the_same_time(
    beside_m: float, sinks_m_s: float, lands_at_m: float
) -> None:
    config = fleet()
    flight = FlightContext(config, config.vehicles["mav0"], step=FlightStep.DESCENT)
    effects.descend(flight, _view(_START_NS, 5.0))
    deadline_ns = flight.deadline_ns
    for tick in range(1, 150):
        state_machine.advance(
            flight, _view(_START_NS + tick * 20_000_000, 5.0, x_m=beside_m, sinks_m_s=sinks_m_s)
        )
    assert flight.step is FlightStep.DESCENT
    assert flight.goal_position_enu_m[:2] == (lands_at_m, 0.0)
    assert flight.goal_position_enu_m[2] < flight.expected_ground.z_m
    assert flight.deadline_ns == deadline_ns
