"""Rows of the failsafe table that no fault of the suite brings about: each from what the agent
receives to what it does and says.
"""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.bus.schema import StateMessage
from onboard.control import pipeline
from onboard.control.pipeline import PipelineMemory
from onboard.flight.types import FlightStep
from onboard.safety.failsafe_table import Condition
from onboard.tuples import Xyz
from onboard.types import LawStatus, Tick
from tests.onboard.agent.rig import Rig, fleet, hovering_rig, ready_rig

STILL: Xyz = (0.0, 0.0, 0.0)


def told(rig: Rig, condition: Condition) -> list[str]:
    """Return what was said of a condition."""
    code = condition.name.lower().replace("_", "-")
    return [event.sentence for event in rig.events if event.code == code]


class Other:
    """A neighbour, whose states a test writes.

    Args:
        rig: that hears it.
        name: of its vehicle.
    """

    def __init__(self, rig: Rig, name: str = "mav1") -> None:
        self._rig = rig
        self._name = name
        self._sequence = 0

    def says(self, position: Xyz, velocity: Xyz = STILL, **fields: object) -> None:
        """Let it send one state."""
        rig = self._rig
        assert rig.state is not None
        self._sequence += 1
        message: StateMessage = replace(
            rig.state,
            vehicle=self._name,
            boot_id=9,
            sequence=self._sequence,
            stamp_ns=rig.now_ns,
            is_valid=True,
            is_airborne=True,
            position_enu_m=position,
            velocity_enu_m_s=velocity,
            acceleration_enu_m_s2=STILL,
            predicted_position_enu_m=position,
            predicted_velocity_enu_m_s=velocity,
            commanded_acceleration_enu_m_s2=STILL,
        )
        message = replace(message, **fields)
        rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)

    def tells(self, **fields: object) -> None:
        """Let it send one telemetry, otherwise like the rig's own."""
        rig = self._rig
        assert rig.telemetry is not None
        message = replace(rig.telemetry, vehicle=self._name, boot_id=9, **fields)
        rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)


def beside(rig: Rig, east_m: float) -> Xyz:
    """Return a position at the height of the rig's vehicle."""
    x, y, z = rig.position.tolist()
    return (x + east_m, y, z)


@pytest.mark.failsafe("PX4's numbers are impossible", step="flying")
def test_a_px4_whose_attitude_is_no_rotation_gets_no_more_setpoints() -> None:
    rig = hovering_rig()
    rig.snapshot = replace(rig.snapshot, quaternion_enu_flu_wxyz=(0.0, 0.0, 0.0, 0.0))
    rig.obeys = False
    rig.is_armed = False  # its motion no longer matters, and keeps the attitude as it is
    began_ns = rig.now_ns
    rig.run(1.0)

    assert rig.core.flight.state == "failed"
    assert told(rig, Condition.AUTOPILOT_IMPOSSIBLE)
    assert rig.count(agent_commands.SendAttitude, began_ns + 600_000_000) == 0


@pytest.mark.failsafe("own position lost for long", step="landing by setpoint")
def test_a_landing_by_dead_reckoning_that_takes_too_long_is_left_to_px4() -> None:
    rig = hovering_rig()
    rig.has_mocap = False

    def stay_up() -> None:
        rig.position[2] = 1.0
        rig.velocity[2] = 0.0

    rig.after_move = stay_up
    rig.run(5.0)
    assert rig.count(agent_commands.Px4Land) == 0

    rig.run(2.0)
    assert rig.count(agent_commands.Px4Land) > 0
    assert told(rig, Condition.POSITION_LOST_LONG)


@pytest.mark.failsafe("a clock jumped", step="flying")
def test_a_clock_that_jumps_is_said_and_the_order_goes_on() -> None:
    rig = hovering_rig()
    order = rig.order("move", position_enu_m=(0.5, 0.0, 1.0))
    rig.now_ns -= 300_000_000
    rig.run(8.0)

    assert told(rig, Condition.CLOCK_JUMPED)
    assert rig.outcomes()[order.order_id] == "done"


@pytest.mark.failsafe("disk full", step="flying")
@pytest.mark.failsafe("disk full", step="on the ground, disarmed")
def test_a_full_disk_refuses_a_take_off_and_ends_no_flight() -> None:
    rig = hovering_rig()
    rig.core.handle(agent_inputs.DiskChecked(True), rig.now_ns)
    rig.run(1.0)
    assert rig.core.flight.state == "flying"
    assert told(rig, Condition.DISK_FULL)

    rig = Rig()
    rig.core.handle(agent_inputs.DiskChecked(True), rig.now_ns)
    rig.run(3.0)
    assert not rig.order("takeoff", height_m=1.0).is_accepted


