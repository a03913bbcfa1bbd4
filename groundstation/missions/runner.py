"""Fly a mission from the first step to the verdict; after any failure all vehicles land, and there
is a verdict.
"""

from __future__ import annotations

import asyncio
import importlib.util
import inspect
import traceback
from collections.abc import Awaitable, Callable
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.client.fault_orders import FaultRefused
from groundstation.client.preflight_page import advice_of
from groundstation.fleet.state import FleetState
from groundstation.mission_files.mission import Mission, with_shapes
from groundstation.mission_files.python_file import arguments_of
from groundstation.missions.api import Fleet, NotReady, OrderFailed
from groundstation.missions.landing import SILENT_S, silent_in_flight
from groundstation.missions.step_runner import MissionFailed, StepRunner
from groundstation.orders.intents import Home
from groundstation.verdict.verdict import FlightObservations, Verdict, judge
from onboard.config.fleet import ConfigError

LAND_TIMEOUT_S = 40.0
HOME_TIMEOUT_S = 90.0
READY_TIMEOUT_SIM_S = 60.0  # for the first step, when emulator and agents start with the mission
LAST_TELEMETRY_S = 0.5


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
        # formations that only the mission has
        client.fleet = with_shapes(client.fleet, mission.shapes)
        self.fleet = Fleet(client, say=say)
        self._ready_timeout_s = ready_timeout_s
        self._aborted: str | None = None
        self._can_land = True
        now_ns, steps, arrivals = client.now_ns(), self.fleet.steps, self.fleet.arrivals
        self._flown = FlightObservations(
            mission.name,
            mission.fleet,
            client.state,
            steps,
            arrivals,
            begin_ns=now_ns,
            end_ns=now_ns,
        )
        self._task: asyncio.Task[Any] | None = None
        self._is_over = False

    async def run(self) -> Verdict:
        """Fly it. Cancelling this coroutine is an interruption: all vehicles land, then it returns.

        Returns:
            The verdict by the live state; with :meth:`flown` a record can be judged as well.
        """
        task = self._task = asyncio.create_task(self._steps())
        if self._flown.is_interrupted or self._aborted is not None:
            task.cancel()
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError:
            self.interrupt()
            await asyncio.wait({task})
        # the vehicles land after any exception of a mission, also after a mistake of its author
        error = None if task.cancelled() else task.exception()
        if task.cancelled() and self._aborted is not None:
            self._flown.failure = self._aborted  # an event has said it
            self.fleet.say("The mission ends here.")
            if self._can_land:
                await self.fleet.land_all(LAND_TIMEOUT_S)
        elif task.cancelled():
            self._flown.is_interrupted = True
            self.fleet.say("Interrupted: all flying vehicles land.")
            await self.fleet.land_all(LAND_TIMEOUT_S)
        elif isinstance(error, NotReady):
            self._flown.failure, self._flown.nobody = str(error), not error.heard
            self.fleet.say(str(error))
        elif error is not None:
            is_known = isinstance(error, (OrderFailed, MissionFailed, FaultRefused, ConfigError))
            self._flown.failure = (
                str(error) if is_known else "".join(traceback.format_exception(error)).strip()
            )
            self.fleet.say(f"The mission ends here: {self._flown.failure}")
            await self._on_failure()
        # ends of orders are never lost, but telemetry may be: the next one shows the result of the
        # last step
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
        if not self._flown.is_interrupted:
            self._flown.is_interrupted = True
            if self._task is not None:
                self._task.cancel()

    def abort(self, reason: str, *, can_land: bool = True) -> None:
        """End the mission as failed, for a reason from outside.

        Args:
            reason: a sentence, which the caller has published as an event.
            can_land: whether vehicles can still be reached.
        """
        if self._aborted is None and not self._flown.is_interrupted:
            self._aborted, self._can_land = reason, can_land
            if self._task is not None:
                self._task.cancel()

    def abort_if_silent(self) -> bool:
        """End the mission when a vehicle whose last telemetry was armed has been silent for
        SILENT_S.

        Call it several times a second. After a stall of this ground itself the vehicles get
        AFTER_STALL_S.

        Returns:
            Whether one has.
        """
        self.client.notice_own_stall()
        silent = silent_in_flight(self.client)
        if silent:
            names = ", ".join(silent)
            reason = f"Nothing heard from {names} for {SILENT_S:g} s in flight: the agent hangs or is cut off."
            self.client.publish_event("critical", "agent_silent", reason)
            self.abort(reason)
        return bool(silent)

    def _is_at_rest(self, state: FleetState) -> bool:
        return all(
            state.is_landed(name) or state.vehicles[name].is_airborne for name in self.fleet.names
        )

    def flown(self) -> FlightObservations:
        """Return the observations so far."""
        self._flown.state, self._flown.left_out = self.client.state, self.fleet.ground.left_out
        return self._flown

    async def _steps(self) -> None:
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

    async def _on_failure(self) -> None:
        if self.mission.on_failure.do == "hold":
            await self.client.order("hold all", 15.0)
            return
        if self.mission.on_failure.do == "home":
            up = tuple(
                name for name in self.fleet.names if self.client.state.vehicles[name].is_airborne
            )
            if up:
                await (await self.client.submit(Home(vehicles=up))).wait(HOME_TIMEOUT_S)
        await self.fleet.land_all(LAND_TIMEOUT_S)


def load_function(mission: Mission) -> Callable[[Fleet], Awaitable[None]]:
    """Load the coroutine function ``mission`` of a Python mission.

    Args:
        mission: loaded and checked.

    Returns:
        The function, with the mission's arguments.

    Raises:
        ConfigError: its module cannot be run, or it does not take these arguments.
    """
    spec = importlib.util.spec_from_file_location(f"covey_mission_{mission.name}", mission.path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{mission.path}: this file cannot be loaded as a Python module.")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (ImportError, NameError, TypeError, ValueError, AttributeError, OSError) as error:
        raise ConfigError(
            f"{mission.path}: running it failed: {type(error).__name__}: {error}."
        ) from error
    function = module.mission
    if not inspect.iscoroutinefunction(function):
        raise ConfigError(
            f"{mission.path}: 'mission' must be written as 'async def mission(fleet):'."
        )
    arguments = arguments_of(function, mission.arguments, mission.path)
    return lambda fleet: function(fleet, **arguments)
