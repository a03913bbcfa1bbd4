"""Flies a mission from the first step to the verdict.

The steps run in a task of their own. That task may end by its last step, a failure, a mistake of
the mission's author, an interruption or a reason from outside. In each case all vehicles land, or
do what the mission declares, and there is a verdict.
"""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from groundstation.client.client import FleetClient
from groundstation.client.fault_orders import FaultRefused
from groundstation.client.preflight_page import advice_of
from groundstation.fleet.answered_stops import answered_stop
from groundstation.fleet.state import FleetState
from groundstation.mission_files.mission import Mission, with_shapes
from groundstation.mission_files.python_file import load_function
from groundstation.mission_files.wall_time import WallTime, local_now
from groundstation.missions.api import Fleet, NotReady, OrderFailed
from groundstation.missions.beginning import begin_refusal, step_times, time_refusal
from groundstation.missions.conditions import ConditionTimeout
from groundstation.missions.countdown import CountdownEnded
from groundstation.missions.going_home import fly_home_unless_taken
from groundstation.missions.hover_check import WindTooStrong
from groundstation.missions.landing import wait_for_landings
from groundstation.missions.left_out_awaits import left_out_awaits
from groundstation.missions.own_link import SILENT_S, silent_in_flight
from groundstation.missions.step_runner import MissionFailed, StepRunner, first_failure
from groundstation.missions.taken import Taken, flown_by_hand, pilot_words, stay
from groundstation.verdict.observations import FlightObservations, collided_vehicles
from groundstation.verdict.verdict import Verdict, judge
from onboard.config.fleet import ConfigError
from onboard.plain_text import listed

LAND_TIMEOUT_S = 40.0
# Timeout of the first step when emulator and agents start with the mission.
READY_TIMEOUT_SIM_S = 60.0
LAST_TELEMETRY_S = 0.5  # longest wait for telemetry that shows the newest state
_HOLD_TIMEOUT_S = 15.0
_LOOK_S = 0.2  # time between two looks for an order to stop, before the mission begins
# A Python mission may catch its cancellation: it is cancelled again, and at last not waited for.
_CANCEL_AGAIN_S = 1.0
_FURTHER_CANCELS = 3
_STILL_READY_S = 1.0  # longest wait after a countdown, for vehicles that were ready before it

# Expected reasons for the end of a mission. Any other exception is a mistake of the mission's
# author, and is shown with its trace.
_FAILURES = (
    OrderFailed,
    MissionFailed,
    FaultRefused,
    WindTooStrong,
    ConfigError,
    ConditionTimeout,
    CountdownEnded,
)


class _NotBegun(RuntimeError):
    """A mission cannot begin with the fleet in its present state."""


class _EarlierStops(NamedTuple):
    """Orders to land, to hold or to kill from before a mission waited for its vehicles."""

    of_persons: int  # number of those given at this ground
    until_ns: int  # when the mission began to wait, on the ground's clock


class _EarlyEnd(NamedTuple):
    """The end of a mission whose last step was not done, and its consequences."""

    failure: str  # the reason, as a sentence
    words: str  # what the mission says
    # what it orders then; None: nothing
    reaction: Callable[[], Coroutine[Any, Any, None]] | None = None
    is_nobody_heard: bool = False
    is_wrong_input: bool = False
    is_left_flying: bool = False
    pilots: tuple[str, ...] = ()  # vehicles that are flown by hand


