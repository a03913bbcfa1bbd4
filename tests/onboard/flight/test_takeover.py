"""An agent that finds its vehicle in the air: silent until it knows, and then smoothly from PX4's
hold only.
"""

from __future__ import annotations

import numpy as np
import pytest

from onboard import agent_commands, agent_inputs
from tests.onboard.agent.rig import Rig, ready_rig
from tests.onboard.state_messages import state_message


class Held(Rig):
    """The rig with a PX4 that holds its place while no setpoints tell it otherwise."""

    def move(self) -> None:
        if self.is_armed and (self.mode != "OFFBOARD" or self.setpoint is None):
            self.velocity = np.zeros(3)
            self.has_flown = True
        else:
            super().move()


def restarted(mode: str = "HOLD", height_m: float = 1.2) -> Held:
    """A new agent beside a vehicle that flies already."""
    rig = Held(position=np.array([0.4, -0.3, height_m]), is_armed=True, mode=mode)
    rig.has_flown = True
    rig.run(3.0)
    return rig


def test_an_agent_that_finds_its_vehicle_in_the_air_sends_nothing_and_says_what_can_be_done() -> (
    None
):
    rig = restarted()
    assert rig.core.flight.state == "failed"
    assert "PX4 flies without this agent" in rig.core.flight.reason
    assert "hold" in rig.core.flight.reason
    assert (
        rig.count(agent_commands.SendAttitude)
        == rig.count(agent_commands.SetOffboard)
        == rig.count(agent_commands.Arm)
        == 0
    )
    assert rig.state is not None
    assert rig.state.is_airborne, "the others must avoid it"
    assert not rig.state.is_cooperative


def test_it_takes_over_from_px4s_hold_without_a_jolt() -> None:
    rig = restarted()
    place = rig.position.copy()
    begin_ns = rig.now_ns
    assert rig.order("hold", order_id="take").is_accepted
    assert "take" not in rig.outcomes(), "done is what PX4's heartbeat says, not what was asked"
    farthest_m = 0.0
    for _ in range(300):
        rig.step()
        farthest_m = max(farthest_m, float(np.linalg.norm(rig.position - place)))
    assert rig.mode == "OFFBOARD"
    assert rig.core.flight.state == "holding"
    assert rig.outcomes()["take"] == "done"
    assert farthest_m < 0.05
    first = next(
        stamp for stamp, command in rig.sent if isinstance(command, agent_commands.SetOffboard)
    )
    streamed = [
        stamp
        for stamp, command in rig.sent
        if isinstance(command, agent_commands.SendAttitude) and stamp < first
    ]
    assert len(streamed) >= 10, "PX4 must know setpoints before it is asked to follow them"
    assert min(streamed) > begin_ns
    assert rig.order("move", position_enu_m=(0.0, 0.0, 1.0)).is_accepted
    rig.run(6.0)
    assert rig.core.flight.state == "flying"


@pytest.mark.parametrize("mode", ["LAND", "OFFBOARD", "POSCTL", "RTL", ""])
def test_it_takes_over_from_no_other_mode(mode: str) -> None:
    rig = restarted(mode, height_m=2.5)
    reply = rig.order("hold")
    assert not reply.is_accepted
    assert mode in reply.reason
    rig.run(1.0)
    assert rig.count(agent_commands.SendAttitude) == rig.count(agent_commands.SetOffboard) == 0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda rig: setattr(rig, "has_mocap", False), "position"),
        (
            lambda rig: rig.core.handle(
                agent_inputs.ParamsRead(("COM_OF_LOSS_T is 1.",)), rig.now_ns
            ),
            "COM_OF_LOSS_T",
        ),
        (lambda rig: setattr(rig, "has_autopilot", False), "PX4"),
        (lambda rig: rig.core.handle(twin(rig), rig.now_ns), "nother agent"),
    ],
)
def test_it_takes_over_nothing_that_it_does_not_know_well_enough(spoil: object, words: str) -> None:
    rig = restarted()
    spoil(rig)  # type: ignore[operator]
    rig.run(1.0)
    reply = rig.order("hold")
    assert not reply.is_accepted
    assert words in reply.reason
    rig.run(1.0)
    assert rig.count(agent_commands.SendAttitude) == 0


