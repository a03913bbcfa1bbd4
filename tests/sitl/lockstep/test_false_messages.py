"""Somebody publishes on the bus in the name of others: single messages end no flight and stop
nobody's messages.
"""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from onboard.bus.schema import MocapPose, StateMessage, Telemetry
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig

_FAR_AHEAD = 2**60
_KINDS = {
    Topic.STATE: StateMessage, Topic.MOCAP: MocapPose, Topic.TELEMETRY: Telemetry,
    Topic.SLOW_TELEMETRY: Telemetry,
}  # fmt: skip


@pytest.mark.long
def test_messages_numbered_far_ahead_stop_neither_poses_nor_states_nor_telemetry(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    liar = flight.bus.node("liar")
    liar.start()
    heard: dict[tuple[Topic, str], Any] = {}

    def listen(topic: Topic, name: str, message: Any) -> None:
        heard[topic, name] = message

    for topic in _KINDS:
        liar.subscribe(topic, "*", listen)
    flight.takeoff(1.0)
    assert {topic for topic, _ in heard} == set(_KINDS)
    for (topic, name), message in heard.items():
        liar.publish(
            topic,
            name,
            msgspec.structs.replace(message, sequence=_FAR_AHEAD, stamp_ns=message.stamp_ns + 1),
        )
    flight.run(2.0)
    for name, agent in flight.agents.items():
        assert agent.core.flight.state == "flying", name
        assert not agent.core.failsafes.conditions, name
        assert flight.state.vehicles[name].telemetry.sequence < _FAR_AHEAD, name


@pytest.mark.long
def test_a_neighbour_told_to_be_two_metres_uncertain_pushes_nobody_through_the_fence(
    lockstep, paper
) -> None:
    flight = lockstep(paper, seed=5)
    liar = flight.bus.node("liar")
    liar.start()

    def exaggerate(topic: Topic, name: str, message: Any) -> None:
        if message.position_std_m < 2.0:
            worse = msgspec.structs.replace(
                message, position_std_m=2.0, stamp_ns=message.stamp_ns + 1
            )
            liar.publish(topic, name, worse)

    flight.takeoff(1.0)
    liar.subscribe(Topic.STATE, "mav1", exaggerate)
    liar.subscribe(Topic.FAR, "mav1", exaggerate)
    outermost_m = 0.0
    for _ in range(20):
        flight.run(0.5)
        truths = [flight.state.vehicles[name].truth.position_enu_m for name in flight.agents]
        outermost_m = max(outermost_m, *(abs(value) for x, y, _ in truths for value in (x, y)))
    assert 3.0 < outermost_m < 4.0  # they were pushed, and stayed inside
    assert flight.min_separation_m > 0.8