@pytest.mark.failsafe("another agent for this vehicle", step="flying")
@pytest.mark.failsafe("another agent for this vehicle", step="lifting off")
def test_another_agent_ends_a_lift_off_and_no_flight() -> None:
    for step, expected in ((FlightStep.CLIMB, "taking off"), (FlightStep.LIFTOFF, "landing")):
        rig = ready_rig()
        rig.order("takeoff", height_m=1.0)
        while rig.core.flight.step is not step:
            rig.step()

        assert rig.state is not None
        twin = replace(rig.state, boot_id=99)
        rig.core.handle(agent_inputs.NeighbourReceived(twin, rig.now_ns), rig.now_ns)
        rig.run(0.1)
        assert told(rig, Condition.TWIN)
        assert rig.core.flight.state == expected


@pytest.mark.long
@pytest.mark.failsafe("order overdue", step="flying")
def test_a_move_that_does_not_arrive_in_three_times_its_duration_and_30_s_holds() -> None:
    rig = hovering_rig()
    other = Other(rig)
    order = rig.order("move", position_enu_m=(2.0, 0.0, 1.0))
    for _ in range(2600):
        other.says((2.0, 0.0, 1.0))
        rig.step()

    assert rig.core.flight.state == "holding"
    assert "kept off by mav1" in told(rig, Condition.ORDER_OVERDUE)[0]
    assert rig.outcomes()[order.order_id] in ("failed", "timed out")


@pytest.mark.failsafe("collision suspected", step="flying")
def test_a_body_that_overlaps_ours_means_a_landing() -> None:
    rig = hovering_rig()
    other = Other(rig)
    other.says(beside(rig, 0.2))
    rig.step()

    assert told(rig, Condition.COLLISION_SUSPECTED)
    assert rig.core.flight.state == "landing"


@pytest.mark.failsafe("separation breached", step="flying")
def test_below_the_safety_distance_the_order_goes_on_slowly() -> None:
    rig = hovering_rig()
    other = Other(rig)
    rig.order("move", position_enu_m=(-3.0, 0.0, 1.0))
    for _ in range(10):
        other.says(beside(rig, 0.65))
        rig.step()

    assert told(rig, Condition.SEPARATION_BREACHED)
    assert rig.core.flight.is_slow


@pytest.mark.failsafe("separation will be lost", step="flying")
def test_a_neighbour_that_comes_faster_than_both_can_brake_makes_the_order_slow() -> None:
    rig = hovering_rig()
    other = Other(rig)
    rig.order("move", position_enu_m=(-3.0, 0.0, 1.0))
    for tick in range(20):
        other.says(beside(rig, 2.6 - 0.08 * tick), (-4.0, 0.0, 0.0))
        rig.step()

    assert told(rig, Condition.SEPARATION_PREDICTED)
    assert rig.core.flight.is_slow


@pytest.mark.failsafe("avoidance infeasible", step="flying")
def test_when_no_thrust_satisfies_the_law_the_order_holds() -> None:
    is_infeasible = False

    def step(*arguments: Any) -> tuple[PipelineMemory, Tick]:
        memory, tick = pipeline.step(*arguments)
        if is_infeasible:
            tick = tick._replace(law=tick.law._replace(status=int(LawStatus.INFEASIBLE)))
        return memory, tick

    rig = Rig(core=AgentCore(fleet(), "mav0", boot_id=7, pipeline_step=step))
    rig.fly()
    rig.order("move", position_enu_m=(3.0, 0.0, 1.0))
    rig.run(0.5)

    is_infeasible = True
    rig.run(0.08)
    assert rig.core.flight.state == "flying"
    rig.run(0.12)
    assert told(rig, Condition.LAW_INFEASIBLE)
    assert rig.core.flight.state == "holding"


@pytest.mark.failsafe("neighbour without position", step="flying")
def test_a_neighbour_that_does_not_know_where_it_is_is_named() -> None:
    rig = hovering_rig()
    other = Other(rig)
    for tick in range(18):
        other.says(beside(rig, 2.5), is_valid=tick < 10)
        rig.step()

    assert told(rig, Condition.NEIGHBOUR_INVALID) == [
        "Neighbour without position (mav1): going on."
    ]
    assert rig.core.flight.state == "flying"


@pytest.mark.failsafe("neighbour flies by dead reckoning", step="flying")
@pytest.mark.parametrize(("age_s", "is_slow"), [(0.05, False), (0.4, True)])
def test_a_neighbour_that_comes_down_without_poses_is_followed_slowly(
    age_s: float, is_slow: bool
) -> None:
    rig = hovering_rig()
    other = Other(rig)
    rig.order("move", position_enu_m=(-3.0, 0.0, 1.0))
    for _ in range(20):
        other.says(beside(rig, 3.0))
        other.tells(is_airborne=True, state_age_s=age_s)
        rig.step()

    assert bool(told(rig, Condition.NEIGHBOUR_BLIND)) is is_slow
    assert rig.core.flight.is_slow is is_slow


