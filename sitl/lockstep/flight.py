"""A flight in lockstep: the simulated fleet, and a ground station with its record and verdict.

The ground's client and mission runner are the real ones. They are asyncio code, and run in an event
loop whose clock is the simulated time. A test or a script can therefore give orders and wait for
results as a person would, only faster. Tests, ``covey fly --lockstep`` and the campaigns use this
class.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import math
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any, TypeVar

from msgspec.structs import replace

from groundstation.client.client import FleetClient
from groundstation.client.direct_mavlink import PILOT_MODES, DirectCommand, DirectResult
from groundstation.fleet.state import FleetState
from groundstation.fleet.touchdown import Touchdown
from groundstation.flights.left_tasks import end_other_tasks
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission import Mission
from groundstation.missions.api import Fleet
from groundstation.missions.connection import (
    INSIDE_COROUTINE,
    hosted,
    refuse_call,
    run_script,
)
from groundstation.missions.runner import READY_TIMEOUT_SIM_S, MissionRun
from groundstation.orders.result import VehicleResult
from groundstation.recording.channels import RECORDED
from groundstation.recording.writer import RecordEnd
from groundstation.verdict.final_verdict import final_verdict
from groundstation.verdict.observations import FlightObservations
from groundstation.verdict.verdict import Verdict
from onboard.bus.schema import Event
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet
from sitl.emulator.emulator import Environment
from sitl.emulator.mocap import MocapSettings
from sitl.faults.catalogue import Fault
from sitl.lockstep.agents import AgentShell
from sitl.lockstep.bus import SimBus
from sitl.lockstep.connections import BusSettings
from sitl.lockstep.lockstep_record import LockstepRecord
from sitl.lockstep.simulated_event_loop import VirtualLoop
from sitl.lockstep.simulation import EPOCH_NS, Simulation
from sitl.px4.modes import MODES, CommandResult, Mode

GROUND = "ground-1"
_DIRECT_DELAY_S = 0.01  # time that a direct command takes to reach PX4
_DIRECT_RETRY_S = 0.2  # period of a direct command until it is answered
_WATCH_S = 0.2  # time between two checks for silent vehicles
_FORCE = 21196.0  # parameter 2 of MAV_CMD_COMPONENT_ARM_DISARM: disarm also in the air
_OTHER_THREAD = (
    "in lockstep its verbs are for the script's first thread only, in which the simulated time "
    "passes. Let things happen at the same time in a function for fleet.run, or fly with --sitl."
)

# number of new objects that triggers garbage collection; with Python's default of 700 the collector
# takes a fifth of a flight's time
_COLLECT_EVERY = 50_000

T = TypeVar("T")


class Lockstep:
    """One fleet and its ground station, flown order by order or by whole missions.

    Args:
        fleet: a fleet file or its path.
        seed: the seed of all random numbers.
        law: name of the avoidance law to use; None: the one in the fleet file.
        bus: quality of the bus connections.
        mocap: quality of the motion capture.
        environment: wind, downwash and errors; a calm room by default.
        folder: the folder of the record; None records nothing.
        as_if_recorded: whether the ground subscribes and publishes as if the flight were recorded,
            even without a folder. Flights with and without a record are then the same.
        say: called with each line of progress.
        is_compiled: see :class:`Simulation`.
    """

    def __init__(
        self,
        fleet: FleetConfig | str | Path,
        *,
        seed: int = 0,
        law: str | None = None,
        bus: BusSettings | None = None,
        mocap: MocapSettings | None = None,
        environment: Environment | None = None,
        folder: Path | None = None,
        as_if_recorded: bool = False,
        say: Callable[[str], None] = lambda line: None,
        is_compiled: bool = True,
    ) -> None:
        if not isinstance(fleet, FleetConfig):
            fleet = load_fleet(fleet)
        config = fleet.with_law(law)
        config.import_law()

        self._collect_thresholds = gc.get_threshold()
        _, second_threshold, third_threshold = self._collect_thresholds
        gc.set_threshold(_COLLECT_EVERY, second_threshold, third_threshold)

        self.config = config
        self.may_land_hard = False  # a test sets it if a hard landing is part of the test
        # after `close`: whether a mission has left a task that catches its own end
        self.has_stubborn_tasks = False
        self.folder = folder
        self.say = say
        self.simulation = Simulation(
            config,
            seed=seed,
            bus=bus,
            mocap=mocap,
            environment=environment,
            is_compiled=is_compiled,
        )

        # a record needs more topics than a flight
        extra_topics: Sequence[Topic] = ()
        if folder is not None or as_if_recorded:
            extra_topics = RECORDED
        self.client = FleetClient(
            config,
            bus=self.simulation.bus.node(GROUND),
            extra_topics=extra_topics,
            send=self._send_directly,
            clock_ns=self.simulation.clock_ns,
        )

        self.record: LockstepRecord | None = None
        if folder is not None:
            self.record = LockstepRecord(folder, EPOCH_NS, say=self.client.publish_event)
            self.client.add_sink(self.record.put)

        self.fleet = Fleet(self.client, say=self._say_as_event)
        self.run_under_way: MissionRun | None = None  # the run of the newest mission
        self._thread = threading.current_thread()  # in which the flight's time passes
        self._loop = VirtualLoop(self.simulation.clock_ns, self.simulation.step)
        self._started: set[asyncio.Task[object]] = set()  # asyncio itself does not keep tasks alive
        self._runner = asyncio.Runner(loop_factory=lambda: self._loop)
        self.wait_for(self.client.start())
        if self.record is not None or as_if_recorded:
            self.client.announce_recording(True)

    # -- scripts -----------------------------------------------------------------------------------

    # the attributes and methods of a script's host (groundstation.missions.connection)
    ready_timeout_s = READY_TIMEOUT_SIM_S
    flown: FlightObservations | None = None
    at_end = "land"

    @contextlib.asynccontextmanager
    async def opened(self) -> AsyncIterator[FleetClient]:
        """Return the ground's client to a script that connects."""
        yield self.client

    def call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine of a script to its end, in simulated time.

        Raises:
            ConfigError: it is called in another thread than the flight's, or inside a coroutine.
        """
        if threading.current_thread() is not self._thread:
            refuse_call(coroutine, _OTHER_THREAD)
        if self._loop.is_running():
            refuse_call(coroutine, INSIDE_COROUTINE)
        return self.wait_for(coroutine)

    def end_calls(self) -> None:
        """Do nothing, because scripts run in the flight's own thread."""

    def end_record(self) -> RecordEnd | None:
        """Finish the record and return how it ended, or None if nothing was recorded."""
        if self.record is None:
            return None

        self.record.stop()
        return self.record.end

    def run_script(self, path: str | Path, *arguments: str) -> None:
        """Run a Python script that connects with this fleet, with or without ``asyncio.run``.

        Exceptions of the script are passed on.
        """
        in_real_time = asyncio.run
        asyncio.run = lambda main, **_: self.wait_for(main)
        try:
            run_script(path, arguments, self)
        finally:
            asyncio.run = in_real_time

    # -- time --------------------------------------------------------------------------------------

    def wait_for(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine of the ground to its end, in simulated time, and return its result.

        ``Fleet.connect`` in the coroutine connects with this flight.
        """
        with hosted(self):
            return self._runner.run(coroutine)

    def start_soon(self, coroutine: Coroutine[Any, Any, object]) -> None:
        """Start a coroutine that runs alongside the ground's; planned calls may use this too."""
        self._loop.call_soon(self._start, coroutine)

    def _start(self, coroutine: Coroutine[Any, Any, object]) -> None:
        task = self._loop.create_task(coroutine)
        self._started.add(task)
        task.add_done_callback(self._started.discard)

    def run(self, duration_s: float) -> None:
        """Let simulated time pass."""
        self.wait_for(asyncio.sleep(duration_s))

    def until(self, condition: Callable[[FleetState], bool], timeout_s: float = 60.0) -> bool:
        """Let time pass until the ground sees a condition; return whether it saw it in time."""
        return self.wait_for(self.client.wait_for(condition, timeout_s))

    def at(self, time_s: float, function: Callable[[], object]) -> None:
        """Call a function at a time [s since the start], for instance to begin or end a fault."""
        self.simulation.at(time_s, function)

    def inject(self, fault: Fault) -> Fault:
        """Plan a fault of the emulator, of a MAVLink link or of the motion capture."""
        return self.simulation.inject(fault)

    def hold_ground(self, duration_s: float, *, is_stopped: bool = False) -> None:
        """Let the ground's process stand still for a time.

        Args:
            duration_s: how long it stands still.
            is_stopped: True cuts it from the bus as well, as SIGSTOP does. False means that its
                computer is too busy for its event loop while messages keep arriving.
        """
        self._loop.stand_still(duration_s)
        if is_stopped:
            self.bus.partition([GROUND])
            self.at(self.time_s + duration_s, self.bus.heal)

    @property
    def agents(self) -> dict[str, AgentShell]:
        """The agents' simulated processes, which can be killed, stopped and started again."""
        return self.simulation.agents

    @property
    def bus(self) -> SimBus:
        """The bus, which can be cut and healed."""
        return self.simulation.bus

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self.simulation.time_s

    # -- orders ------------------------------------------------------------------------------------

    def ready(self, timeout_s: float = READY_TIMEOUT_SIM_S) -> None:
        """Wait until all vehicles are ready to fly."""
        self.wait_for(self.fleet.ready(timeout_s))

    def takeoff(self, height_m: float = 1.0, vehicles: str = "all") -> dict[str, VehicleResult]:
        """Wait until all vehicles are ready, and take off."""
        self.ready()
        return self.wait_for(self.fleet.takeoff(height_m, vehicles))

    def order(self, text: str, timeout_s: float = 40.0) -> dict[str, VehicleResult]:
        """Give an order as in the console, for instance ``move mav1 0 1 1``, and wait for its end.

        Returns:
            The results by vehicle.
        """
        return self.wait_for(self.client.order(text, timeout_s))

    def land(self, vehicles: str = "all") -> dict[str, VehicleResult]:
        """Land and disarm."""
        return self.wait_for(self.fleet.land(vehicles))

    def fly(
        self,
        mission: Mission | str | Path,
        *,
        stays: bool = False,
        longest_stay_s: float | None = None,
        **arguments: object,
    ) -> Verdict:
        """Fly a mission from the first step to the verdict, and finish the record if there is one.

        Args:
            mission: the mission or its file.
            stays: whether the run continues, as in ``covey fly``, after an operator has taken the
                fleet from the mission.
            longest_stay_s: longest time for which it does; None: no limit.
            arguments: arguments of a Python mission.
        """
        if not isinstance(mission, Mission):
            mission = load_mission(mission, self.config)
        if arguments:
            texts = {name: str(value) for name, value in arguments.items()}
            mission = replace(mission, arguments=texts)
        return self.wait_for(self._fly(mission, stays=stays, longest_stay_s=longest_stay_s))

    async def _fly(self, mission: Mission, *, stays: bool, longest_stay_s: float | None) -> Verdict:
        run = MissionRun(
            mission,
            self.client,
            say=self._say_as_event,
            ready_timeout_s=READY_TIMEOUT_SIM_S,
            stays=stays,
            longest_stay_s=longest_stay_s,
        )
        self.run_under_way = run
        self.fleet = run.fleet

        watch = asyncio.create_task(self._watch(run))
        try:
            verdict = await run.run()
        finally:
            watch.cancel()
        run.fleet.ground.is_closed = False  # a test may give orders after a mission

        if self.record is None or self.folder is None:
            return verdict

        # the record holds more messages than the run has used, so its verdict is the final one
        self.record.stop()
        return final_verdict(
            run.flown(),
            mission.expect,
            self.folder,
            self.record.end,
        )

    async def _watch(self, run: MissionRun) -> None:
        """End the mission when its vehicles fall silent, which no event reports."""
        has_ended = False
        while not has_ended:
            has_ended = run.check()
            if not has_ended:
                await asyncio.sleep(_WATCH_S)

    def _say_as_event(self, line: str) -> None:
        """Report a line of progress, and publish it as an event of the mission."""
        self.say(line)
        self.client.publish_event("info", "mission", line.strip())

    # -- what happened -----------------------------------------------------------------------------

    @property
    def state(self) -> FleetState:
        """The fleet as the ground sees it."""
        return self.client.state

    @property
    def events(self) -> list[Event]:
        """Events that the ground has received, oldest first."""
        return [logged.event for logged in self.client.state.events]

    @property
    def min_separation_m(self) -> float:
        """Smallest distance [m] of two vehicles so far, by ground truth.

        Only pairs with at least one flying vehicle count; infinite if there was none.
        """
        smallest = self.client.state.smallest_truth
        if smallest is None:
            return math.inf
        return smallest.distance_m

    @property
    def touchdowns(self) -> tuple[Touchdown, ...]:
        """First ground contact of each landing so far, with its vertical speed, oldest first."""
        return self.client.state.touchdowns

    @property
    def hard_touchdowns(self) -> list[str]:
        """Sentences about vehicles that touched down too fast despite having full thrust."""
        sentences = []
        for touchdown in self.touchdowns:
            vehicle = self.config.vehicles[touchdown.vehicle]
            if touchdown.is_hard(vehicle):
                sentences.append(touchdown.sentence(vehicle))
        return sentences

    def px4_position_error_m(self, vehicle: str) -> float:
        """Return the distance [m] between a vehicle's true position and its PX4's estimate."""
        emulator = self.simulation.emulator
        index = self.simulation.names.index(vehicle)
        truth_ned_m = emulator.world.vehicles.states.position_ned_m[index].tolist()
        north_m, east_m, down_m = emulator.estimator.local(index).position_ned_m

        # without a motion capture the origin of PX4's local frame is where the vehicle started
        config = self.config.vehicles[vehicle]
        if not config.mocap_required:
            start_east_m, start_north_m, start_up_m = config.start_enu_m
            north_m += start_north_m
            east_m += start_east_m
            down_m -= start_up_m

        return math.dist(truth_ned_m, (north_m, east_m, down_m))

    def close(self) -> None:
        """End the flight and finish its record; a second call does nothing."""
        if self.record is not None:
            self.record.stop()
        if self.client.is_started:
            self.wait_for(self.client.stop())
            self.has_stubborn_tasks = not self.wait_for(end_other_tasks())
        if not self.has_stubborn_tasks:  # the loop would wait for them for ever
            self._runner.close()
        gc.set_threshold(*self._collect_thresholds)

    def __enter__(self) -> Lockstep:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    async def _send_directly(self, command: DirectCommand) -> DirectResult:
        """Land or disarm a vehicle directly; see ``groundstation.client.direct_mavlink``."""
        emulator = self.simulation.emulator
        system_ids = [spec.system_id for spec in emulator.specs]
        index = system_ids.index(command.system_id)
        is_hung = emulator.disturbances.is_hung

        no_answer = DirectResult(
            is_accepted=False,
            is_disarmed=False,
            sentence=(
                f"PX4 did not answer at {command.endpoint} within {command.timeout_s:g} s either"
            ),
            has_answered=False,
        )

        await asyncio.sleep(_DIRECT_DELAY_S)
        if is_hung[index]:
            await asyncio.sleep(command.timeout_s)
            return no_answer

        px4 = emulator.autopilots[index]
        now_s = emulator.clock_s(index)
        is_pilots_mode = MODES[px4.shown_mode].main in PILOT_MODES
        is_flown_by_hand = is_pilots_mode and px4.has_sticks(now_s)
        if command.spares_pilot and px4.is_armed and is_flown_by_hand:
            return DirectResult(
                is_accepted=False,
                is_disarmed=False,
                sentence="a pilot flies it by hand",
                is_flown_by_hand=True,
            )

        answer = await self._px4_answer(index, command)
        if answer is None:
            return no_answer
        px4 = emulator.autopilots[index]
        is_accepted = answer is CommandResult.ACCEPTED

        if is_accepted:
            end_s = emulator.time_s + command.watch_s
            while px4.is_armed and emulator.time_s < end_s:
                await asyncio.sleep(1.0)  # PX4 reports once a second whether it is armed
                px4 = emulator.autopilots[index]  # another object if PX4 was restarted meanwhile

        is_disarmed = is_accepted and not px4.is_armed and not is_hung[index]
        sentence = f"PX4 {answer.name.lower().replace('_', ' ')} it"
        if is_disarmed:
            sentence += ", and it is disarmed"
        return DirectResult(is_accepted, is_disarmed, sentence)

    async def _px4_answer(self, index: int, command: DirectCommand) -> CommandResult | None:
        """Send a command over a vehicle's ground link until PX4 answers; None if it is late."""
        emulator = self.simulation.emulator
        links = self.simulation.links
        answered: asyncio.Future[CommandResult] = self._loop.create_future()

        def receive(answer: CommandResult) -> None:
            if not answered.done():
                answered.set_result(answer)

        def obey() -> None:
            px4 = emulator.autopilots[index]
            now_s = emulator.clock_s(index)
            if command.kind == "land":
                answer = px4.request(now_s, Mode.LAND)
            else:
                answer = px4.request_arm(now_s, arm=False, magic=_FORCE)
            links.answer_ground(index, lambda: receive(answer))

        end_s = emulator.time_s + command.timeout_s
        while not answered.done() and emulator.time_s < end_s:
            links.send_from_ground(index, obey)
            if not answered.done():
                await asyncio.wait({answered}, timeout=_DIRECT_RETRY_S)
        if not answered.done():
            return None
        return answered.result()
