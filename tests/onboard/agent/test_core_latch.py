"""An action of a failsafe ends only by something stronger or by an operator's order, whatever comes
and goes.
"""

from __future__ import annotations

import functools
import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard import agent_commands
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation
from onboard.supervision.condition_monitor import ConditionMonitor
from tests.onboard.agent.rig import Rig, copied, hovering_rig

# what the table's actions leave of a flight, by rank; a vehicle that PX4 has landed has ended it
GIVEN_UP = 8


def course(flight: FlightContext) -> int:
    """Return the vehicle's course on the scale of the actions."""
    if flight.state == "failed":
        return GIVEN_UP
    if flight.state in ("landing", "landed", "waiting", "ready"):
        return Action.PX4_LAND if flight.step is FlightStep.PX4_LANDING else Action.LAND
    if flight.state == "holding":
        return Action.HOLD
    return Action.SLOW if flight.is_slow else Action.GO_ON


@functools.cache
def _flown() -> Rig:
    rig = hovering_rig()
    rig.order("move", order_id="away", position_enu_m=(3.0, 0.0, 1.2))
    rig.run(0.6)
    return rig


def moving() -> Rig:
    """A vehicle on its way, by order ``away``."""
    return copied(_flown())


class Broken:
    """Replaces what the watch finds by what a test says; the agent's own process is never stopped
    by it.
    """

    def __init__(self, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
        self.holds: set[Condition] = set()
        monkeypatch.setattr(ConditionMonitor, "update", lambda *_: dict.fromkeys(self.holds, ""))
        self.rig = rig


# on the ground afterwards the flight is over; what lands by itself may touch down at any time
CAN_COME = [condition for condition in Condition if condition is not Condition.SHUTDOWN]


@settings(max_examples=15, deadline=None)
@given(
    st.lists(
        st.tuples(st.sets(st.sampled_from(CAN_COME), max_size=3), st.integers(1, 12)), max_size=12
    )
)
def test_no_sequence_of_conditions_makes_a_flight_less_safe(
    story: list[tuple[set[Condition], int]],
) -> None:
    rig = moving()
    with pytest.MonkeyPatch.context() as patch:
        broken = Broken(rig, patch)
        before = course(rig.core.flight)
        for holds, ticks in [*story, (set(), 20)]:
            broken.holds = holds
            for _ in range(ticks):
                situation = rig.core.flight.situation
                rig.step()
                now = course(rig.core.flight)
                if rig.core.flight.situation is Situation.GROUND:
                    return
                assert now >= before, (holds, situation)
                asked = max(
                    (TABLE[situation, condition] for condition in holds), default=Action.GO_ON
                )
                if asked in (Action.HOLD, Action.LAND, Action.PX4_LAND, Action.STOP):
                    assert now >= asked
                before = now


def test_the_core_does_what_every_row_of_the_table_says_and_says_why() -> None:
    for condition, situation in itertools.product(Condition, (Situation.FLYING, Situation.LANDING)):
        if TABLE[situation, condition] is not Action.GO_ON:
            with pytest.MonkeyPatch.context() as patch:
                check_row(condition, situation, patch)


def check_row(condition: Condition, situation: Situation, patch: pytest.MonkeyPatch) -> None:
    """Let a condition hold in a situation, and compare what follows with the table."""
    row = f"{condition.name} while {situation.value}"
    rig = moving()
    if situation is Situation.LANDING:
        rig.order("land")
        rig.run(0.5)
    Broken(rig, patch).holds = {condition}
    began_ns = rig.now_ns
    rig.step()
    action = TABLE[situation, condition]
    flight = rig.core.flight
    setpoints = [
        command.setpoint
        for when, command in rig.sent
        if isinstance(command, agent_commands.SendAttitude) and when > began_ns
    ]
    if action in (Action.PX4_LAND, Action.STOP):
        assert not setpoints, row
        assert (rig.count(agent_commands.Px4Land, began_ns) > 0) is (action is Action.PX4_LAND), row
    if action is Action.LEVEL:
        assert [float(one.quaternion_wxyz[0]) for one in setpoints] == pytest.approx([1.0]), row
    if action is Action.SLOW:
        assert flight.is_slow, row
        assert flight.order is not None, row
    if situation is Situation.FLYING:
        assert course(flight) == {Action.LEVEL: Action.HOLD, Action.STOP: GIVEN_UP}.get(
            action, action
        ), row
        if action is not Action.SLOW:
            rig.run(0.04)
            assert rig.outcomes()["away"] in ("failed", "timed out"), row
    assert condition.value.lower()[1:] in flight.reason.lower() or action in (
        Action.LEVEL,
        Action.LAND,
    ), row
    rig.run(0.2)
    assert rig.telemetry is not None
    assert condition.value in rig.telemetry.conditions, row


def test_after_a_hold_an_order_flies_on_at_full_speed_and_after_a_landing_none_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = moving()
    broken = Broken(rig, monkeypatch)
    broken.holds = {Condition.NEIGHBOUR_STALE}
    rig.run(0.2)
    broken.holds = set()
    rig.run(1.0)
    assert rig.core.flight.is_slow
    assert rig.telemetry is not None
    assert rig.telemetry.action == "flying slowly"
    broken.holds = {Condition.BUS_LOST}
    rig.run(0.2)
    broken.holds = set()
    rig.run(1.0)
    assert rig.core.flight.state == "holding"
    assert rig.order("move", position_enu_m=(3.0, 0.0, 1.2)).is_accepted
    rig.run(0.2)
    assert rig.core.flight.state == "flying"
    assert not rig.core.flight.is_slow
    assert rig.telemetry.action == "going on"
    broken.holds = {Condition.BATTERY_FALLING}
    rig.run(0.2)
    broken.holds = set()
    assert not rig.order("move", position_enu_m=(3.0, 0.0, 1.2)).is_accepted
    assert not rig.order("hold").is_accepted
    rig.until("landed")


def test_a_slow_flight_is_slow_and_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = hovering_rig()
    broken = Broken(rig, monkeypatch)
    order = rig.order("move", position_enu_m=(2.0, 0.0, 1.0))
    broken.holds = {Condition.MOCAP_LATE}
    fastest_m_s = 0.0
    for _ in range(1200):
        rig.step()
        fastest_m_s = max(fastest_m_s, float((rig.velocity**2).sum() ** 0.5))
    assert 0.2 < fastest_m_s < 0.6 * rig.core.vehicle.max_speed_m_s
    assert rig.outcomes()[order.order_id] == "done"