def test_whoever_has_lost_its_own_poses_does_not_go_by_those_of_others() -> None:
    rig = hovering_rig()
    other = Other(rig)
    rig.has_mocap = False
    for tick in range(60):
        other.says(beside(rig, 3.0))
        other.tells(is_airborne=True, state_age_s=0.02 * tick)
        rig.step()

    assert rig.core.flight.step is FlightStep.SINKING

    assert not told(rig, Condition.NEIGHBOUR_BLIND)


@pytest.mark.failsafe("neighbour does not do what it says", step="flying")
def test_a_neighbour_that_flies_otherwise_than_it_predicts_is_passed_slowly() -> None:
    rig = hovering_rig()
    other = Other(rig)
    rig.order("move", position_enu_m=(-3.0, 0.0, 1.0))
    y_m = 1.5
    for _ in range(150):
        y_m += 0.02 * 0.4
        other.says((1.5, y_m, 1.0), (0.0, 0.4, 0.0), predicted_velocity_enu_m_s=(0.0, -0.5, 0.0))
        rig.step()

    assert told(rig, Condition.NEIGHBOUR_UNCOOPERATIVE)
    assert rig.core.flight.is_slow


@pytest.mark.failsafe("neighbour heard again", step="flying")
def test_a_neighbour_that_is_heard_again_is_said() -> None:
    rig = hovering_rig()
    other = Other(rig)
    for tick in range(200):
        if not 50 < tick < 120:
            other.says(beside(rig, 3.0))
        rig.step()

    assert told(rig, Condition.NEIGHBOUR_SILENT)
    assert told(rig, Condition.NEIGHBOUR_BACK)


@pytest.mark.failsafe("battery low", step="flying")
def test_a_battery_below_its_warning_is_said_and_ends_no_flight() -> None:
    rig = Rig()
    warning_frac = 0.01 * rig.core.fleet.fleet.battery_warning_pct
    rig.battery_frac = warning_frac + 0.01
    rig.fly()
    rig.battery_frac = warning_frac - 0.01
    rig.run(2.0)

    assert told(rig, Condition.BATTERY_WARNING)
    assert rig.core.flight.state == "flying"


@pytest.mark.failsafe("geofence near", step="flying")
def test_near_the_fence_the_order_goes_on_slowly() -> None:
    rig = hovering_rig()
    rig.order("move", position_enu_m=(3.85, 0.0, 1.0))
    rig.run(9.0)
    rig.order("move", position_enu_m=(3.85, 2.0, 1.0))
    rig.run(0.5)
    rig.velocity[0] = 2.2  # a gust
    rig.run(0.1)

    assert told(rig, Condition.FENCE_NEAR)
    assert rig.core.flight.is_slow


@pytest.mark.failsafe("above the ceiling", step="flying")
def test_above_the_ceiling_it_holds_below_it() -> None:
    rig = hovering_rig()
    rig.carry(0.0, 0.0, 3.1, speed_m_s=1.0)

    assert told(rig, Condition.CEILING)
    assert rig.core.flight.state == "holding"
    assert rig.core.flight.goal_position_enu_m[2] < 3.0


@pytest.mark.failsafe("loop late", step="flying")
def test_a_late_tick_is_counted_and_changes_nothing() -> None:
    rig = hovering_rig()
    rig.now_ns += 15_000_000
    rig.step()

    assert Condition.LOOP_LATE in rig.core.failsafes.conditions
    rig.run(0.5)
    assert rig.core.flight.state == "flying"


@pytest.mark.failsafe("PX4's heartbeat lost", step="flying")
def test_a_px4_whose_heartbeat_stops_is_landed_under_the_law() -> None:
    rig = hovering_rig()
    rig.sends_heartbeat = False
    rig.run(2.0)
    assert rig.core.flight.state == "flying"

    rig.run(1.5)
    assert told(rig, Condition.HEARTBEAT_LOST)
    assert rig.core.flight.state == "landing"
    assert rig.count(agent_commands.Px4Land) == 0


@pytest.mark.long
@pytest.mark.failsafe("pushed about", step="flying")
@pytest.mark.failsafe("disturbance larger than it learns", step="flying")
def test_a_push_that_begins_at_once_lands_and_a_large_one_is_more_than_it_learns() -> None:
    for push_m_s2, is_bound in ((1.0, False), (4.0, True)):
        rig = hovering_rig()

        def push(rig: Rig = rig, push_m_s2: float = push_m_s2) -> None:
            rig.velocity[0] += 0.02 * push_m_s2

        rig.after_move = push
        rig.order("move", position_enu_m=(-1.0, 0.0, 1.0))
        rig.run(6.0)
        assert bool(told(rig, Condition.PUSHED_ABOUT)) is is_bound
        assert bool(told(rig, Condition.DISTURBANCE_BOUND)) is is_bound
        assert (rig.core.flight.state == "flying") is not is_bound