class MissionRun:
    """One flight of a mission.

    Args:
        mission: mission file, loaded and checked.
        client: fleet client that has been started.
        say: function that receives each line of progress.
        ready_timeout_s: longest wait for the vehicles before the first step [s].
        stays: whether this process keeps running after somebody has taken the fleet from the
            mission, until the fleet is down.
        longest_stay_s: longest time for which it does; None: no limit.
        at: wall-clock time at which it begins; None: when the vehicles are ready.
    """

    def __init__(
        self,
        mission: Mission,
        client: FleetClient,
        *,
        say: Callable[[str], None] = lambda line: None,
        ready_timeout_s: float = 60.0,
        stays: bool = False,
        longest_stay_s: float | None = None,
        at: WallTime | None = None,
    ) -> None:
        self.mission = mission
        self.client = client
        self.fleet = Fleet(client, say=say)

        self._ready_timeout_s = ready_timeout_s
        self._task: asyncio.Task[Any] | None = None  # flies the steps
        self._is_stopped = False  # whether the steps were ended from outside
        self._steps_end = asyncio.Event()  # set when they are over, or not waited for any more
        self._reaction: asyncio.Task[None] | None = None  # does what the mission declares
        self._stays = stays
        self._longest_stay_s = longest_stay_s
        self._at = at
        self._staying: asyncio.Task[None] | None = None  # waits until a taken fleet is down
        self._abort_reason: str | None = None  # sentence of whoever called `abort`
        # whether the mission's [on_failure] is carried out after that abort
        self._runs_on_failure = False
        self._can_land = True  # whether vehicles can still be reached after that abort
        self._is_over = False

        now_ns = client.now_ns()
        self._observations = FlightObservations(
            mission=mission.name,
            fleet=mission.fleet,
            state=client.state,
            steps=self.fleet.steps,
            arrivals=self.fleet.arrivals,
            begin_ns=now_ns,
            end_ns=now_ns,
        )

    async def run(self) -> Verdict:
        """Fly the mission.

        The cancellation of this coroutine is an interruption: all vehicles land, then it returns.

        Returns:
            The verdict by the live state. A verdict by the record needs the result of
                :meth:`flown`.
        """
        # not before: a mission that is not flown changes no formation of the one that flies
        self.client.fleet = with_shapes(self.client.fleet_file, self.mission.shapes)
        task = asyncio.create_task(self._fly_steps())
        task.add_done_callback(self._note_steps_end)
        self._task = task
        # somebody may have stopped the mission before this call
        if self._observations.is_interrupted or self._abort_reason is not None:
            self._stop_steps()

        try:
            await self._steps_end.wait()
        except asyncio.CancelledError:
            self.interrupt()
            await self._steps_end.wait()
        self.fleet.ground.is_closed = True  # a Python mission may have tasks that go on
        # Before the mission itself lands vehicles: which of them no longer fly?
        self.fleet.ground.note_other_ends()
        await self._bring_down(task)
        self._note_later_pilots()

        # The replies to orders are never lost, but telemetry may be. The next telemetry shows the
        # result of the last step.
        await self.client.wait_for(self._is_at_rest, LAST_TELEMETRY_S)
        self._observations.end_ns = self.client.now_ns()
        self._is_over = True
        return judge(self.flown(), self.mission.expect)

    def _note_steps_end(self, task: asyncio.Task[Any]) -> None:
        """Note that the steps have ended, also with an error of steps that were stopped.

        Asyncio prints an error that nobody has asked for.
        """
        if not task.cancelled():
            task.exception()
        self._steps_end.set()

    @property
    def is_over(self) -> bool:
        """Whether the steps and the landing after them have ended."""
        return self._is_over

    def interrupt(self) -> None:
        """Stop the mission and land all vehicles; :meth:`run` returns when they are down."""
        if self._observations.is_interrupted:
            return

        self._observations.is_interrupted = True
        self._stop_steps()
        for task in (self._staying, self._reaction):
            if task is not None:
                task.cancel()

    def abort(self, reason: str, *, can_land: bool = True) -> None:
        """End the mission as failed, for a reason outside its steps.

        Args:
            reason: a sentence, which the caller has published as an event.
            can_land: whether vehicles can still be reached.
        """
        if self._abort_reason is not None or self._observations.is_interrupted:
            return

        self._abort_reason = reason
        self._can_land = can_land
        self._stop_steps()
        if self._staying is not None:
            self._staying.cancel()

    def _stop_steps(self) -> None:
        """End the steps, if they are under way; they start and move nobody any more."""
        is_under_way = self._task is not None and not self._task.done()
        if is_under_way and not self._is_stopped:
            self._is_stopped = True
            self.fleet.ground.is_closed = True
            self._cancel_steps(_FURTHER_CANCELS)

    def _cancel_steps(self, further_cancels: int) -> None:
        """Cancel the steps, and again later if they have caught it; at last go on without them."""
        if self._task is None or self._task.done():
            return

        self._task.cancel()
        if further_cancels:
            loop = asyncio.get_running_loop()
            loop.call_later(_CANCEL_AGAIN_S, self._cancel_steps, further_cancels - 1)
        else:
            self.fleet.say("The mission catches its own end ('except:'), and is not waited for.")
            self._steps_end.set()

    def check(self) -> bool:
        """End the mission if somebody has taken the fleet or a vehicle, or a vehicle is silent.

        Call it several times a second.

        Returns:
            Whether the mission has ended, so that no further call is necessary.
        """
        watch = self.fleet.ground.watch
        if not watch.has_begun:
            watch.note_earlier_orders()
            return self.abort_if_silent()
        if watch.taken is not None:
            self._stop_steps()  # a Python mission may have caught FleetTaken
            self.client.notice_own_stall()
            return False

        if watch.takeover() is not None:
            self._stop_steps()
            return False

        self._look_for_pilots()
        return self._abort_reason is not None or self.abort_if_silent()

    def _look_for_pilots(self) -> None:
        """Go on without vehicles that pilots fly by hand, or end the mission, as it declares."""
        names = self.fleet.names
        by_hand = [name for name in flown_by_hand(self.client) if name in names]
        if not by_hand:
            return

        if self.fleet.ground.goes_on_without and len(by_hand) < len(names):
            self.fleet.ground.leave_out(*by_hand)
            return
        reason = pilot_words(by_hand)
        self.client.publish_event("critical", "flown-by-hand", f"{reason} The mission ends.")
        self._runs_on_failure = True
        self.abort(reason)

    def abort_if_silent(self) -> bool:
        """End the mission when a vehicle whose last telemetry was armed is silent for SILENT_S.

        If the mission declares so, it goes on without the vehicle. It also goes on if it has
        reacted to the vehicle's failure.

        Call it several times a second. After a stall of this ground itself, the vehicles get
        AFTER_STALL_S. If no vehicle is heard, this ground's own link is lost. Then the mission
        waits until the agents land by themselves.

        Returns:
            Whether the mission has ended because of a silence.
        """
        self.client.notice_own_stall()
        link = self.fleet.ground.link
        link.update()
        if link.is_lost:
            if link.landing_in_s > 0.0:
                return False
            limit_s = self.client.fleet.fleet.ground_lost_land_s
            reason = (
                f"This ground has heard no vehicle for {limit_s:g} s: {link.cause}. The agents "
                "land by themselves."
            )
            self.client.publish_event("critical", "own_link_lost", reason)
            self.abort(reason)
            return True

        ground = self.fleet.ground
        known = ground.left_out | ground.still_lost()
        silent = [name for name in silent_in_flight(self.client) if name not in known]
        if not silent or link.is_settling:
            return False

        reason = (
            f"Nothing heard from {', '.join(silent)} for {SILENT_S:g} s in flight: "
            "the agent hangs or is cut off."
        )
        self.client.publish_event("critical", "agent_silent", reason)
        if ground.goes_on_without and not set(self.fleet.names).issubset(silent):
            ground.leave_out_silent(silent, reason)
            return False
        self._runs_on_failure = True
        self.abort(reason)
        return True

    def flown(self) -> FlightObservations:
        """Return what was observed of the flight so far."""
        self._observations.state = self.client.state
        self._observations.left_out = self.fleet.ground.left_out_in_service
        self._observations.other_ends = self.fleet.ground.other_ends
        self._observations.left_out_orders = self.fleet.ground.left_out_orders
        return self._observations

    async def _fly_steps(self) -> None:
        """Wait for the vehicles, and fly the steps or the function of the mission."""
        stops = _EarlierStops(self.client.persons_stops, self.client.now_ns())
        await self.client.wait_for(self._is_heard, LAST_TELEMETRY_S)
        self.fleet.ground.leave_out_disabled()
        self.fleet.say(f"Waiting for {listed(self.fleet.names)} to be ready.")
        await self._wait(self.fleet.ready(self._ready_timeout_s), stops)

        times = self._step_times()
        self._refuse_flying()
        if self._at is not None:
            await self._wait(self.fleet.countdown(self._at), stops)
            await self._wait(self._still_ready(), stops)
            self._refuse_flying()

        self.client.forget_earlier_flights()
        self.client.forget_formation()
        self._observations.earlier_touchdowns = self.client.state.touchdowns
        self._observations.earlier_collided = collided_vehicles(self.client.state)
        self._observations.begin_ns = self.client.now_ns()
        self.fleet.ground.watch.begin()
        advised = advice_of(
            self.client.state, self.fleet.names, is_recording=self.client.is_recording
        )
        for advice, names in advised.items():
            self.fleet.say(f"Preflight, {', '.join(names)}: {advice}")

        self.fleet.ground.goes_on_without = self.mission.on_failure.do == "go_on"
        if self.mission.is_python:
            await self._fly_function()
            return

        steps = StepRunner(self.mission, self.fleet, times)
        try:
            await steps.rehearse_faults()
        except FaultRefused:
            self._observations.is_wrong_input = True
            raise
        await steps.run()

    async def _fly_function(self) -> None:
        """Fly the function of a Python mission.

        Raises:
            MissionFailed: it has called ``sys.exit``, or has left out an ``await``.
        """
        with left_out_awaits() as left_out:
            try:
                await load_function(self.mission)(self.fleet)
            except SystemExit as error:  # would end this process, and leave the fleet in the air
                raise MissionFailed(f"The mission called sys.exit({error.code!r}).") from None
            except Exception:
                for sentence in left_out:  # may be the reason
                    self.fleet.say(sentence)
                raise
        if left_out:
            raise MissionFailed(" ".join(left_out))

    async def _wait(self, wait: Coroutine[Any, Any, None], stops: _EarlierStops) -> None:
        """Wait before the first step, until a person stops vehicles.

        Raises:
            _NotBegun: a person has ordered that.
            NotReady: another ground operates the fleet during a countdown.
        """
        waiting = asyncio.create_task(wait)
        try:
            while not waiting.done():
                self._refuse_stopped(stops)
                refusal = self.client.control.refusal("takeoff")
                if refusal is not None and self.fleet.ground.countdown is not None:
                    raise NotReady(refusal, is_anybody_heard=True)
                await asyncio.wait({waiting}, timeout=_LOOK_S)
            self._refuse_stopped(stops)
            await waiting
        finally:
            waiting.cancel()

    def _refuse_stopped(self, earlier: _EarlierStops) -> None:
        """Refuse to begin when a person has stopped vehicles while the mission waited.

        Vehicles on the ground refuse to land and to hold, so they do not report such an order. It
        counts when it was given at this ground, or when they have said that they refuse it.

        Args:
            earlier: orders to stop that do not count.

        Raises:
            _NotBegun: a person has ordered that.
        """
        watch = self.fleet.ground.watch
        stopped = watch.kill_before_begin(self.fleet.names)
        if not stopped:
            stopped = answered_stop(
                self.client.state, self.fleet.names, earlier.until_ns, self.client.is_own
            )
        if (
            not stopped
            and self.client.has_person
            and self.client.persons_stops > earlier.of_persons
        ):
            stopped = f"{self.client.author} has ordered to land, to hold or to kill here"
        if stopped:
            raise _NotBegun(
                f"{self.mission.path} was not begun: {stopped} while it waited. "
                "Look at the vehicles, then start the mission again."
            )

    async def _still_ready(self) -> None:
        """Wait after a countdown until every vehicle says anew that it may fly.

        Older telemetry does not count: its agent may have died, or have been taken out of service,
        in the last second of the countdown.

        Raises:
            NotReady: a vehicle is no longer ready.
        """
        end_ns = self.client.now_ns()

        def are_heard_anew(state: FleetState) -> bool:
            self.fleet.ground.leave_out_disabled()
            return all(state.vehicles[name].received_ns >= end_ns for name in self.fleet.names)

        # whoever is not heard within this time is not ready: its telemetry is stale by then
        await self.client.wait_for(are_heard_anew, _STILL_READY_S)
        await self.fleet.ready(_STILL_READY_S)

    def _refuse_flying(self) -> None:
        """Refuse to begin a mission that begins on the ground while its vehicles fly.

        Raises:
            _NotBegun: a vehicle flies.
        """
        refusal = begin_refusal(self.mission, self.client.state)
        if refusal:
            raise _NotBegun(refusal)

    def _step_times(self) -> dict[str, WallTime]:
        """Return the times at which steps start; none in simulated time.

        Raises:
            _NotBegun: a time is not valid, or the mission would come too late to a step.
        """
        if self.client.wall_clock.is_simulated:
            return {}

        wall_ns = self.client.wall_clock.wall_ns
        try:
            times = step_times(self.mission, local_now(wall_ns))
        except ConfigError as error:
            raise _NotBegun(str(error)) from None

        begin_ns = wall_ns
        if self._at is not None:
            begin_ns = self._at.wall_ns
        if times:
            refusal = time_refusal(self.mission, times, begin_ns)
            if refusal:
                raise _NotBegun(refusal)
        return times

    async def _bring_down(self, task: asyncio.Task[Any]) -> None:
        """Land the vehicles or do what the mission declares, unless the last step was done.

        Vehicles that the mission has gone on without are landed also after its last step, and so
        are silent ones to whose failure it has reacted.
        """
        error = None
        if not self._is_stopped and not task.cancelled():
            error = task.exception()
            if error is None:
                if self.fleet.ground.watch.takeover() is None:
                    await self._react(self._land_left_out())
                return

        if await self._leave_if_taken():
            return

        if error is not None:
            await self._end_early(self._end_by_error(error))
        elif self._abort_reason is not None:
            await self._end_early(self._end_by_abort(self._abort_reason))
        else:
            self._observations.is_interrupted = True
            await self._land_interrupted()

        await self._leave_if_taken()  # somebody may have taken it meanwhile

    async def _land_left_out(self) -> None:
        """Land the vehicles that the mission has gone on without, or lost and does not hear."""
        ground = self.fleet.ground
        silent = ground.still_lost().intersection(silent_in_flight(self.client))
        left_out = ground.left_out_in_service | silent
        if left_out:
            await self.fleet.land_all(LAND_TIMEOUT_S, names=sorted(left_out))

    def _end_by_error(self, error: BaseException) -> _EarlyEnd:
        """Return what an exception that has ended the steps means.

        What the mission declares for a failure is done only if it has begun at all.
        """
        error = _cause(error)
        if isinstance(error, NotReady):
            sentence = str(error)
            return _EarlyEnd(sentence, sentence, is_nobody_heard=not error.is_anybody_heard)
        if isinstance(error, _NotBegun):
            sentence = str(error)
            return _EarlyEnd(sentence, sentence, is_wrong_input=True, is_left_flying=True)

        by_hand: tuple[str, ...] = ()
        if isinstance(error, OrderFailed):
            by_hand = tuple(flown_by_hand(self.client))
        failure = self._failure_of(error, by_hand)
        words = f"The mission ends here: {failure}"

        is_refusal = isinstance(error, OrderFailed | CountdownEnded)
        if is_refusal and not self.fleet.ground.has_begun:
            # All vehicles have refused the first order, or it was not given. The fleet has not
            # changed.
            return _EarlyEnd(failure, words, is_left_flying=True, pilots=by_hand)
        return _EarlyEnd(failure, words, reaction=self._on_failure, pilots=by_hand)

    def _end_by_abort(self, reason: str) -> _EarlyEnd:
        """Return what an end from outside means.

        Args:
            reason: sentence of whoever called `abort`; already published as an event.
        """
        words = "The mission ends here."
        if not self.fleet.ground.watch.has_begun:  # it has ordered nothing, and lands nobody
            return _EarlyEnd(reason, words, is_left_flying=True)
        if self._runs_on_failure:
            by_hand = tuple(flown_by_hand(self.client))
            return _EarlyEnd(reason, words, reaction=self._on_failure, pilots=by_hand)
        if self._can_land:
            return _EarlyEnd(reason, words, reaction=self._land_all)
        return _EarlyEnd(reason, words)

    async def _end_early(self, end: _EarlyEnd) -> None:
        """Note and say how the mission ends, and do what it leads to."""
        self._observations.failure = end.failure
        self._observations.is_nobody_heard = end.is_nobody_heard
        if end.is_wrong_input:  # a fault that was refused before the first step has set it already
            self._observations.is_wrong_input = True
        self._observations.is_left_flying = end.is_left_flying
        self._observations.pilots = end.pilots

        self.fleet.say(end.words)
        if end.reaction is not None:
            await self._react(end.reaction())

    def _note_later_pilots(self) -> None:
        """Add vehicles that pilots took just after the first one, and that telemetry shows now."""
        first_by_hand = list(self._observations.pilots)
        if not first_by_hand:
            return

        by_hand = sorted({*first_by_hand, *flown_by_hand(self.client)})
        if self._observations.failure == pilot_words(first_by_hand):
            self._observations.failure = pilot_words(by_hand)
        self._observations.pilots = tuple(by_hand)

    def _failure_of(self, error: BaseException, by_hand: Sequence[str]) -> str:
        """Return what ended the steps, in words; for a mistake of the author, its line.

        Args:
            error: the exception that ended them.
            by_hand: vehicles that are flown by hand.
        """
        if isinstance(error, OrderFailed):
            for name in by_hand:
                has_failed = name in error.results and not error.results[name].is_done
                if has_failed and name not in self.fleet.ground.left_out:
                    return pilot_words(by_hand)
        if isinstance(error, ConfigError):  # such as a value that makes no sense
            return _with_line(str(error), error, self.mission.path)
        if isinstance(error, _FAILURES):
            return str(error)
        return _mistake(error, self.mission.path)

    async def _leave_if_taken(self) -> bool:
        """Leave the fleet to whoever has taken it from the mission; return whether one has.

        An interruption lands all vehicles nevertheless.
        """
        watch = self.fleet.ground.watch
        taken = watch.takeover() if watch.has_begun else None
        if taken is None or self._observations.is_interrupted:
            return False
        await self._leave_to(taken)
        return True

    async def _leave_to(self, taken: Taken) -> None:
        """Leave the fleet to whoever has taken it.

        If `stays` is set, wait until the fleet is down, or for the longest stay; else until those
        that land are down. An interruption lands all vehicles.
        """
        self._observations.failure = taken.sentence
        self._observations.is_left_flying = True
        self._observations.is_taken = True
        self._staying = asyncio.create_task(self._stay(taken))
        try:
            _, waiting = await asyncio.wait({self._staying}, timeout=self._longest_stay_s)
        except asyncio.CancelledError:
            self.interrupt()
        if self._observations.is_interrupted:
            await self._land_interrupted()
        elif waiting:
            self._staying.cancel()
            self.fleet.say(
                f"{taken.by} has had the fleet for {self._longest_stay_s:g} s, and is not waited"
                " for any longer."
            )

    async def _stay(self, taken: Taken) -> None:
        """Say who has taken the fleet, and wait for its vehicles; nothing is ordered."""
        taken = await self.fleet.ground.watch.whole_takeover(taken)
        self._observations.failure = taken.sentence
        self.client.publish_event("warning", "fleet-taken", taken.sentence)
        self.fleet.say(f"The mission ends here: {taken.sentence}")
        if self._stays:
            await stay(self.client, taken, self._observations.begin_ns, self.fleet.say)
        else:
            await wait_for_landings(self.client, LAND_TIMEOUT_S)

    async def _land_all(self) -> None:
        await self.fleet.land_all(LAND_TIMEOUT_S)

    async def _react(self, reaction: Coroutine[Any, Any, None]) -> None:
        """Do what the mission declares, or land all; an interruption lands all at once.

        Args:
            reaction: what is done.
        """
        self._reaction = asyncio.create_task(reaction)
        try:
            await asyncio.wait({self._reaction})
        except asyncio.CancelledError:
            self.interrupt()
        if self._observations.is_interrupted:
            await self._land_interrupted()
        else:
            self._reaction.result()  # raises what it has raised

    async def _land_interrupted(self) -> None:
        self.fleet.say("Interrupted: all flying vehicles land.")
        await self.fleet.land_all(LAND_TIMEOUT_S, is_by_person=True)

    async def _on_failure(self) -> None:
        """Do what the mission declares for a step that fails."""
        await self.fleet.ground.link.wait_while_lost()
        if self.fleet.ground.watch.takeover() is not None:
            return
        if self.mission.on_failure.do == "hold":
            await self.client.order("hold all", _HOLD_TIMEOUT_S, is_by_mission=True)
            return

        names = None  # all
        if self.mission.on_failure.do == "home":
            watch = self.fleet.ground.watch
            flown = self.fleet.names
            ordered = await fly_home_unless_taken(self.client, flown, watch, say=self.fleet.say)
            if ordered is None:
                return
            if ordered:
                names = [name for name in flown if name not in ordered]
        await self.fleet.land_all(LAND_TIMEOUT_S, names=names)

    def _is_heard(self, state: FleetState) -> bool:
        return all(state.vehicles[name].telemetry is not None for name in self.fleet.names)

    def _is_at_rest(self, state: FleetState) -> bool:
        return all(
            state.is_landed(name) or state.vehicles[name].is_airborne for name in self.fleet.names
        )


