"""Fly a mission from the first step to the verdict.

The steps run in a task of their own. However that task ends, by its last step, a failure, a mistake
of the mission's author, an interruption or a reason from outside, all vehicles land (or do what the
mission declares), and there is a verdict.
"""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Callable
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.client.fault_orders import FaultRefused
from groundstation.client.preflight_page import advice_of
from groundstation.fleet.state import FleetState
from groundstation.mission_files.mission import Mission, with_shapes
from groundstation.mission_files.python_file import load_function
from groundstation.missions.api import Fleet, NotReady, OrderFailed
from groundstation.missions.own_link import SILENT_S, silent_in_flight
from groundstation.missions.step_runner import MissionFailed, StepRunner
from groundstation.orders.intents import Home
from groundstation.verdict.observations import FlightObservations
from groundstation.verdict.verdict import Verdict, judge
from onboard.config.fleet import ConfigError

LAND_TIMEOUT_S = 40.0
HOME_TIMEOUT_S = 90.0
READY_TIMEOUT_SIM_S = 60.0  # for the first step, when emulator and agents start with the mission
LAST_TELEMETRY_S = 0.5
_HOLD_TIMEOUT_S = 15.0

# What a mission may end with; anything else is a mistake of its author, shown with its trace.
_FAILURES = (OrderFailed, MissionFailed, FaultRefused, ConfigError)


