"""Publishes the messages of every tick.

The state is for the neighbours, and the telemetry is for people. A sample of every tick goes to the
record, in batches.
"""

from __future__ import annotations

from typing import NamedTuple

from onboard.agent import messages
from onboard.agent.messages import AgentIdentity, RunCounters, TelemetrySources, TickResult
from onboard.agent.telemetry_decimation import TelemetryDecimation
from onboard.agent_commands import Command, Publish
from onboard.agent_inputs import LoopTimed
from onboard.bus.schema import StateMessage, TickBatch, TickSample
from onboard.bus.topics import Topic
from onboard.message_counts import MessageCounts, total
from onboard.neighbours.subscription import is_slow

_TELEMETRY_TICKS = 5  # number of ticks between two telemetry messages
_BATCH_TICKS = 10  # number of samples in one message to the record


class TickMessages(NamedTuple):
    """Messages of one tick, in two parts that go at different places among its commands."""

    # This part goes before the events of the same tick. So a program that receives the end of an
    # order already has the resulting state.
    telemetry: list[Command]
    others: list[Command]  # this part goes after the setpoint


class TelemetryPublisher:
    """Counts and batches the messages of one run of an agent."""

    def __init__(
        self, identity: AgentIdentity, sources: TelemetrySources, state_ticks: int = 1
    ) -> None:
        # newest statistics of the loop
        self.loop = LoopTimed(p50_ms=0.0, p99_ms=0.0, max_ms=0.0, late_ticks=0)
        # unused messages, except those that the neighbour table and the own state count
        self.counts = MessageCounts()

        self._identity = identity
        self._sources = sources
        # number of ticks between two states for the vehicles that receive this one at full rate
        self._state_ticks = state_ticks
        self._decimation = TelemetryDecimation()
        self._samples: list[TickSample] = []
        self._sequence = 0  # number of ticks
        self._published_step = sources.flight.step

    def publish(self, result: TickResult) -> TickMessages:
        """Return the messages of this tick."""
        self._sequence += 1
        state = self._state(result)
        self._samples.append(messages.tick_sample(result, state, self._sources))

        others: list[Command] = []
        if self._sequence % self._state_ticks == 0:
            others.append(Publish(Topic.STATE, state))
        if is_slow(self._sequence):  # for vehicles that do not follow this one
            others.append(Publish(Topic.FAR, state))
        if len(self._samples) >= _BATCH_TICKS:
            others.append(Publish(Topic.TICK, self._batch()))

        # ten times a second, and at once after a change of the step
        telemetry: list[Command] = []
        step = self._sources.flight.step
        if self._sequence % _TELEMETRY_TICKS == 0 or step is not self._published_step:
            self._published_step = step
            telemetry = self._telemetry(result)

        return TickMessages(telemetry, others)

    def _state(self, result: TickResult) -> StateMessage:
        view = result.view
        state = messages.state_message(self._identity, result, self._sequence)
        if view.has_position:
            return state

        px4_motion = self._sources.own.px4_check.motion(view.now_ns)
        if px4_motion is None:
            return state
        return messages.px4_state_message(state, px4_motion)

    def _batch(self) -> TickBatch:
        """Return the samples since the last batch."""
        batch = TickBatch(
            vehicle=self._identity.vehicle.name,
            boot_id=self._identity.boot_id,
            sequence=self._sequence,
            ticks=tuple(self._samples),
        )
        self._samples.clear()
        return batch

    def _telemetry(self, result: TickResult) -> list[Command]:
        sources = self._sources
        parts = (self.counts, sources.neighbours.counts, sources.own.counts)
        counts = total((*parts, *sources.corrections_counts))
        counters = RunCounters(self._sequence, self.loop, counts)
        telemetry = messages.telemetry(self._identity, result, sources, counters)

        commands: list[Command] = [Publish(Topic.TELEMETRY, telemetry)]
        if self._decimation.is_due(telemetry):
            commands.append(Publish(Topic.SLOW_TELEMETRY, telemetry))
        return commands