def test_a_px4_that_does_not_enter_offboard_is_left_alone() -> None:
    rig = restarted()
    rig.accepts_offboard = False
    assert rig.order("hold", order_id="take").is_accepted
    rig.run(6.0)
    assert rig.outcomes()["take"] == "failed"
    assert rig.core.flight.state == "failed"
    since_ns = rig.now_ns
    rig.run(2.0)
    assert rig.count(agent_commands.SendAttitude, since_ns) == 0


@pytest.mark.parametrize("after_s", [0.1, 2.0])
def test_a_hold_again_during_the_takeover_is_done_only_when_px4_says_so(after_s: float) -> None:
    rig = restarted()
    rig.accepts_offboard = False
    assert rig.order("hold", order_id="take").is_accepted
    rig.run(after_s)
    assert rig.order("hold", order_id="again").is_accepted
    rig.run(2.0)
    assert rig.outcomes()["take"] == "superseded"
    assert "again" not in rig.outcomes(), "PX4 still flies it"
    rig.accepts_offboard = True
    rig.run(3.0)
    assert rig.outcomes()["again"] == "done"
    assert rig.core.flight.state == "holding"
    assert rig.mode == "OFFBOARD"


@pytest.mark.parametrize("accepts_offboard", [True, False])
@pytest.mark.parametrize("after_s", [0.1, 0.5])
def test_land_during_the_takeover_lands(after_s: float, accepts_offboard: bool) -> None:
    rig = restarted()
    rig.accepts_offboard = accepts_offboard
    assert rig.order("hold").is_accepted
    rig.run(after_s)
    assert rig.order("land", order_id="land").is_accepted
    rig.run(0.5)
    assert rig.mode == "LAND", "PX4 flies it, and nobody else can land it"
    assert rig.core.flight.state == "landing"


def test_a_failsafe_that_lands_during_the_takeover_lets_px4_land() -> None:
    rig = restarted()
    rig.battery_frac = 0.1
    rig.run(2.0)
    assert rig.order("hold", order_id="take").is_accepted
    rig.run(0.5)
    assert rig.mode == "LAND"
    assert rig.outcomes()["take"] == "failed"
    assert rig.core.flight.reason == "Battery at the landing level: landing."


def test_it_is_not_moved_before_it_is_taken_over() -> None:
    rig = restarted()
    assert rig.order("hold", order_id="take").is_accepted
    rig.run(0.1)
    reply = rig.order("move", position_enu_m=(0.0, 0.0, 1.0))
    assert not reply.is_accepted
    assert "taken over from PX4's hold" in reply.reason
    rig.run(2.0)
    assert rig.outcomes()["take"] == "done"


@pytest.mark.parametrize("mode", ["POSCTL", "RTL"])
@pytest.mark.parametrize("after_s", [0.0, 0.6])
def test_who_flies_it_during_the_takeover_keeps_it(mode: str, after_s: float) -> None:
    rig = restarted()
    rig.accepts_offboard = False
    if after_s == 0.0:
        rig.mode = mode  # PX4's last heartbeat has said HOLD still
    assert rig.order("hold", order_id="take").is_accepted
    rig.run(after_s)
    rig.mode = mode
    rig.run(1.1)
    taken_ns = rig.now_ns
    rig.run(4.0)
    assert rig.count(agent_commands.SetOffboard, taken_ns) == 0
    if after_s == 0.0:
        assert rig.count(agent_commands.SetOffboard) == 0
    assert rig.outcomes()["take"] == "failed"
    assert rig.core.flight.state == "failed"
    assert f"now {mode}" in rig.core.flight.reason


def test_a_vehicle_on_the_ground_is_not_taken_over() -> None:
    rig = ready_rig()
    reply = rig.order("hold")
    assert not reply.is_accepted


def twin(rig: Rig) -> agent_inputs.NeighbourReceived:
    """A message of another process under our name."""
    message = state_message(
        vehicle="mav0", boot_id=99, stamp_ns=rig.now_ns, is_airborne=False, is_cooperative=False
    )
    return agent_inputs.NeighbourReceived(message, rig.now_ns)


def test_a_vehicle_whose_motors_stop_during_the_takeover_is_not_taken_over() -> None:
    rig = restarted()
    assert rig.order("hold", order_id="take").is_accepted
    rig.run(0.1)
    rig.is_armed = False
    rig.run(2.0)
    assert rig.outcomes()["take"] == "failed"
    assert [event.code for event in rig.events if event.severity == "critical"][-1] == (
        "disarmed-in-flight"
    )
    assert rig.core.flight.has_fallen