class MissionRun:
    """One flight of a mission.

    Args:
        mission: loaded and checked.
        client: started.
        say: progress in words.
        ready_timeout_s: how long to wait for the vehicles before the first step.
    """

    def __init__(
        self,
        mission: Mission,
        client: FleetClient,
        *,
        say: Callable[[str], None] = lambda line: None,
        ready_timeout_s: float = 60.0,
    ) -> None:
        self.mission = mission
        self.client = client
        client.fleet = with_shapes(client.fleet, mission.shapes)  # only the mission has them
        self.fleet = Fleet(client, say=say)

        self._ready_timeout_s = ready_timeout_s
        self._task: asyncio.Task[Any] | None = None  # flies the steps
        self._abort_reason: str | None = None  # from outside
        self._can_land = True
        self._is_over = False

        now_ns = client.now_ns()
        self._flown = FlightObservations(
            mission=mission.name,
            fleet=mission.fleet,
            state=client.state,
            steps=self.fleet.steps,
            arrivals=self.fleet.arrivals,
            begin_ns=now_ns,
            end_ns=now_ns,
        )

    async def run(self) -> Verdict:
        """Fly it. Cancelling this coroutine is an interruption: all vehicles land, then it returns.

        Returns:
            The verdict by the live state; with :meth:`flown` a record can be judged as well.
        """
        task = self._task = asyncio.create_task(self._steps())
        if self._flown.is_interrupted or self._abort_reason is not None:
            task.cancel()

        try:
            await asyncio.wait({task})
        except asyncio.CancelledError:
            self.interrupt()
            await asyncio.wait({task})
        await self._bring_down(task)

        # Ends of orders are never lost, but telemetry may be: the next one shows the result of the
        # last step.
        await self.client.wait_for(self._is_at_rest, LAST_TELEMETRY_S)
        self._flown.end_ns = self.client.now_ns()
        self._is_over = True
        return judge(self.flown(), self.mission.expect)

    @property
    def is_over(self) -> bool:
        """Whether it has ended: its steps, and what came after them."""
        return self._is_over

    def interrupt(self) -> None:
        """Stop the mission and land all vehicles; :meth:`run` returns when they are down."""
        if self._flown.is_interrupted:
            return

        self._flown.is_interrupted = True
        if self._task is not None:
            self._task.cancel()

    def abort(self, reason: str, *, can_land: bool = True) -> None:
        """End the mission as failed, for a reason from outside.

        Args:
            reason: a sentence, which the caller has published as an event.
            can_land: whether vehicles can still be reached.
        """
        if self._abort_reason is not None or self._flown.is_interrupted:
            return

        self._abort_reason = reason
        self._can_land = can_land
        if self._task is not None:
            self._task.cancel()

    def abort_if_silent(self) -> bool:
        """End the mission when a vehicle whose last telemetry was armed is silent for SILENT_S.

        Call it several times a second. After a stall of this ground itself the vehicles get
        AFTER_STALL_S. Where nobody is heard, this ground's own link is lost: the mission waits
        until the agents land by themselves.

        Returns:
            Whether it has ended for that.
        """
        self.client.notice_own_stall()
        link = self.fleet.ground.link
        link.look()
        if link.is_lost:
            if link.landing_in_s > 0.0:
                return False
            limit_s = self.client.fleet.fleet.ground_lost_land_s
            reason = f"Nobody heard for {limit_s:g} s: my own link. The agents land by themselves."
            self.client.publish_event("critical", "own_link_lost", reason)
            self.abort(reason)
            return True

        silent = silent_in_flight(self.client)
        if not silent or link.is_settling:
            return False

        reason = (
            f"Nothing heard from {', '.join(silent)} for {SILENT_S:g} s in flight: "
            "the agent hangs or is cut off."
        )
        self.client.publish_event("critical", "agent_silent", reason)
        self.abort(reason)
        return True

    def flown(self) -> FlightObservations:
        """Return the observations so far."""
        self._flown.state = self.client.state
        self._flown.left_out = self.fleet.ground.left_out
        return self._flown

    async def _steps(self) -> None:
        """Wait for the vehicles, and fly the steps or the function of the mission."""
        self.fleet.say(f"Waiting for {', '.join(self.fleet.names)} to be ready.")
        await self.fleet.ready(self._ready_timeout_s)

        self._flown.begin_ns = self.client.now_ns()
        advised = advice_of(
            self.client.state, self.fleet.names, is_recording=self.client.is_recording
        )
        for advice, names in advised.items():
            self.fleet.say(f"Preflight, {', '.join(names)}: {advice}")

        self.fleet.ground.goes_on_without = self.mission.on_failure.do == "go_on"
        if self.mission.is_python:
            await load_function(self.mission)(self.fleet)
            return

        steps = StepRunner(self.mission, self.fleet)
        try:
            await steps.rehearse_faults()
        except FaultRefused:
            self._flown.is_wrong_input = True
            raise
        await steps.run()

    async def _bring_down(self, task: asyncio.Task[Any]) -> None:
        """Do what the end of the steps demands; after the last step nothing."""
        if task.cancelled():
            await self._bring_down_after_a_stop()
            return

        error = task.exception()
        if isinstance(error, NotReady):
            self._flown.failure = str(error)
            self._flown.nobody = not error.heard
            self.fleet.say(str(error))
        elif error is not None:
            if isinstance(error, _FAILURES):
                self._flown.failure = str(error)
            else:
                self._flown.failure = "".join(traceback.format_exception(error)).strip()
            self.fleet.say(f"The mission ends here: {self._flown.failure}")
            await self._on_failure()

    async def _bring_down_after_a_stop(self) -> None:
        """Land all after an interruption, or after a reason from outside."""
        if self._abort_reason is None:
            self._flown.is_interrupted = True
            self.fleet.say("Interrupted: all flying vehicles land.")
            await self.fleet.land_all(LAND_TIMEOUT_S, is_by_person=True)
            return

        self._flown.failure = self._abort_reason  # an event has said it
        self.fleet.say("The mission ends here.")
        if self._can_land:
            await self.fleet.land_all(LAND_TIMEOUT_S)

    async def _on_failure(self) -> None:
        """Do what the mission declares for a step that fails."""
        await self.fleet.ground.link.heard()
        if self.mission.on_failure.do == "hold":
            await self.client.order("hold all", _HOLD_TIMEOUT_S)
            return

        if self.mission.on_failure.do == "home":
            vehicles = self.client.state.vehicles
            up = tuple(name for name in self.fleet.names if vehicles[name].is_airborne)
            if up:
                order = await self.client.submit(Home(vehicles=up))
                await order.wait(HOME_TIMEOUT_S)
        await self.fleet.land_all(LAND_TIMEOUT_S)

    def _is_at_rest(self, state: FleetState) -> bool:
        return all(
            state.is_landed(name) or state.vehicles[name].is_airborne for name in self.fleet.names
        )
