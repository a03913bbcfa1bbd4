"""Messages of every tick: the state for the neighbours, samples for the record, telemetry for
people.
"""

from __future__ import annotations

from onboard.agent import messages
from onboard.agent.messages import AgentIdentity, RunCounters, TelemetrySources, TickResult
from onboard.agent.telemetry_decimation import TelemetryDecimation
from onboard.agent_commands import Command, Publish
from onboard.agent_inputs import LoopTimed
from onboard.bus.schema import StateMessage, TickBatch, TickSample
from onboard.bus.topics import Topic
from onboard.message_counts import MessageCounts, total
from onboard.neighbours.subscription import is_slow

_TELEMETRY_TICKS = 5
_BATCH_TICKS = 10


class TelemetryPublisher:
    """Counts and batches the messages of one run of an agent."""

    def __init__(
        self, identity: AgentIdentity, sources: TelemetrySources, state_ticks: int = 1
    ) -> None:
        self.loop = LoopTimed(0.0, 0.0, 0.0, 0)  # newest statistics of the loop
        # of messages that reached neither the neighbours' table nor the own state
        self.counts = MessageCounts()
        self._identity, self._sources = identity, sources
        self._state_ticks = state_ticks  # from one state for the near neighbours to the next
        self._decimation = TelemetryDecimation()
        self._samples: list[TickSample] = []
        self._sequence = 0
        self._published_step = sources.flight.step

    def every_tick(self, result: TickResult) -> list[Command]:
        """Return the messages of this tick but the telemetry."""
        self._sequence += 1
        state = self._state(result)
        commands: list[Command] = []
        if self._sequence % self._state_ticks == 0:
            commands.append(Publish(Topic.STATE, state))
        if is_slow(self._sequence):
            commands.append(Publish(Topic.FAR, state))
        self._samples.append(messages.tick_sample(result, state, self._sources))
        if len(self._samples) >= _BATCH_TICKS:
            identity = self._identity
            batch = TickBatch(
                vehicle=identity.vehicle.name,
                boot_id=identity.boot_id,
                sequence=self._sequence,
                ticks=tuple(self._samples),
            )
            self._samples.clear()
            commands.append(Publish(Topic.TICK, batch))
        return commands

    def telemetry(self, result: TickResult) -> list[Command]:
        """Return the telemetry when it is due: ten times a second, and at once when the step has
        changed.

        It is to be sent before the events of the same tick, so that a receiver of an order's end
        finds the state that the order led to.
        """
        step = self._sources.flight.step
        if self._sequence % _TELEMETRY_TICKS and step is self._published_step:
            return []
        self._published_step = step
        sources = self._sources
        counts = total((self.counts, sources.neighbours.counts, sources.own.counts))
        counters = RunCounters(self._sequence, self.loop, counts)
        telemetry = messages.telemetry(self._identity, result, sources, counters)
        commands: list[Command] = [Publish(Topic.TELEMETRY, telemetry)]
        if self._decimation.is_due(telemetry):
            commands.append(Publish(Topic.SLOW_TELEMETRY, telemetry))
        return commands

    def _state(self, result: TickResult) -> StateMessage:
        view, sources = result.view, self._sources
        is_avoiding = (
            view.has_position
            and sources.flight.is_avoiding(view)
            and sources.failsafes.is_law_followed
        )
        state = messages.state_message(
            self._identity, result, self._sequence, is_cooperative=is_avoiding
        )
        if view.has_position:
            return state
        last_known = sources.own.px4_check.motion(view.now_ns)
        return state if last_known is None else messages.px4_state_message(state, *last_known)
