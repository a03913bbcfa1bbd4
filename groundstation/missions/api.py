"""The fleet as a mission sees it: ``fleet.takeoff()``, ``fleet["mav1"].reached(...)``.

Python missions, scripts and the runner of mission files give their orders through :class:`Fleet`.
:meth:`Fleet.connect` opens the connection for a script. When its block ends, it brings vehicles
that still fly to the state that the script has declared.

A script flies on a host: the real agents of its fleet file, the emulator of ``covey fly script``,
or lockstep. The host opens the bus and keeps what a verdict needs.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable, Sequence
from numbers import Real
from pathlib import Path
from typing import Literal, get_args

from groundstation.client.client import FleetClient
from groundstation.fleet.slot_owners import vehicles_of_slots
from groundstation.fleet.state import FleetState, Separation
from groundstation.missions.argument_checks import check_duration, check_timeout
from groundstation.missions.connection import (
    check_first_connection,
    host_of,
    note_connection,
    script_name,
)
from groundstation.missions.going_home import fly_home_unless_taken, flying_by_agent
from groundstation.missions.ground import MissionGround
from groundstation.missions.group import Group
from groundstation.missions.landing import land_all
from groundstation.missions.readiness import NotReady as NotReady  # missions import it from here
from groundstation.missions.readiness import fleet_refusal, is_ready, not_ready
from groundstation.missions.taken import Taken, stay
from groundstation.missions.vehicle import MissionVehicle
from groundstation.missions.vehicle_names import Vehicles, as_names
from groundstation.orders.intents import Hold
from groundstation.orders.result import OrderFailed as OrderFailed
from groundstation.verdict.observations import Arrival, FlightObservations, StepResult
from onboard.bus.schema import Event
from onboard.config.fleet import ConfigError, FleetConfig

AtEnd = Literal["land", "hold", "home"]

_LAND_S = 40.0
_HOLD_S = 15.0


def _check_at_end(at_end: object) -> None:
    """Refuse a state at the end that does not exist."""
    if at_end not in get_args(AtEnd):
        raise ConfigError(f"at_end is {at_end!r:.80}. Write land, hold or home.")


class Fleet(Group):
    """All vehicles of a fleet, for missions.

    Args:
        client: fleet client that has been started.
        say: function that receives each line of progress.
    """

    def __init__(
        self, client: FleetClient, *, say: Callable[[str], None] = lambda line: None
    ) -> None:
        super().__init__(MissionGround(client, say=say), client.fleet.enabled_names)

    @classmethod
    @contextlib.asynccontextmanager
    async def connect(
        cls,
        fleet: FleetConfig | str | Path | None = None,
        *,
        at_end: AtEnd = "land",
        ready_timeout_s: float | None = None,
    ) -> AsyncIterator[Fleet]:
        """Connect with a fleet: its real agents, or those of ``covey fly script`` and of lockstep.

        Vehicles that still fly are left in the declared state, whether the block ends by its last
        line, an exception, a cancellation or Ctrl-C. While it does that, tasks and threads of the
        script order nothing any more, except to kill. After the block every verb is refused.

        Args:
            fleet: a fleet file or its path; None: the fleet of ``covey fly script``.
            at_end: state in which the block leaves vehicles that still fly.
            ready_timeout_s: longest wait for the vehicles [s]; 0: no wait; None: the host decides.

        Yields:
            The fleet.

        Raises:
            ConfigError: no fleet file, or a wrong one; a state at the end that does not exist; or
                the second connection of a script that has a verdict.
            NotReady: a vehicle is not ready in time, see :meth:`ready`.
        """
        check_first_connection()
        _check_at_end(at_end)
        host = host_of(fleet)
        host.at_end = at_end
        if ready_timeout_s is None:
            ready_timeout_s = host.ready_timeout_s

        async with host.opened() as client:

            def say(line: str) -> None:
                host.say(line)
                client.publish_event("info", "mission", line.strip())

            flown = cls(client, say=say)
            begin_ns = client.now_ns()
            taken: Taken | None = None
            try:
                if ready_timeout_s != 0.0:
                    await flown.ready(ready_timeout_s)
                flown.ground.watch.begin()
                note_connection()
                yield flown
            finally:
                has_begun = flown.ground.watch.has_begun
                if has_begun:  # a script that was refused has ordered nothing, and lands nobody
                    taken = await flown._end(at_end, begin_ns)
                host.flown = FlightObservations(
                    mission=script_name(),
                    fleet=client.fleet,
                    state=client.state,
                    steps=flown.steps,
                    arrivals=flown.arrivals,
                    left_out=flown.ground.left_out_in_service,
                    left_out_orders=flown.ground.left_out_orders,
                    other_ends=flown.ground.other_ends,
                    begin_ns=begin_ns,
                    end_ns=client.now_ns(),
                    is_taken=taken is not None,
                    is_left_flying=taken is not None or not has_begun,
                )

    async def _end(self, at_end: AtEnd, begin_ns: int) -> Taken | None:
        """End a script: leave its vehicles in the declared state, or to whoever has taken them.

        Args:
            at_end: the declared state.
            begin_ns: start of the script, on the ground's clock [ns].

        Returns:
            Who has taken the fleet; None if nobody has.
        """
        self.ground.begin_end()
        try:
            self.ground.note_other_ends()
            taken = self.ground.watch.takeover()
            if taken is None:
                await self._leave(at_end)
                taken = self.ground.watch.takeover()
            if taken is not None:
                await self._leave_to(taken, begin_ns)
            return taken
        finally:
            self.ground.end()

    async def leave(self, at_end: AtEnd) -> None:
        """Bring vehicles that still fly to this state, except those that a pilot flies by hand.

        Args:
            at_end: "land" where they are, "home" to land at their take-off spots, or "hold".

        Raises:
            ConfigError: there is no such state.
        """
        _check_at_end(at_end)
        await self.ground.check_not_ending()
        await self._leave(at_end)

    async def _leave(self, at_end: AtEnd) -> None:
        """Do what :meth:`leave` does, also in the end of a script."""
        if at_end == "hold":
            flying = flying_by_agent(self.client, self._names)
            if flying:
                await self.client.order(Hold(vehicles=flying), _HOLD_S, is_by_mission=True)
            return

        names = None  # all
        if at_end == "home":
            watch = self.ground.watch
            ordered = await fly_home_unless_taken(self.client, self._names, watch, say=self.say)
            if ordered is None:
                return
            if ordered:
                names = [name for name in self._names if name not in ordered]
        await self._land_all(names=names)

    async def _leave_to(self, taken: Taken, begin_ns: int) -> None:
        """Stay connected to a fleet that somebody has taken, until it is down; Ctrl-C lands all.

        Args:
            taken: who has taken the fleet.
            begin_ns: start of the script, on the ground's clock [ns].
        """
        try:
            taken = await self.ground.watch.whole_takeover(taken)
            self.say(taken.sentence)
            await stay(self.client, taken, begin_ns, self.say)
        except asyncio.CancelledError:
            await self._land_all(is_by_person=True)
            raise

    @property
    def names(self) -> tuple[str, ...]:
        """Vehicles that take part."""
        return self._taking_part

    @property
    def say(self) -> Callable[[str], None]:
        """The function that is called with each line of progress."""
        return self.ground.say

    @property
    def steps(self) -> list[StepResult]:
        """Orders so far, with their results."""
        return self.ground.steps

    @property
    def arrivals(self) -> list[Arrival]:
        """Distance of each vehicle from its goal at the end of its move."""
        return self.ground.arrivals

    @property
    def closest(self) -> Separation | None:
        """The closest pair now, by telemetry; None if fewer than two positions are known.

        A pair on the ground is returned only if no pair has a vehicle in the air.
        """
        return self.state.closest(self.client.now_ns())

    @property
    def events(self) -> list[Event]:
        """The newest events of the fleet and of the ground, oldest first."""
        return [logged.event for logged in self.state.events]

    def __getitem__(self, name: str) -> MissionVehicle:
        (name,) = vehicles_of_slots([name], self.state)  # the spare, if the vehicle was swapped
        if name not in self._names:
            raise ConfigError(
                f"'{name}' is not a vehicle of fleet '{self.config.fleet.name}': "
                f"{', '.join(self._names)}."
            )
        return MissionVehicle(self.ground, (name,))

    def group(self, vehicles: Vehicles) -> Group:
        """Return a group of vehicles that are ordered together.

        Args:
            vehicles: names or indices.

        Raises:
            ConfigError: a vehicle is not in this fleet.
        """
        return Group(self.ground, self.select(vehicles))

    async def ready(self, timeout_s: float = 60.0) -> None:
        """Wait until every vehicle reports that it may fly.

        Args:
            timeout_s: longest wait [s].

        Raises:
            ConfigError: the timeout is no number.
            NotReady: a vehicle is not ready in time or has another fleet file, one that this
                ground's file lacks is armed or flies, or another ground operates the fleet.
        """
        self.ground.check_not_ended()
        check_timeout(timeout_s, "ready")

        def are_ready(state: FleetState) -> bool:
            self.ground.leave_out_disabled()
            return all(is_ready(state, name, self.client.now_ns()) for name in self.names)

        if not await self.client.wait_for(are_ready, timeout_s):
            raise not_ready(self.state, self.names, self.client.now_ns(), timeout_s)

        # The newest telemetry says who operates, and control may not have read it yet.
        self.client.control.update(self.client.state)
        refusal = self.client.control.refusal("takeoff")
        if refusal is None:
            await self.client.listen()
            now_ns = self.client.now_ns()
            refusal = fleet_refusal(self.state, self.names, self.config, now_ns)
        if refusal:
            raise NotReady(refusal, is_anybody_heard=True)

    def leave_out(self, *vehicles: Vehicles) -> None:
        """Go on without these vehicles.

        From now on the selection "all" does not contain them, and their failures do not end the
        mission.

        Args:
            vehicles: names or indices. These vehicles do what their last order or their failsafe
                says, and land at the mission's end.

        Raises:
            ConfigError: a vehicle is not in this fleet; then none is left out.
        """
        selected = [self.select(some, with_lost=True) for some in vehicles]
        self.ground.leave_out(*itertools.chain.from_iterable(selected))

    async def fault(
        self,
        name: str,
        vehicles: Vehicles,
        *,
        after_s: float = 0.0,
        duration_s: float = 0.0,
        is_rehearsal: bool = False,
        **parameters: float | str,
    ) -> None:
        """Inject a fault into the emulator.

        Args:
            name: name of the fault; `covey sitl --faults` lists them.
            vehicles: vehicles that get the fault.
            after_s: time from now until it begins, simulated seconds.
            duration_s: duration of the fault, simulated seconds; 0 for ever.
            is_rehearsal: whether the fault is only checked, and not injected.
            parameters: parameters of this fault.

        Raises:
            ConfigError: a time is negative or no number, or a parameter is neither number nor text.
            FaultRefused: the fault is impossible, or this flight is not simulated.
        """
        self.ground.check_not_ended()
        check_duration(after_s, "fault")
        check_duration(duration_s, "fault")
        for key, value in parameters.items():
            if not isinstance(value, Real | str):
                raise ConfigError(f"fault: {key} is {value!r:.80}. Give a number or a text.")

        when = ""
        if after_s > 0.0:
            when = f" in {after_s:g} s"

        for vehicle in self.config.select(as_names(vehicles)):
            sentence = await self.client.fault(
                name,
                vehicle,
                parameters,
                after_s=after_s,
                duration_s=duration_s,
                is_rehearsal=is_rehearsal,
            )
            if not is_rehearsal:
                self.say(f"fault{when}: {sentence}")

    async def land_all(
        self,
        timeout_s: float = _LAND_S,
        *,
        is_by_person: bool = False,
        names: Sequence[str] | None = None,
    ) -> bool:
        """Land all vehicles that are not down yet.

        Vehicles that land already get no new order, so an operator's order to land stays in force.

        Args:
            timeout_s: longest wait [s], in addition to twice the time of the descent from the
                vehicles' heights; it may be infinite.
            is_by_person: whether a person, and not only the mission, has ordered the landing. Then,
                while this ground hears no agent, the order goes straight to the PX4s.
            names: vehicles to land; None: all of the fleet.

        Returns:
            Whether all of them are landed and disarmed.

        Raises:
            ConfigError: the timeout is no number.
        """
        await self.ground.check_not_ending()
        check_timeout(timeout_s, "land_all")
        return await self._land_all(timeout_s, is_by_person=is_by_person, names=names)

    async def _land_all(
        self,
        timeout_s: float = _LAND_S,
        *,
        is_by_person: bool = False,
        names: Sequence[str] | None = None,
    ) -> bool:
        """Do what :meth:`land_all` does, also in the end of a script."""
        superseded = []  # vehicles whose last order another ground has replaced
        if self.steps:
            last_phases = self.steps[-1].vehicles
            superseded = [name for name, phase in last_phases.items() if phase == "superseded"]
        return await land_all(
            self.client,
            superseded,
            timeout_s,
            say=self.say,
            link=self.ground.link,
            watch=self.ground.watch,
            is_by_person=is_by_person,
            names=names,
        )
