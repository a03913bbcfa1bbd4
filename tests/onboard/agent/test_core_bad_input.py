"""Any stream of messages, however wrong: no exception, no setpoint that PX4 must not get, no safe
state left.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from onboard import agent_commands, agent_inputs
from onboard.autopilot import Snapshot
from onboard.bus.schema import MocapPose, Order, OrderReply, StateMessage, Telemetry
from tests.onboard.agent.rig import Rig
from tests.onboard.agent.test_core_latch import moving

HUGE_INT = (1 << 63) + 5
floats = st.one_of(
    st.floats(), st.sampled_from([0.0, 1e308, -1e300, 1e5, 5e-324, math.nan, math.inf])
)
ints = st.one_of(
    st.integers(-10, 10), st.integers(-(1 << 63), (1 << 64) - 1), st.sampled_from([HUGE_INT, -1, 0])
)


def _changed(message: Any, draw: Any) -> Any:
    """A message with some of its numbers, words and flags replaced by anything of their type."""
    changes: dict[str, Any] = {}
    for name in draw(
        st.lists(st.sampled_from(message.__struct_fields__[1:]), min_size=1, max_size=4)
    ):
        value = getattr(message, name)
        if isinstance(value, bool):
            changes[name] = draw(st.booleans())
        elif isinstance(value, int):
            changes[name] = draw(ints)
        elif isinstance(value, float):
            changes[name] = draw(floats)
        elif isinstance(value, tuple) and value and isinstance(value[0], float):
            changes[name] = tuple(draw(floats) for _ in value)
    return msgspec.structs.replace(message, **changes)


def _snapshot(snapshot: Snapshot, draw: Any) -> Snapshot:
    return replace(
        snapshot,
        quaternion_enu_flu_wxyz=tuple(draw(floats) for _ in range(4))
        if draw(st.booleans())
        else (0.0, 0.0, 0.0, 0.0),
        position_local_ned_m=tuple(draw(floats) for _ in range(3)),
        battery_frac=draw(floats),
        battery_voltage_v=draw(floats),
        px4_boot_ms=draw(ints),
    )


class Listener:
    """Takes everything that the core sends, and complains about what must not be sent."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.tilt_cos = math.cos(math.radians(rig.core.vehicle.max_tilt_deg + 1.0))

    def check(self, commands: list[agent_commands.Command]) -> None:
        for command in commands:
            match command:
                case agent_commands.SendAttitude(setpoint):
                    q = np.asarray(setpoint.quaternion_wxyz)
                    thrust = setpoint.thrust_frac
                    assert np.isfinite(q).all()
                    assert 0.0 <= thrust <= 1.0
                    assert 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2) >= self.tilt_cos
                case agent_commands.SendOdometry(position, quaternion, _):
                    assert np.isfinite([*position, *quaternion]).all()
                case agent_commands.Publish(_, message):
                    msgspec.msgpack.encode(message)
        self.rig.take(commands)


def _example(rig: Rig, kind: str) -> Any:
    now_ns = rig.now_ns
    if kind == "pose" or kind == "other pose":
        return MocapPose(
            body="mav0" if kind == "pose" else "mav1",
            boot_id=1,
            sequence=10**6,
            stamp_ns=now_ns,
            is_tracked=True,
            position_enu_m=(1.0, 0.0, 1.0),
            quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        )
    if kind == "order":
        return Order(
            order_id=f"x{rig.now_ns}",
            author="anybody",
            kind="move",
            stamp_ns=now_ns,
            deadline_ns=now_ns + 10**9,
            position_enu_m=(1.0, 0.0, 1.0),
            height_m=1.0,
        )
    message = rig.state if kind in ("state", "own state") else rig.telemetry
    assert message is not None
    return msgspec.structs.replace(message, vehicle="mav0" if kind.startswith("own") else "mav1")


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_no_stream_of_messages_brings_the_core_down_or_a_wrong_setpoint_out_of_it(
    data: st.DataObject,
) -> None:
    rig = moving()
    listener = Listener(rig)
    core = rig.core
    kinds = ["pose", "other pose", "state", "own state", "telemetry", "order", "snapshot", "tick"]
    gave_up = False
    for _ in range(data.draw(st.integers(1, 12))):
        kind = data.draw(st.sampled_from(kinds))
        if kind == "snapshot":
            listener.check(
                core.handle(
                    agent_inputs.SnapshotReceived(_snapshot(rig.snapshot, data.draw)), rig.now_ns
                )
            )
            listener.check(core.tick(rig.now_ns + 1_000_000))
        elif kind == "tick":
            rig.now_ns += data.draw(st.sampled_from([0, 1, 20_000_000, 400_000_000]))
            listener.check(core.tick(rig.now_ns))
        else:
            message = _example(rig, kind)
            message = _changed(message, data.draw) if data.draw(st.booleans()) else message
            event: agent_inputs.AgentInput
            if isinstance(message, MocapPose):
                event = agent_inputs.PoseReceived(message, rig.now_ns)
            elif isinstance(message, Order):
                event = agent_inputs.OrderReceived(message)
            else:
                assert isinstance(message, (StateMessage, Telemetry))
                event = agent_inputs.NeighbourReceived(message, rig.now_ns)
            listener.check(core.handle(event, rig.now_ns))
        rig.step()
        listener.check(core.tick(rig.now_ns + 2_000_000))
        if gave_up:
            assert core.flight.state in ("failed", "landing", "landed", "waiting", "ready")
            assert not core.flight.step.is_streaming or core.flight.state == "landing"
        gave_up = gave_up or core.flight.state == "failed"


