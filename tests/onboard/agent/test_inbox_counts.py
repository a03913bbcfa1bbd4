"""Messages that an agent does not use are counted by the reason; none becomes an event."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from msgspec.structs import replace

from onboard import agent_inputs
from onboard.agent.inbox import Inbox
from onboard.bus.codec import Malformed
from onboard.bus.topics import Topic
from onboard.config.mocap import MocapConfig
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message


def _inbox() -> Inbox:
    bus: Any = SimpleNamespace(node="mav0")
    return Inbox(fleet().vehicles["mav0"], 1, bus, MocapConfig())


def test_what_is_malformed_in_anothers_name_or_missing_is_counted() -> None:
    inbox = _inbox()
    message = replace(state_message(), vehicle="mav1")
    for sequence in (7, 8, 11, 10, 11, 12):  # 9 and 10 are missing when 11 comes
        inbox.neighbour_received(Topic.STATE, "mav1", replace(message, sequence=sequence))
    assert len(inbox.events) == 6
    inbox.neighbour_received(Topic.STATE, "mav2", message)  # the key of mav2, the name of mav1
    inbox.neighbour_received(Topic.SLOW_TELEMETRY, "mav1", Malformed("garbage", 7))
    assert inbox.take_counts() == agent_inputs.MessagesCounted(malformed=1, refused=1, dropped=2)
    # it was not followed meanwhile
    inbox.neighbour_received(Topic.STATE, "mav1", replace(message, sequence=400))
    # it has started anew
    inbox.neighbour_received(Topic.STATE, "mav1", replace(message, sequence=1))
    inbox.neighbour_received(Topic.STATE, "mav1", replace(message, sequence=2))
    assert inbox.take_counts() == agent_inputs.MessagesCounted()


def test_a_flood_pushes_out_the_oldest_and_is_counted() -> None:
    inbox = _inbox()
    message = replace(state_message(), vehicle="mav1")
    for sequence in range(5000):
        inbox.neighbour_received(Topic.STATE, "mav1", replace(message, sequence=sequence))
    assert inbox.take_counts().dropped == 5000 - len(inbox.events)
    assert inbox.events[-1].message.sequence == 4999  # type: ignore[union-attr]
