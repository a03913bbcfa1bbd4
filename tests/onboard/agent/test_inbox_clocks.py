"""Messages of vehicles whose computers have other clocks come in with stamps of the own clock."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from onboard import agent_inputs
from onboard.agent.inbox import Inbox
from onboard.bus.schema import ClockMessage, HeardClock, StateMessage, Telemetry
from onboard.bus.topics import Topic
from onboard.config.mocap import MocapConfig
from onboard.flight.path_flight import other_clocks
from tests.groundstation.console.fake import telemetry
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message

_MS = 1_000_000
_HOUR_NS = 3_600_000_000_000


class Apart:
    """The inbox of mav0, and mav1 on a computer whose clock is ahead by this."""

    def __init__(self, ahead_ns: int) -> None:
        bus: Any = SimpleNamespace(node="mav0")
        self.inbox = Inbox(fleet().vehicles["mav0"], 1, bus, MocapConfig())
        self.now_ns = time.monotonic_ns()
        self.there_ns = self.now_ns + ahead_ns

        clocks = self.inbox.clock.clocks
        heard = HeardClock("mav0", clocks.host, self.now_ns - _MS, self.there_ns)
        message = ClockMessage(
            node="mav1", host=clocks.host + 1, sequence=1, sent_ns=self.there_ns, heard=(heard,)
        )
        clocks.hear(message, self.now_ns)

    def received(self, topic: Topic, message: StateMessage | Telemetry) -> Any:
        """Return a message of mav1 as the agent gets it."""
        self.inbox.neighbour_received(topic, "mav1", message)
        event = self.inbox.events.pop()
        assert isinstance(event, agent_inputs.NeighbourReceived)
        return event.message


@pytest.mark.parametrize("ahead_ns", [_HOUR_NS, -_HOUR_NS])
def test_states_and_telemetry_are_stamped_by_the_own_clock(ahead_ns: int) -> None:
    apart = Apart(ahead_ns)
    sent_ns = apart.there_ns - 50 * _MS
    for topic, message in (
        (Topic.STATE, state_message(vehicle="mav1", stamp_ns=sent_ns)),
        (Topic.SLOW_TELEMETRY, telemetry("mav1", stamp_ns=sent_ns)),
    ):
        received = apart.received(topic, message)
        assert received.stamp_ns == pytest.approx(apart.now_ns - 50 * _MS, abs=2 * _MS)


@pytest.mark.parametrize("ahead_ns", [_HOUR_NS, -_HOUR_NS])
def test_the_clocks_of_a_show_are_compared_across_computers(ahead_ns: int) -> None:
    apart = Apart(ahead_ns)
    message = telemetry(
        "mav1",
        stamp_ns=apart.there_ns - 50 * _MS,
        show_id="s",
        path_time_s=10.0,
        path_rate_frac=1.0,
        is_path_paused=True,
    )
    received = apart.received(Topic.SLOW_TELEMETRY, message)
    (clock,) = other_clocks([received], "s", apart.now_ns)
    assert clock.time_s == pytest.approx(10.05, abs=0.002)
    assert clock.is_paused