@pytest.mark.parametrize(
    "changes",
    [
        {"quaternion_enu_flu_wxyz": (1e300, 0.0, 0.0, 0.0)},
        {"quaternion_enu_flu_wxyz": (0.0, 0.0, 0.0, 0.0)},
        {"position_local_ned_m": (math.nan, 0.0, 0.0)},
        {"velocity_local_ned_m_s": (0.0, 1e308, 0.0)},
    ],
)
def test_a_px4_that_tells_nonsense_ends_the_flight_as_a_silent_one_and_reads_as_what_it_is(
    changes: dict[str, Any],
) -> None:
    rig = moving()
    rig.core.handle(agent_inputs.SnapshotReceived(replace(rig.snapshot, **changes)), rig.now_ns)
    rig.run(0.1)
    assert rig.core.flight.state == "flying"  # once is never
    handle = rig.core.handle

    def nonsense(agent_input: agent_inputs.AgentInput, now_ns: int) -> list[agent_commands.Command]:
        if isinstance(agent_input, agent_inputs.SnapshotReceived):
            agent_input = agent_inputs.SnapshotReceived(replace(agent_input.snapshot, **changes))
        return handle(agent_input, now_ns)

    rig.core.handle = nonsense  # type: ignore[method-assign]
    rig.run(1.0)
    assert rig.core.flight.state == "failed"
    assert rig.core.flight.reason.startswith("PX4's numbers are impossible (PX4 sa") or (
        rig.core.flight.reason.startswith(
            "PX4's numbers are impossible (PX4 sends an attitude that is no rotation"
        )
    )
    assert "silent" not in rig.core.flight.reason


def test_preflight_says_what_is_wrong_with_a_px4_that_is_thousands_of_kilometres_off() -> None:
    rig = Rig()
    handle = rig.core.handle

    def far(agent_input: agent_inputs.AgentInput, now_ns: int) -> list[agent_commands.Command]:
        if isinstance(agent_input, agent_inputs.SnapshotReceived):
            agent_input = agent_inputs.SnapshotReceived(
                replace(agent_input.snapshot, position_local_ned_m=(5227321.5, 1067127.6, 0.0))
            )
        return handle(agent_input, now_ns)

    rig.core.handle = far  # type: ignore[method-assign]
    rig.run(1.0)
    assert any("5335 km from its origin" in sentence for sentence in rig.core.preflight.not_ready)
    rig.core.handle = handle  # type: ignore[method-assign]
    rig.run(2.0)
    assert not any("km from its origin" in sentence for sentence in rig.core.preflight.not_ready)


@pytest.mark.parametrize("kind", ["state", "telemetry"])
def test_a_neighbour_that_sends_nonsense_is_ignored_counted_and_then_silent(kind: str) -> None:
    rig = moving()
    good = _example(rig, kind)
    before = rig.core.neighbours.counts.malformed
    for bad in (math.nan, math.inf, 1e300):
        message = msgspec.structs.replace(good, position_enu_m=(bad, 0.0, 1.0))
        rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)
        rig.step()
    assert rig.core.neighbours.counts.malformed == before + 3
    assert rig.core.flight.state == "flying"


def test_a_replayed_order_is_answered_as_before_one_without_id_or_with_a_silly_time_refused() -> (
    None
):
    rig = moving()
    first = rig.order("move", order_id="a", position_enu_m=(1.0, 0.0, 1.0))
    for count in range(300):
        rig.order("locate", order_id=f"i{count}")
    late = rig.order(
        "move", order_id="a", position_enu_m=(1.0, 0.0, 1.0), deadline_ns=rig.now_ns - 1
    )
    assert first.is_accepted
    assert late == first or not late.is_accepted
    assert isinstance(late, OrderReply)
    assert not rig.order("move", order_id="", position_enu_m=(1.0, 0.0, 1.0)).is_accepted
    for seconds in (math.nan, math.inf, 1e9):
        assert not rig.order("move", position_enu_m=(1.0, 0.0, 1.0), duration_s=seconds).is_accepted


def test_a_pose_stream_of_another_frame_is_no_position_and_the_vehicle_holds_and_is_landed() -> (
    None
):
    rig = moving()
    rig.run(1.5)
    rig.has_mocap = False
    for _ in range(50):
        x, y, z = rig.position.tolist()
        # turned by 90 degrees since now
        rig.pose(position_enu_m=(y, -x, z + 1e-6 * rig.tick_count))
        rig.step()
    codes = [event.code for event in rig.events]
    assert "position-jumped" in codes
    assert rig.core.flight.state in ("holding", "landing")


def test_a_mocap_that_rounds_its_quaternions_gives_the_same_heading_and_no_jumps() -> None:
    rig = Rig()
    half_turn_rad = math.radians(45.0)
    rig.snapshot = replace(
        rig.snapshot,
        quaternion_enu_flu_wxyz=(math.cos(half_turn_rad), 0.0, 0.0, math.sin(half_turn_rad)),
    )
    rig.has_mocap = False
    for norm in (0.95, 1.05) * 50:
        turned = (norm * math.cos(half_turn_rad), 0.0, 0.0, norm * math.sin(half_turn_rad))
        rig.pose(quaternion_enu_flu_wxyz=turned)
        rig.step()
    own = rig.core.own
    assert own.counts.refused == 0
    assert own.heading_offset_rad == pytest.approx(0.0, abs=1e-3)
    assert rig.core.flight.state == "ready"
