"""What refuses a take-off, from the samples and messages that an agent really hears to the report
that it publishes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.bus.schema import PreflightReport, Telemetry
from onboard.bus.topics import Topic
from onboard.preflight.attitude_comparison import AttitudeRate
from tests.onboard.agent.rig import Rig, fleet
from tests.onboard.state_messages import state_message
from tests.oracles.rotation import quaternion_from_yaw, quaternion_multiply

ADVICE = {"record", "kill switch"}


def reports(rig: Rig) -> list[PreflightReport]:
    return [
        command.message
        for _, command in rig.sent
        if isinstance(command, agent_commands.Publish)
        and command.topic is Topic.PREFLIGHT
        and isinstance(command.message, PreflightReport)
    ]


def refusals(rig: Rig) -> dict[str, str]:
    """Checks of the newest report that refuse take-off."""
    return {name: sentence for name, is_ok, sentence, _ in reports(rig)[-1].checks if not is_ok}


def ready(**px4_params: float) -> Rig:
    rig = Rig(AgentCore(fleet(("mav0", "mav1", "mav2"), px4_params=px4_params), "mav0", boot_id=7))
    rig.run(2.5)
    assert rig.core.flight.state == "ready", rig.core.preflight.not_ready
    return rig


def land(rig: Rig) -> None:
    """Land, and wait until it may take off again."""
    rig.order("land")
    rig.until("landed")
    rig.run(2.0)
    assert refusals(rig) == {}


def turned(angle_rad: float, axis: int) -> tuple[float, ...]:
    vector = [0.0, 0.0, 0.0]
    vector[axis] = math.sin(0.5 * angle_rad)
    return (math.cos(0.5 * angle_rad), *vector)


def snapshot(rig: Rig, **changes: object) -> None:
    rig.snapshot = replace(rig.snapshot, **changes)


def swap_body(rig: Rig) -> None:
    rig.position = np.array([1.5, 0.0, 0.0])  # where mav1 should stand


def second_agent(rig: Rig) -> None:
    assert rig.state is not None
    other = msgspec.structs.replace(rig.state, boot_id=99)
    rig.core.handle(agent_inputs.NeighbourReceived(other, rig.now_ns), rig.now_ns)


def neighbour(rig: Rig, **changes: object) -> None:
    assert rig.telemetry is not None
    message: Telemetry = msgspec.structs.replace(rig.telemetry, vehicle="mav1", **changes)
    rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)


def wrong_parameter(rig: Rig) -> None:
    rig.core.handle(
        agent_inputs.ParamsRead(("PX4 parameter COM_OF_LOSS_T is 1, this fleet needs 0.3.",)),
        rig.now_ns,
    )


def turn_frame(rig: Rig) -> None:
    rig.heading_error_rad = math.radians(90.0)


def lay_body_on_its_side(rig: Rig) -> None:
    side = turned(math.pi / 2, 0)
    original = rig.pose
    rig.pose = lambda **changes: original(**{"quaternion_enu_flu_wxyz": side, **changes})  # type: ignore[method-assign]


def carry(rig: Rig) -> None:
    rig.velocity = np.array([0.0, 0.6, 0.0])
    steps = itertools.count()
    original = rig.move

    def move() -> None:
        original()
        rig.velocity = np.array([0.0, 0.6 if next(steps) // 40 % 2 == 0 else -0.6, 0.0])

    rig.move = move  # type: ignore[method-assign]


def drop_attitudes(rig: Rig) -> None:
    rates = itertools.count()
    original = rig.core.handle
    kept: list[int] = [0]

    def handle(agent_input: agent_inputs.AgentInput, now_ns: int) -> list[agent_commands.Command]:
        if isinstance(agent_input, agent_inputs.SnapshotReceived):
            if next(rates) % 5 == 0:
                kept[0] = now_ns
            agent_input = agent_inputs.SnapshotReceived(
                replace(agent_input.snapshot, attitude_ns=kept[0])
            )
        return original(agent_input, now_ns)

    rig.core.handle = handle  # type: ignore[method-assign]


def px4_elsewhere(rig: Rig) -> None:
    original = rig.core.handle

    def handle(agent_input: agent_inputs.AgentInput, now_ns: int) -> list[agent_commands.Command]:
        if isinstance(agent_input, agent_inputs.SnapshotReceived):
            agent_input = agent_inputs.SnapshotReceived(
                replace(agent_input.snapshot, position_local_ned_m=(0.0, 2.0, 0.0))
            )
        return original(agent_input, now_ns)

    rig.core.handle = handle  # type: ignore[method-assign]


def shift_stamps(rig: Rig) -> None:
    original = rig.pose

    def pose(**changes: object) -> None:
        original(stamp_ns=rig.now_ns + 5_000_000_000, **changes)

    rig.pose = pose  # type: ignore[method-assign]


BREAKS: dict[str, Callable[[Rig], None]] = {
    "px4": lambda rig: setattr(rig, "has_autopilot", False),
    "link": drop_attitudes,
    "alone": lambda rig: None,  # below: it has to be heard again and again
    "health": lambda rig: snapshot(rig, sensors_ns=1, sensors_enabled=0x3, sensors_healthy=0x2),
    "disarmed": lambda rig: setattr(rig, "is_armed", True),
    "parameters": wrong_parameter,
    "position": lambda rig: setattr(rig, "has_mocap", False),
    "clock": shift_stamps,
    "agreement": px4_elsewhere,
    "at rest": carry,
    "spot": swap_body,
    "fence": lambda rig: None,  # below: only a vehicle that has flown may stand elsewhere
    "configuration": lambda rig: neighbour(
        rig, config_hash="another", position_enu_m=(3.0, 0.0, 0.0)
    ),
    "law": lambda rig: neighbour(
        rig, config_hash=rig.core.fleet.config_hash, position_enu_m=(0.6, 0.0, 0.0)
    ),
    "battery": lambda rig: setattr(rig, "battery_frac", 0.1),
}


@pytest.mark.parametrize("name", [name for name in BREAKS if name not in ("alone", "fence")])
def test_each_broken_thing_shows_in_its_own_line_and_refuses_the_take_off(name: str) -> None:
    rig = ready()
    assert refusals(rig) == {}
    BREAKS[name](rig)
    rig.run(3.0)
    assert set(refusals(rig)) == {name}
    reply = rig.order("takeoff", height_m=1.0)
    assert not reply.is_accepted
    assert reply.reason.endswith(
        {one: remedy for one, _, _, remedy in reports(rig)[-1].checks}[name]
    )
    assert rig.telemetry is not None
    assert rig.telemetry.not_ready == (reply.reason,)
    assert rig.count(agent_commands.Arm) == 0


def test_a_neighbour_that_is_heard_without_a_position_is_not_called_silent() -> None:
    required = fleet(("mav0", "mav1", "mav2"), enabled=True)
    rig = Rig(AgentCore(required, "mav0", boot_id=7))
    rig.run(2.5)
    assert refusals(rig) == {"neighbours": "mav1, mav2 are not heard on the bus."}

    for _ in range(3):
        for name in ("mav1", "mav2"):
            message = state_message(
                vehicle=name, stamp_ns=rig.now_ns, is_valid=False, is_airborne=False
            )
            rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)
        rig.run(0.5)
    assert refusals(rig) == {"neighbours": "mav1, mav2 do not know their position."}

    rig.run(2.5)
    assert refusals(rig) == {"neighbours": "mav1, mav2 are not heard on the bus."}


def test_the_time_before_px4_spoke_makes_no_slow_link() -> None:
    rig = Rig(AgentCore(fleet(("mav0", "mav1", "mav2")), "mav0", boot_id=7))
    rig.has_autopilot = False
    rig.run(0.9)
    rig.has_autopilot = True
    rig.run(0.5)
    (sentence,) = [sentence for name, _, sentence, _ in reports(rig)[-1].checks if name == "link"]
    rig.run(2.0)
    assert "link" not in refusals(rig)
    assert "link" not in {
        name for report in reports(rig) for name, is_ok, _, _ in report.checks if not is_ok
    }, sentence


def test_a_second_agent_for_this_vehicle_refuses_until_it_is_gone() -> None:
    rig = ready()
    for _ in range(60):
        second_agent(rig)
        rig.run(0.02)
    assert set(refusals(rig)) == {"alone"}
    assert "Another agent runs for mav0" in rig.order("takeoff", height_m=1.0).reason
    rig.run(4.5)
    assert refusals(rig) == {}


def test_own_messages_that_come_back_are_no_second_agent() -> None:
    rig = ready()
    assert rig.state is not None
    for _ in range(60):
        rig.core.handle(agent_inputs.NeighbourReceived(rig.state, rig.now_ns), rig.now_ns)
        rig.run(0.02)
    assert refusals(rig) == {}


def test_a_vehicle_that_landed_elsewhere_may_take_off_there_but_not_outside_the_fence() -> None:
    rig = ready()
    rig.order("takeoff", height_m=1.0)
    rig.until("flying")
    rig.order("move", position_enu_m=(1.5, 1.0, 1.0))
    rig.run(6.0)
    land(rig)
    rig.carry(5.0, 1.0, 0.0)
    rig.run(3.0)
    assert set(refusals(rig)) == {"fence"}


@pytest.mark.parametrize("is_lost_between", [False, True])
def test_a_vehicle_whose_poses_jump_after_a_landing_takes_off_from_its_spot_only(
    is_lost_between: bool,
) -> None:
    """Two bodies have exchanged their names, or the mocap has begun anew with another origin."""
    rig = ready()
    rig.order("takeoff", height_m=1.0)
    rig.until("flying")
    land(rig)

    rig.position = rig.position + np.array([1.0, 0.0, 0.0])
    if is_lost_between:
        rig.has_mocap = False
        rig.run(1.0)
        rig.has_mocap = True
    rig.run(20.0)
    assert not rig.order("takeoff", height_m=1.0).is_accepted
    if not is_lost_between:  # nobody has carried it, so its body is wrong
        assert "position jumped" in refusals(rig)["failsafe"]
        return

    assert set(refusals(rig)) == {"spot"}
    rig.carry(0.0, 0.0, 0.0)
    rig.run(3.0)
    assert refusals(rig) == {}
    rig.carry(1.0, 0.0, 0.0)
    rig.run(3.0)
    assert refusals(rig) == {}


def test_a_body_whose_heading_jumps_on_the_ground_is_refused_for_good() -> None:
    """Its markers form a symmetric pattern. PX4 would follow its heading after some seconds."""
    rig = ready()
    turn_frame(rig)
    rig.run(20.0)
    assert set(refusals(rig)) == {"failsafe"}
    assert "position jumped" in refusals(rig)["failsafe"]


def test_a_body_on_another_vehicle_is_found_when_the_vehicle_is_tilted_by_hand() -> None:
    rig = ready()
    snapshot(rig, quaternion_enu_flu_wxyz=turned(math.radians(30.0), 1))
    original = rig.pose
    level = (1.0, 0.0, 0.0, 0.0)
    rig.pose = lambda **changes: original(**{"quaternion_enu_flu_wxyz": level, **changes})  # type: ignore[method-assign]
    rig.run(1.0)
    snapshot(rig, quaternion_enu_flu_wxyz=level)
    rig.run(4.0)
    assert "tilted by hand" in refusals(rig)["agreement"]
    rig.pose = original  # type: ignore[method-assign]
    snapshot(rig, quaternion_enu_flu_wxyz=turned(math.radians(30.0), 1))
    rig.run(1.0)
    snapshot(rig, quaternion_enu_flu_wxyz=level)
    rig.run(4.0)
    assert refusals(rig) == {}


def test_a_mocap_with_another_axis_up_is_found_at_rest() -> None:
    rig = ready()
    lay_body_on_its_side(rig)
    rig.run(4.0)
    assert "which way is up" in refusals(rig)["agreement"]


def test_a_px4_with_another_position_refuses_only_if_it_fuses_the_mocaps() -> None:
    rig = ready()
    px4_elsewhere(rig)
    rig.run(2.0)
    assert "2.00 m from where the mocap" in refusals(rig)["agreement"]
    no_fusion = {"EKF2_EV_CTRL": 0.0}
    alone = Rig(AgentCore(fleet(("mav0", "mav1", "mav2"), px4_params=no_fusion), "mav0", boot_id=7))
    turn_frame(alone)
    alone.run(2.5)
    px4_elsewhere(alone)
    alone.run(2.0)
    assert refusals(alone) == {}
    checks = {name: (sentence, remedy) for name, _, sentence, remedy in reports(alone)[-1].checks}
    assert "PX4's compass" in checks["agreement"][0]


def test_a_recorder_on_the_bus_is_noticed_and_a_missing_one_is_only_advice() -> None:
    rig = ready()
    assert {
        name for name, is_ok, _, remedy in reports(rig)[-1].checks if is_ok and remedy
    } == ADVICE
    rig.core.handle(agent_inputs.NodeChanged("recorder-17", True), rig.now_ns)
    rig.run(1.5)
    assert {name for name, is_ok, _, remedy in reports(rig)[-1].checks if is_ok and remedy} == {
        "kill switch"
    }
    rig.core.handle(agent_inputs.NodeChanged("recorder-17", False), rig.now_ns)
    rig.run(1.5)
    assert rig.core.flight.state == "ready"


def test_a_computer_whose_clock_is_not_measured_refuses_and_the_grounds_does_not_matter() -> None:
    rig = ready()
    rig.core.handle(
        agent_inputs.ClocksCompared({"ground-1": math.inf, "mocap": math.inf}), rig.now_ns
    )
    rig.run(1.5)
    assert refusals(rig) == {"clock": "The clock of mocap is not measured yet."}
    rig.core.handle(agent_inputs.ClocksCompared({"ground-1": math.inf, "mocap": 0.03}), rig.now_ns)
    rig.run(1.5)
    assert refusals(rig) == {}
    assert (
        "30 ms only"
        in {name: sentence for name, _, sentence, _ in reports(rig)[-1].checks}["clock"]
    )


def test_reports_come_once_a_second_on_the_ground_and_never_in_flight() -> None:
    rig = ready()
    before = len(reports(rig))
    rig.run(3.0)
    assert len(reports(rig)) - before == 3
    rig.order("takeoff", height_m=1.0)
    rig.until("flying")
    before = len(reports(rig))
    rig.run(3.0)
    assert len(reports(rig)) == before


def test_a_heading_that_px4_takes_from_the_mocap_may_be_off_by_a_little() -> None:
    rig = ready()
    small = quaternion_from_yaw(math.radians(10.0))
    assert quaternion_multiply(small, (1.0, 0.0, 0.0, 0.0)) == pytest.approx(small)
    rig.heading_error_rad = math.radians(10.0)
    rig.run(3.0)
    assert refusals(rig) == {}


def test_a_time_in_which_attitudes_were_not_counted_is_no_slow_link() -> None:
    """After a kill on the ground, the vehicle is not judged for less than a second."""
    attitude = AttitudeRate()
    tick_ns = 20_000_000
    for tick in [*range(1, 120), *range(155, 400)]:
        attitude.update(tick * tick_ns, tick * tick_ns)
        assert attitude.rate_hz is None or attitude.rate_hz > 49.0
    assert attitude.rate_hz == pytest.approx(50.0, abs=1.1)