def _cause(error: BaseException) -> BaseException:
    """Return what has ended the steps, out of the group in which tasks of a mission have raised it.

    Several exceptions stay a group if one of them is a mistake of the mission's author.
    """
    if not isinstance(error, BaseExceptionGroup):
        return error
    if len(error.exceptions) == 1:
        return _cause(error.exceptions[0])

    _, mistakes = error.split(_FAILURES)
    if mistakes is not None:
        return error
    return first_failure(error)


def _mistake(error: BaseException, path: str) -> str:
    """Return a mistake of a mission's author in words.

    Args:
        error: the exception that the mission has raised.
        path: path of the mission's file.

    Returns:
        The exception with the last line of the file that led to it; or, if it does not come from
        the file itself, its whole trace.
    """
    if not _lines(error, path) or isinstance(error, BaseExceptionGroup):  # with several causes
        return "".join(traceback.format_exception(error)).strip()

    what = "".join(traceback.format_exception_only(error)).strip()
    return _with_line(what, error, path)


def _with_line(words: str, error: BaseException, path: str) -> str:
    """Return words about an exception after the last line of a file that led to it, if one did."""
    lines = _lines(error, path)
    if not lines:
        return words
    return f"{path}, line {lines[-1]}: {words}"


def _lines(error: BaseException, path: str) -> list[int | None]:
    """Return the lines of a file that led to an exception, the last one at the end."""
    file = Path(path).resolve()
    frames = traceback.extract_tb(error.__traceback__)
    return [frame.lineno for frame in frames if Path(frame.filename).resolve() == file]
