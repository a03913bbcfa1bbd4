"""What an agent tells at every tick: state and news for the neighbours, ticks for the record, telemetry for people."""

from __future__ import annotations

from onboard.agent import messages
from onboard.agent.telemetry_decimation import Brief
from onboard.bus.authority import Roles
from onboard.bus.schema import TickBatch, TickSample
from onboard.bus.topics import Topic
from onboard.config.fleet import Vehicle
from onboard.events import Command, LoopTimed, Publish
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from onboard.localization.own_state import OwnState
from onboard.neighbours.duplicate_agents import DuplicateAgents
from onboard.neighbours.subscription import is_slow
from onboard.neighbours.table import NeighbourTable
from onboard.safety.failsafe_table import Situation
from onboard.supervision.failsafe_executor import FailsafeExecutor
from onboard.types import Tick

_TELEMETRY_TICKS = 5
_BATCH_TICKS = 10


class Report:
    """Counts and batches the messages of one life of an agent."""

    def __init__(
        self,
        vehicle: Vehicle,
        boot_id: int,
        config_hash: str,
        law: str,
        *,
        own: OwnState,
        neighbours: NeighbourTable,
        flight: FlightContext,
        failsafes: FailsafeExecutor,
        roles: Roles,
        duplicates: DuplicateAgents,
    ) -> None:
        self._vehicle, self._boot_id, self._config_hash, self._law = vehicle, boot_id, config_hash, law
        self._own, self._neighbours, self._flight, self._failsafes = own, neighbours, flight, failsafes
        self._roles, self._duplicates = roles, duplicates
        self._brief = Brief()
        self._samples: list[TickSample] = []
        self._sequence = 0
        self._shown = flight.step

    def tick(
        self,
        out: list[Command],
        tick: Tick,
        view: FlightView,
        *,
        period_s: float,
        is_airborne: bool,
        distances_m: dict[str, float],
        not_ready: tuple[str, ...],
        loop: LoopTimed,
        malformed: int,
    ) -> None:
        """Add to ``out`` what is due."""
        self._sequence += 1
        flight, name, now_ns = self._flight, self._vehicle.name, view.now_ns
        state = messages.state_message(
            tick,
            vehicle=name,
            boot_id=self._boot_id,
            sequence=self._sequence,
            stamp_ns=now_ns,
            is_valid=view.has_position,
            is_airborne=is_airborne,
            is_cooperative=view.has_position and flight.is_avoiding(view) and self._failsafes.is_law_followed,
        )
        left = None if view.has_position else self._own.px4_check.place(now_ns)
        if left is not None:
            state = messages.by_px4(state, *left)
        out.append(Publish(Topic.STATE, state))
        if is_slow(self._sequence):
            out.append(Publish(Topic.FAR, state))
        active, names = int(tick.law.active_neighbour), self._neighbours.names
        avoids = names[active] if 0 <= active < len(names) else ""
        self._samples.append(
            messages.tick_sample(
                tick,
                state,
                period_s=period_s,
                doing=flight.state,
                active_neighbour=avoids,
                distances_m=distances_m,
                ages_s=self._neighbours.near_ages_s(now_ns),
                attitude_enu_flu_wxyz=self._own.attitude_wxyz(view.snapshot),
                attitude_age_s=(now_ns - view.snapshot.attitude_ns) * 1e-9 if view.snapshot.attitude_ns else 0.0,
            )
        )
        if len(self._samples) >= _BATCH_TICKS:
            batch = TickBatch(vehicle=name, boot_id=self._boot_id, sequence=self._sequence, ticks=tuple(self._samples))
            self._samples.clear()
            out.append(Publish(Topic.TICK, batch))
        shown = flight.step
        if self._sequence % _TELEMETRY_TICKS == 0 or shown != self._shown:
            self._shown = shown  # who hears of an order's end finds the state that it led to already there
            conditions, action = self._failsafes.in_words()
            telemetry = messages.telemetry(
                tick,
                now_ns,
                vehicle=self._vehicle,
                boot_id=self._boot_id,
                sequence=self._sequence,
                flight=flight,
                view=view,
                not_ready=not_ready if flight.situation is Situation.GROUND else (),
                is_airborne=is_airborne,
                distances_m=distances_m,
                law=self._law,
                state_age_s=self._own.age_s,
                mocap_delay_s=self._own.validator.delay_s,
                neighbour_age_s=self._neighbours.oldest_age_s(now_ns),
                loop=loop,
                malformed=malformed + self._neighbours.ignored_messages + self._own.ignored_samples,
                config_hash=self._config_hash,
                conditions=conditions,
                action=action,
                roles=self._roles,
                avoids=avoids,
                doubles=self._duplicates.doubled(now_ns),
            )
            told: list[Command] = [Publish(Topic.TELEMETRY, telemetry)]
            if self._brief.is_due(telemetry):
                told.append(Publish(Topic.SLOW_TELEMETRY, telemetry))
            out[:0] = told
