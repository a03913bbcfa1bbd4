"""The ground of one flight, as its mission uses it.

A mission gives every order through :class:`MissionGround`. Before an order is sent, the ground
waits for an operator who flies the mission step by step, for the end of a pause, and for its own
link. Once somebody else has taken the fleet, the ground sends no more orders. After each order it
keeps the results for the verdict.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import functools
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set

from msgspec.structs import replace

from groundstation.client.client import FleetClient
from groundstation.fleet.slot_owners import out_of_service, stand_ins
from groundstation.fleet.state import FleetState
from groundstation.mission_files.wall_time import WallTime, time_words
from groundstation.missions.countdown import Countdown, CountdownEnded, clock_words, count_down
from groundstation.missions.follow_pause import FollowPause
from groundstation.missions.hover_check import hover_check
from groundstation.missions.own_link import OwnLink
from groundstation.missions.taken import FleetTaken, FleetWatch
from groundstation.orders.intents import Intent, Kill, Takeoff, for_fewer
from groundstation.orders.obstruction import explained
from groundstation.orders.plan import PlannedOrder, occupied_goals, with_checked_values
from groundstation.orders.result import OrderFailed, OrderResult, Results, VehicleResult
from groundstation.verdict.observations import Arrival, StepResult, arrival_of
from groundstation.verdict.other_ends import LastOrder, last_order, other_ends
from onboard.bus.schema import Order
from onboard.config.fleet import ConfigError
from onboard.plain_text import MAX_NAMES, listed
from onboard.tuples import Xyz

_LOOK_S = 0.2  # period of the checks for the end of a pause
_HEARD_S = 0.5  # age of telemetry up to which a vehicle counts as heard
_MAX_CHARACTERS = 240  # of the line that shows an order
_UNDER_WAY = ("accepted", "direct", "cancelled")  # phases in which a vehicle carries out an order
_SILENCE_S = 0.7  # longest wait for telemetry before this ground checks its own link


class MissionGround:
    """Gives a mission's orders and keeps their results.

    Args:
        client: fleet client that has been started.
        say: function that receives each line of progress.
    """

    def __init__(
        self, client: FleetClient, *, say: Callable[[str], None] = lambda line: None
    ) -> None:
        self.client = client
        self.say = say
        self.link = OwnLink(client)
        self.watch = FleetWatch(client)

        self.has_begun = False  # whether a vehicle has accepted an order of this mission
        # Whether the steps have ended, or were told to: from then on no order of theirs starts or
        # moves a vehicle.
        self.is_closed = False
        self.is_ending = False  # whether the end of a script's connection has begun
        self._has_ended = asyncio.Event()  # set when that end is over
        self.steps: list[StepResult] = []
        self.arrivals: list[Arrival] = []

        # Whether the mission continues with the other vehicles when a vehicle fails.
        self.goes_on_without = False
        self.left_out: set[str] = set()  # failed vehicles, without which the mission continues
        # vehicles in left_out that were taken out of service, and had not failed before
        self.disabled: set[str] = set()
        self.lost: set[str] = set()  # vehicles to whose failure the mission has reacted
        # Sentence of each vehicle that does not fly although its last order left it flying.
        self.other_ends: dict[str, str] = {}
        self._last_orders: dict[str, LastOrder] = {}

        # Countdowns to starts at wall-clock times; parallel steps may have one each.
        self._countdowns: list[Countdown] = []
        self.pause_line = ""  # short text about a pause of paths; empty without one
        self.follow_pauses: list[FollowPause] = []  # one for each group that follows a vehicle now

        # Step by step: each order waits for the operator, one after the other.
        self._is_stepping = False
        self._is_pause_ordered = False  # from `pause` until the operator lets an order begin
        self._turn = asyncio.Lock()  # held by the order that waits
        self._next = asyncio.Event()  # set by `go_on` and `leave_out_order`
        self._waiting: Intent | None = None  # the order that waits
        self._may_leave_out = False  # whether the order that waits may be left out
        self._is_left_out = False  # whether the order that has waited is left out
        self.left_out_orders: list[str] = []  # orders that the operator has left out, in words

    async def order(
        self,
        intent: Intent,
        timeout_s: float,
        *,
        change: Callable[[PlannedOrder], PlannedOrder] | None = None,
        may_be_left_out: bool = True,
    ) -> Results:
        """Give an order, wait for its end and log the results.

        A cancellation ends the wait only: the order stays in force.

        Args:
            intent: the order.
            timeout_s: longest wait for its end [s].
            change: changes the planned order for single vehicles, after all were checked together.
            may_be_left_out: whether an operator who flies step by step may go on without it, and a
                mission that goes on without failed vehicles without those whose goals are occupied.

        Returns:
            One result per vehicle that still takes part when the order is sent; none when the
            operator has left the order out.

        Raises:
            ConfigError: a value of the order is not valid, no vehicle takes part any more, or the
                script's flight has ended.
            OrderFailed: a vehicle did not do it, and the mission does not go on without it.
            WindTooStrong: a vehicle has taken off, and feels more wind than its limit.
            FleetTaken: somebody has taken the fleet; nothing was sent, or it was replaced.
        """
        await self.check_open(intent)
        intent = self._prepared(intent)
        if isinstance(intent, Takeoff) and len(intent.waves) > 1:
            return await self._take_off_in_waves(intent, timeout_s)

        waited = await self._after_waits(intent, may_be_left_out=may_be_left_out)
        if waited is None:
            return {}
        return await self._sent(waited, timeout_s, change, may_stay=may_be_left_out)

    def _prepared(self, intent: Intent) -> Intent:
        """Return an order with checked values, for those that can still take part.

        Raises:
            ConfigError: a value of the order is not valid, or it is for nobody.
        """
        if not intent.names and self.left_out.issuperset(self.client.fleet.enabled_names):
            raise ConfigError(
                f"'{intent.verb}' is for nobody: all vehicles were disabled, or the mission goes "
                "on without them. Enable one before it."
            )

        # an order to disabled vehicles alone fails by their refusal
        is_for_others = not out_of_service(self.client.state).issuperset(intent.names)
        if not intent.names or is_for_others:
            self.leave_out_disabled()
        return self._without_other_ends(with_checked_values(intent))

    async def _after_waits(self, intent: Intent, *, may_be_left_out: bool) -> Intent | None:
        """Wait until an order may be sent; return it for those that then still take part.

        It is None if the operator has left the order out, or nobody takes part any more.

        Raises:
            FleetTaken: somebody has taken the fleet meanwhile.
        """
        left_out_before = frozenset(self.left_out)
        if intent.waits_for_step:
            is_left_out = await self._wait_for_turn(intent, may_be_left_out)
            if is_left_out:
                self.left_out_orders.append(str(intent))
                self.say(f"Left out: {intent}")
                return None

        is_landing = intent.message_values().then_land
        if intent.waits_for_step and not is_landing:
            await self._wait_for_resume()
        await self.link.wait_while_lost()
        await self.check_open(intent)  # the steps may have ended during a wait
        self.note_other_ends()
        taken = self.watch.takeover()
        if taken is not None:
            raise FleetTaken(taken)

        names = self._taking_part(intent, left_out_before)
        if not names:
            self.say(f"Not sent, because the mission goes on without them: {intent}")
            return None
        return for_fewer(intent, names)

    async def _sent(
        self,
        intent: Intent,
        timeout_s: float,
        change: Callable[[PlannedOrder], PlannedOrder] | None,
        *,
        may_stay: bool,
    ) -> Results:
        """Send an order, wait for its end, and log the results; arguments as for an order.

        Args:
            may_stay: whether vehicles whose goals are occupied may keep their places.
        """
        self.say(order_in_brief(intent, self.client.fleet.enabled_names))
        begin_ns = self.client.now_ns()
        ways_home = self._own_ways_home(intent)
        at_home = [name for name in ways_home if self._lands_at_home(name, ways_home[name])]
        others = tuple(name for name in intent.names if name not in at_home)

        if at_home:
            self.say(f"  at home already: {listed(at_home)}")

        results: Results = {}
        staying: Mapping[str, str] = {}
        if others:
            planned, staying = self._planned(for_fewer(intent, others), may_stay=may_stay)
            results = await self._ended(planned, timeout_s, change)
        # one that has refused may have begun to land after its last telemetry
        refused = [name for name, result in results.items() if result.phase == "refused"]
        at_home += [
            name
            for name in refused
            if name in ways_home and self._lands_at_home(name, ways_home[name])
        ]
        results.update(await self._at_home(ways_home, at_home, timeout_s))

        duration_s = (self.client.now_ns() - begin_ns) * 1e-9
        self._log(step_result(str(intent), duration_s, results), results)
        if any(result.phase != "refused" for result in results.values()):
            self.has_begun = True

        moved = {name: result for name, result in results.items() if name not in staying}
        await self.go_on_or_fail(intent, moved)
        if isinstance(intent, Takeoff):
            await hover_check(lambda: self.client.state, results, self.say)
        return results

    def _planned(self, intent: Intent, *, may_stay: bool) -> tuple[PlannedOrder, Mapping[str, str]]:
        """Plan an order; in a mission that goes on, without the vehicles whose goals are occupied.

        Such a vehicle keeps its place, takes part in the next order, and counts as refused. So does
        one whose goal is too near to the place of another one that stays.

        Args:
            intent: the order.
            may_stay: whether vehicles whose goals are occupied may keep their places.

        Returns:
            The planned order, and the vehicles that keep their places, each with the reason.
        """
        client = self.client
        planned = client.plan(intent)
        is_wrong_for_all = planned.causes.issuperset(intent.names)
        if is_wrong_for_all or not (may_stay and self.goes_on_without and intent.has_goals):
            return planned, {}

        for_all = planned.intent
        staying: dict[str, str] = {}
        while True:
            occupied = occupied_goals(planned, client.fleet, client.state, client.now_ns())
            occupied |= {name: planned.refusals[name] for name in planned.causes}
            staying |= occupied
            moving = tuple(name for name in intent.names if name not in staying)
            if not moving:
                planned = dataclasses.replace(planned, orders={})
            if not occupied or not moving:
                planned = dataclasses.replace(planned, intent=for_all, refusals=staying)
                return planned, staying
            planned = client.plan(for_fewer(intent, moving))

    async def _ended(
        self,
        planned: PlannedOrder,
        timeout_s: float,
        change: Callable[[PlannedOrder], PlannedOrder] | None,
    ) -> Results:
        """Send an order, and return its results at its end; arguments as for an order."""
        client = self.client
        intent = planned.intent
        if change is not None:
            planned = change(planned)

        order = client.send(planned, is_by_mission=True)
        order.add_listener(functools.partial(self._note_progress, order.planned))
        with self.noting_cancellation(str(intent), order):
            ended = await self.end_of(order, timeout_s)
        # adds to each unfinished move what hinders it
        results = explained(ended, order.planned, client.fleet, client.state, client.now_ns())

        for name, message in order.planned.orders.items():
            # The listener has noted the arrival of those that have done it. The others count as
            # late, unless the mission goes on without them.
            if not results[name].is_done and not self.goes_on_without:
                self._add_arrival_at_goal(intent.verb, name, message, is_done=False)
        return results

    def _own_ways_home(self, intent: Intent) -> dict[str, OrderResult]:
        """Return the newest orders of vehicles by which this mission has sent them home already.

        Args:
            intent: the next order; only one that sends vehicles home repeats theirs.
        """
        ways_home: dict[str, OrderResult] = {}
        if not intent.message_values().then_land:
            return ways_home

        for name in intent.names:
            newest = self.client.newest_order(name)
            if newest is None or not newest.is_by_mission:
                continue
            if newest.planned.orders[name].then_land:
                ways_home[name] = newest
        return ways_home

    async def _at_home(
        self, ways_home: Mapping[str, OrderResult], names: Sequence[str], timeout_s: float
    ) -> Results:
        """Wait until vehicles that land at home are down, and return how their ways home end.

        Args:
            ways_home: newest order of each vehicle, to fly home.
            names: the vehicles that land.
            timeout_s: longest wait [s].
        """

        def are_down(_: FleetState) -> bool:
            return all(ways_home[name].results[name].is_final for name in names)

        await self.client.wait_for(are_down, timeout_s)
        return {name: ways_home[name].unfinished_after(timeout_s)[name] for name in names}

    def _lands_at_home(self, name: str, way_home: OrderResult) -> bool:
        """Whether a vehicle lands or has landed at the end of its way home.

        Its agent would refuse to fly home then.

        Args:
            name: the vehicle.
            way_home: its newest order, to fly home.
        """
        result = way_home.results[name]
        if result.phase != "accepted" and not result.is_done:
            return False
        telemetry = self.client.state.telemetry_of(name)
        is_landing = telemetry is not None and telemetry.state == "landing"
        return is_landing or self.client.state.is_landed(name)

    def check_not_ended(self) -> None:
        """Refuse what a script wants of its fleet after the end of its connection.

        Raises:
            ConfigError: the connection has ended.
        """
        if self._has_ended.is_set():
            raise ConfigError(
                "The script's flight has ended, because its connection is closed. Order inside the "
                "block of Fleet.connect or BlockingFleet."
            )

    def begin_end(self) -> None:
        """Note that the end of a script's connection begins, which orders in its place."""
        self.is_ending = True

    def end(self) -> None:
        """Note that a script's connection has ended."""
        self._has_ended.set()

    async def check_not_ending(self) -> None:
        """Refuse an order of a script from the beginning of its connection's end.

        The refusal comes when the end is over. A loop that catches it would otherwise repeat its
        order without a pause, and hold up the end.

        Raises:
            ConfigError: the connection has ended.
        """
        if self.is_ending:
            await self._has_ended.wait()
        self.check_not_ended()

    async def check_open(self, intent: Intent) -> None:
        """Refuse an order of steps that have ended, or of a script whose end has begun.

        To kill stays possible while a script ends.

        Args:
            intent: the order.

        Raises:
            ConfigError: the script's connection has ended.
        """
        self.check_not_ended()
        if not isinstance(intent, Kill):
            await self.check_not_ending()
        if self.is_closed and not intent.brings_down:
            # A Python mission has caught its cancellation, or one of its tasks goes on: it waits
            # here until it is cancelled again.
            await asyncio.get_running_loop().create_future()

    def _without_other_ends(self, intent: Intent) -> Intent:
        """Return an order without vehicles that have come down unnoticed before it was given.

        If nobody else is left, they keep it, so that its results tell why they cannot do it.
        """
        left_out_before = frozenset(self.left_out)
        self.note_other_ends()
        names = self._taking_part(intent, left_out_before)
        if not names:
            return intent
        return for_fewer(intent, names)

    def _taking_part(self, intent: Intent, left_out_before: Set[str]) -> tuple[str, ...]:
        """Return the vehicles of an order without those that were left out since it was given.

        An order that neither starts nor moves vehicles, such as to land or to kill, keeps them all.

        Args:
            intent: an order that is not sent yet.
            left_out_before: vehicles that were left out already when the order was given; if the
                order names them, it is for them, too.
        """
        if not intent.is_start and not intent.has_goals:
            return intent.names
        return self.still_taking_part(intent.names, left_out_before)

    def still_taking_part(self, names: Iterable[str], left_out_before: Set[str]) -> tuple[str, ...]:
        """Return vehicles without those that were left out since a time.

        Args:
            names: names of vehicles.
            left_out_before: vehicles that were left out at that time.
        """
        left_out_since = self.left_out - left_out_before
        return tuple(name for name in names if name not in left_out_since)

    @contextlib.contextmanager
    def counting(self, at: WallTime, names: Sequence[str]) -> Iterator[Countdown]:
        """Begin a countdown, which ends with the block.

        Args:
            at: time of the start.
            names: vehicles whose computers must have the same time.

        Raises:
            CountdownEnded: the time has passed.
        """
        countdown = Countdown(self.client.wall_clock, at, names)
        if countdown.left_s <= 0.0:
            late_s = -countdown.left_s
            raise CountdownEnded(
                f"{at.words} passed {time_words(late_s)} ago: the vehicles came too late to start "
                "then. Give a later time."
            )

        clocks = clock_words(self.client.wall_clock, names)
        self.say(f"Starts at {at.words}, in {time_words(countdown.left_s)}. {clocks}".rstrip())
        self._countdowns.append(countdown)
        try:
            yield countdown
        finally:
            self._countdowns.remove(countdown)

    async def wait_for_time(self, at: WallTime, names: Sequence[str]) -> None:
        """Wait until a wall-clock time.

        Args:
            at: time to go on.
            names: vehicles whose computers must have the same time.

        Raises:
            CountdownEnded: nothing is to be started.
        """
        with self.counting(at, names) as countdown:
            await count_down(countdown, self.say)
            self.say(f"{at.words}. {clock_words(self.client.wall_clock, names)}")

    @property
    def countdown(self) -> Countdown | None:
        """The countdown that ends first; None if there is none."""
        return min(self._countdowns, key=lambda countdown: countdown.left_s, default=None)

    @property
    def is_paused(self) -> bool:
        """Whether an operator pauses the mission or its paths, or an order waits for him."""
        return self._is_pause_ordered or self._waiting is not None or bool(self.pause_line)

    @property
    def live_line(self) -> str:
        """The countdown or the pause in a few words; empty when there is neither."""
        if self.countdown is not None:
            return self.countdown.line
        return self.pause_line

    @property
    def title_line(self) -> str:
        """The live line with the key that ends the countdown or pause, for a console's title."""
        if self.countdown is not None:
            return f"{self.countdown.line} · x stops it"
        if self.pause_line:
            return f"{self.pause_line} · r goes on"
        return ""

    def stop_countdown(self) -> bool:
        """End all countdowns without starting, as an operator orders.

        Returns:
            Whether there was one.
        """
        for countdown in self._countdowns:
            countdown.stop("An operator has stopped the countdown.")
        return bool(self._countdowns)

    async def _take_off_in_waves(self, intent: Takeoff, timeout_s: float) -> Results:
        """Order one wave after the other, until a vehicle of a wave does not fly.

        Vehicles that the mission goes on without do not count, and start in no later wave.

        Raises:
            OrderFailed: a vehicle did not take off, or one of an earlier wave has come down, and
                the mission does not go on without it.
        """
        waves = intent.waves
        left_out_before = frozenset(self.left_out)
        results: Results = {}
        for index, whole_wave in enumerate(waves):
            if index:
                await asyncio.sleep(intent.every_s)

            self.note_other_ends()
            wave = self.still_taking_part(whole_wave, left_out_before)
            if not wave:
                continue
            self.say(f"Wave {index + 1} of {len(waves)}: {listed(wave)}")

            vehicles = self.client.state.vehicles
            not_flying = [
                name
                for name in results
                if name not in self.left_out and not vehicles[name].is_airborne
            ]
            wave_results: Results = {}
            if not not_flying:
                try:
                    wave_results = await self.order(replace(intent, vehicles=wave, by=0), timeout_s)
                except OrderFailed as error:
                    wave_results = error.results
            results.update(wave_results)

            not_flying += [
                name
                for name, result in wave_results.items()
                if name not in self.left_out and not result.is_done
            ]
            if not_flying:
                later = [name for name in intent.names if name not in results]
                if later:
                    failed = ", ".join(not_flying)
                    self.say(f"  {listed(later)} stay on the ground: {failed} failed.")
                for name in later:
                    results[name] = VehicleResult(name, "", "refused", _not_started(not_flying))
                raise OrderFailed(intent, results)
        return results

    def go_on(self, *, is_stepping: bool) -> None:
        """Let the order that waits begin.

        Args:
            is_stepping: whether the next order that starts or moves vehicles waits for this call
                again. Orders that stop vehicles or bring them down never wait.
        """
        self._is_stepping = is_stepping
        self._is_pause_ordered = False
        self._next.set()

    def pause(self) -> None:
        """Let the next order that starts or moves vehicles wait; the present order goes on."""
        self._is_stepping = True
        self._is_pause_ordered = True
        self.say("Paused: the next order to start or to move waits for step, skip or continue.")

    def leave_out_order(self) -> str:
        """Go on without the order that waits; the one after it waits as well.

        Returns:
            Why no order can be left out, as a sentence; empty when one is left out.
        """
        if self._waiting is None and self._is_stepping:
            return "No order waits yet: the present step is still under way."
        if self._waiting is None:
            return "No order of the mission waits. Write pause: then the next one does."
        if not self._may_leave_out:
            return (
                f"'{self._waiting}' brings the vehicles to the first points of their paths: the "
                "step cannot go on without it."
            )
        self._is_left_out = True
        self._is_pause_ordered = False
        self._next.set()
        return ""

    async def _wait_for_turn(self, intent: Intent, may_be_left_out: bool) -> bool:
        """Wait until the operator lets an order begin; return whether he leaves it out.

        Of the orders of parallel steps, the first one waits for the operator, and the others wait
        for their turn, so that each answer is for the order that was shown.
        """
        async with self._turn:
            if not self._is_stepping:
                return False

            self._next.clear()
            self._waiting = intent
            self._may_leave_out = may_be_left_out
            self._is_left_out = False

            self.say(f"Waits before: {intent}")
            try:
                await self._next.wait()
            finally:
                self._waiting = None
            return self._is_left_out

    async def _wait_for_resume(self) -> None:
        """Wait while followers are paused, so that their leader does not fly away from them.

        Not called for orders that stop vehicles or bring them down: these never wait.
        """
        while any(pause.is_paused for pause in self.follow_pauses):
            if self.watch.takeover() is not None:
                return
            await asyncio.sleep(_LOOK_S)

    def leave_out(self, *names: str) -> None:
        """Go on without these vehicles.

        "all" excludes them from now on, and their failures no longer end the mission.

        Args:
            names: names of vehicles. They do what their last order or their failsafe says, and
                land at the mission's end.
        """
        newly_left_out = [name for name in dict.fromkeys(names) if name not in self.left_out]
        if not newly_left_out:
            return

        self.left_out.update(newly_left_out)
        vehicle_by_owner = stand_ins(self.client.state)
        missing = [name for name in newly_left_out if name not in vehicle_by_owner]
        if missing:
            self.say(f"The mission goes on without {', '.join(missing)}.")
        for name in newly_left_out:
            if name in vehicle_by_owner:
                self.say(f"{vehicle_by_owner[name]} flies in the place of {name}.")

    def leave_out_silent(self, names: Iterable[str], reason: str) -> None:
        """Go on without vehicles that are silent in flight, and wait for no end of their orders.

        Args:
            names: names of the vehicles.
            reason: why, in a sentence.
        """
        self.leave_out(*names)
        for name in names:
            newest = self.client.newest_order(name)
            if newest is not None and newest.is_by_mission:
                newest.update(name, "failed", reason)

    def leave_out_disabled(self) -> None:
        """Go on without vehicles that are out of service or swapped, if any vehicle is left."""
        enabled = self.client.fleet.enabled_names
        excluded = out_of_service(self.client.state)
        disabled = [name for name in enabled if name in excluded]
        if len(disabled) < len(enabled):
            self.note_disabled(disabled)

    def note_disabled(self, names: Iterable[str]) -> None:
        """Go on without vehicles that were taken out of service.

        Args:
            names: names of the vehicles. Those that the mission already goes on without have failed
                before, and the verdict counts them as failed.
        """
        newly_disabled = [name for name in names if name not in self.left_out]
        self.disabled.update(newly_disabled)
        self.leave_out(*newly_disabled)

    @property
    def left_out_in_service(self) -> set[str]:
        """Vehicles that the mission went on without while they were in service."""
        return self.left_out - self.disabled

    def note_lost(self, lost: Mapping[str, str]) -> None:
        """Say which vehicles are lost, and why.

        "all" excludes a lost vehicle until it flies again, except in orders to land, disarm, kill
        or locate. Orders to hold exclude it, because a vehicle that lands by itself refuses them.

        Args:
            lost: vehicle -> reason.
        """
        for name, reason in lost.items():
            self.say(f"  {name}: {reason}.")
        self.lost.update(lost)

    def still_lost(self) -> set[str]:
        """Return the vehicles that are lost and do not fly again by order."""
        now_ns = self.client.now_ns()
        for name in tuple(self.lost):
            view = self.client.state.vehicles[name]
            if view.telemetry is None or not view.is_fresh(now_ns):
                continue
            if view.telemetry.state in ("taking off", "flying", "holding"):
                self.lost.discard(name)
        return self.lost

    def without_lost(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return these vehicles without the lost ones.

        If all are lost, all are returned, so that the results of an order tell why they refuse.
        """
        lost = self.still_lost()
        remaining = tuple(name for name in names if name not in lost)
        if not remaining:
            return tuple(names)
        return remaining

    def add_arrival(self, step: str, name: str, goal: Xyz, *, is_done: bool = True) -> None:
        """Note how far a vehicle is from its goal now, and whether its order is done."""
        view = self.client.state.vehicles[name]
        arrival = arrival_of(step, view, goal, self.client.now_ns(), is_done=is_done)
        self.arrivals.append(arrival)

    def _note_progress(self, planned: PlannedOrder, result: VehicleResult) -> None:
        """Note a vehicle's order as its last one, and its distance from the goal when it is done.

        The other vehicles of the same order may need much longer.
        """
        name = result.vehicle
        message = planned.orders[name]
        self.note_done(str(planned.intent), name, message, {name: result})
        if result.is_done:
            self._add_arrival_at_goal(planned.intent.verb, name, message, is_done=True)

    def _add_arrival_at_goal(self, step: str, name: str, message: Order, *, is_done: bool) -> None:
        """Note how far a vehicle is from the goal of its order now, if it has one in the air."""
        goal = message.position_enu_m
        if goal is not None and not message.then_land:
            self.add_arrival(step, name, goal, is_done=is_done)

    def note_done(self, words: str, name: str, message: Order, results: Results) -> None:
        """Note an order as the last one of a vehicle, if the vehicle has done it.

        One that brings the vehicle down counts once it is accepted, even if the wait for its end is
        cancelled: telemetry shows the vehicle on the ground before the order is done.

        Args:
            words: the order in words.
            name: name of the vehicle.
            message: message to the vehicle.
            results: results of the order.
        """
        order = last_order(words, message, self.client.now_ns())
        if order is None:
            return

        result = results[name]
        comes_down = result.phase in _UNDER_WAY and not order.leaves_flying
        if result.is_done or comes_down:
            self._last_orders[name] = order

    @contextlib.contextmanager
    def noting_cancellation(self, words: str, order: OrderResult) -> Iterator[None]:
        """Keep the results of an order that stays in force when the block is cancelled.

        Args:
            words: the order in words.
            order: order that was sent; the block waits for its end.
        """
        begin_ns = self.client.now_ns()
        messages = order.planned.orders

        def note_end(result: VehicleResult) -> None:
            name = result.vehicle
            self.note_done(words, name, messages[name], {name: result})

        try:
            yield
        except asyncio.CancelledError:
            results = order.cancelled()
            for name, message in messages.items():
                self.note_done(words, name, message, results)
            order.add_listener(note_end)
            duration_s = (self.client.now_ns() - begin_ns) * 1e-9
            self.steps.append(step_result(words, duration_s, results))
            self.say("  no longer waited for; the order stays in force until a new one")
            self.has_begun = True
            raise

    def note_other_ends(self) -> None:
        """Note and say which vehicles do not fly although their last order left them flying."""
        for name, sentence in other_ends(self._last_orders, self.client.state).items():
            del self._last_orders[name]
            self.other_ends[name] = sentence
            self.say(sentence)
            if self.goes_on_without:
                self.leave_out(name)

    async def end_of(self, order: OrderResult, timeout_s: float) -> Results:
        """Wait for the end of an order; time without this ground's own link does not count.

        An order that was sent into the silence is sent again when the link is back.

        Args:
            order: order that was sent.
            timeout_s: longest wait [s].

        Returns:
            One result per vehicle.
        """
        # Each round waits for the end of the order, or for the time that a lost link has taken.
        wait_s = timeout_s
        while True:
            lost_before_s = self.link.lost_s
            results = await order.wait(wait_s)
            if any(result.phase == "no answer" for result in order.results.values()):
                # A lost link shows only when the last telemetry of all is stale.
                await self.client.wait_for(self._hears_somebody, _SILENCE_S)
            is_back = await self.link.wait_while_lost()
            # The time without a link did not count, so wait for exactly that time once more.
            wait_s = self.link.lost_s - lost_before_s

            was_lost = is_back or wait_s > 0.0
            if was_lost and not self.link.is_lost and self._send_again(order):
                wait_s = timeout_s
                continue
            if order.is_final:
                return dict(order.results)
            if wait_s <= 0.0:
                return results

    def _hears_somebody(self, state: FleetState) -> bool:
        now_ns = self.client.now_ns()
        return any(view.age_s(now_ns) < _HEARD_S for view in state.vehicles.values())

    def _send_again(self, order: OrderResult) -> bool:
        """Send an order again to vehicles that did not answer; return whether it was sent.

        The order is not sent again if the script ends, or somebody has taken the fleet while the
        link was lost.
        """
        names = [name for name, result in order.results.items() if result.phase == "no answer"]
        if not names or self.is_ending or self.watch.takeover() is not None:
            return False

        self.say(f"  The link is back: sent again to {', '.join(names)}.")
        self.client.send_again(order, names)
        return True

    def _log(self, step: StepResult, results: Results) -> None:
        """Keep the result of an order, and say it."""
        self.steps.append(step)
        if step.is_done:
            self.say(f"  done in {step.duration_s:.1f} s{self._closest_words()}")

        for result in results.values():
            if not result.is_done:
                self.say(f"  {result.words}")

    async def go_on_or_fail(self, intent: Intent, results: Results) -> None:
        """Leave out the vehicles that failed, or fail the order when no vehicle would be left.

        Args:
            intent: the order.
            results: results of the order, one per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it, and the mission does not go on without it.
            FleetTaken: somebody has taken the fleet, and that is why.
        """
        taken = await self.watch.after_failure(results)
        if taken is not None:
            raise FleetTaken(taken)

        failed = [
            name
            for name, result in results.items()
            if not result.is_done and name not in self.left_out
        ]
        if not failed:
            return

        remaining = set(self.client.fleet.enabled_names) - self.left_out - set(failed)
        if self.goes_on_without and remaining:
            self.leave_out(*failed)
            return

        taken = self.watch.taken_by_person({name: results[name] for name in failed})
        if taken is not None:
            raise FleetTaken(taken)
        raise OrderFailed(intent, results)

    def _closest_words(self) -> str:
        pair = self.client.state.smallest_known
        if pair is None:
            return ""
        return f"; smallest distance so far {pair.distance_m:.2f} m ({pair.first}, {pair.second})"


def order_in_brief(intent: Intent, enabled_names: Sequence[str]) -> str:
    """Return an order in words that fit a few lines of a terminal, also for a large fleet.

    Args:
        intent: the order.
        enabled_names: all vehicles of the fleet, of which many together are called "all".
    """
    words = str(intent)
    if len(enabled_names) > MAX_NAMES:
        words = words.replace(",".join(enabled_names), "all")
    return textwrap.shorten(words, _MAX_CHARACTERS, placeholder=" ...")


def _not_started(not_flying: Sequence[str]) -> str:
    """Return why a vehicle of a later wave stays on the ground."""
    flies = "does not fly" if len(not_flying) == 1 else "do not fly"
    return f"It stays on the ground, because {', '.join(not_flying)} of a wave before it {flies}."


def step_result(step: str, duration_s: float, results: Results) -> StepResult:
    """Return the results of an order as the verdict keeps them.

    Args:
        step: the order in words.
        duration_s: duration of the order [s].
        results: one per vehicle.
    """
    return StepResult(
        step=step,
        duration_s=round(duration_s, 2),
        vehicles={name: result.phase for name, result in results.items()},
        sentences={name: result.reason for name, result in results.items()},
    )
