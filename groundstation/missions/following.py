"""Vehicles that follow another vehicle at an offset.

Each follower gets a new goal twice a second: the position that the leader will have in a second,
plus the follower's offset. The goals of all followers are one order, which is checked as a whole.
During a pause no goals are sent. The duration includes neither pauses nor the time in which this
ground hears no vehicle.

A vehicle may cease to follow before the end: by an order to skip the rest, by another order of the
mission or of a person here, or because the mission goes on without it. If a failsafe stops it, or
its goals are refused, it has failed.

The followers also hold when their leader lands, or the mission goes on without it. If a failsafe
brings the leader down, or nobody hears where it is, the leader has failed.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.missions.follow_pause import ORDERED, FollowPause
from groundstation.missions.ground import MissionGround, step_result
from groundstation.missions.taken import FleetTaken
from groundstation.orders.intents import Goto, Hold
from groundstation.orders.result import OrderFailed, OrderResult, Phase, Results, VehicleResult
from groundstation.paths.checks import LOWEST_M
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.config.ground import least_height_m, touchable_ground_at_m
from onboard.plain_text import listed
from onboard.tuples import Xyz

_PERIOD_S = 0.5
# A goal is where the leader will be after this time, because a vehicle needs about that long to set
# out for a new goal.
_GOAL_LEAD_S = 1.0
_MOVED_M = 0.1  # a goal that has moved less is not ordered again
_REFUSED_S = 5.0  # longest time for which all goals of a vehicle may be refused
_REFUSED_AT_END_S = 1.5  # longest such time just before the end
_HEARD_S = 1.0  # longest wait for the leader's telemetry after this ground's link is back
_INSIDE_M = 0.1  # smallest distance of goals from the fence
_HOLD_S = 15.0  # longest wait for the hold at the end


async def follow(
    ground: MissionGround, leader: str, offsets: Mapping[str, Xyz], duration_s: float
) -> Results:
    """Have vehicles follow another one for a time; then they hold, even when this is cancelled.

    A vehicle that a failsafe stops, or whose goals are refused for several seconds, follows no
    longer and has failed; the others go on. All hold when the leader lands or fails.

    Args:
        ground: gives the mission's orders and keeps their results.
        leader: the vehicle that is followed.
        offsets: offsets of the followers from the leader [m], ENU.
        duration_s: duration [s].

    Returns:
        The result of the order to hold for each vehicle; of one that has failed, why. Vehicles that
        the mission has given another order or goes on without have none.

    Raises:
        ConfigError: the leader follows itself, or does not report where it is.
        OrderFailed: a vehicle has failed or does not hold, and the mission does not go on without
            it; or all were brought home in a pause.
    """
    client = ground.client
    client.fleet.select([leader])
    if leader in offsets:
        raise ConfigError(f"{leader} cannot follow itself. Leave it out of the followers.")
    if client.state.vehicles[leader].position_enu_m(client.now_ns()) is None:
        raise ConfigError(f"{leader} does not report where it is, so nobody can follow it.")

    ground.say(f"{', '.join(offsets)} follow {leader} for {duration_s:g} s")
    following = _Following(ground, leader, offsets)
    try:
        await following.run(duration_s)
    except BaseException:
        # This exception is what the caller has to know. The ground has said who does not hold.
        with contextlib.suppress(OrderFailed):
            await following.hold()
        raise
    return await following.end()


@dataclass(slots=True)
class _Follower:
    """One vehicle that follows the leader, or has followed it."""

    offset_enu_m: Xyz  # from the leader
    own_order: OrderResult | None  # newest order of this ground before the following, or of it
    is_following: bool = True  # whether it gets goals
    holds_in_the_end: bool = True
    accepted_goal_enu_m: Xyz | None = None  # the last one, unless the next is ordered in any case
    # last time at which it accepted a goal, or was at the right one already; None: never
    accepted_ns: int | None = None
    refusal: VehicleResult | None = None  # of the last goal that it has refused since

    def needs(self, goal_enu_m: Xyz) -> bool:
        """Whether a goal has moved enough to be ordered; the first one always has."""
        if self.accepted_goal_enu_m is None:
            return True
        return math.dist(goal_enu_m, self.accepted_goal_enu_m) > _MOVED_M


class _Following:
    """Vehicles that follow another one, and those of them that have failed.

    Args:
        ground: gives the mission's orders and keeps their results.
        leader: the vehicle that is followed.
        offsets: offsets of the followers from the leader [m], ENU.
    """

    def __init__(self, ground: MissionGround, leader: str, offsets: Mapping[str, Xyz]) -> None:
        self._ground = ground
        self._client = ground.client
        self._leader = leader
        self._followers = {
            name: _Follower(offset_enu_m=offset, own_order=self._client.newest_order(name))
            for name, offset in offsets.items()
        }
        self._failed: Results = {}  # vehicles that follow no longer, though nobody has ordered so
        self._pause = FollowPause(ground, leader, tuple(offsets))
        self._left_out_before = frozenset(ground.left_out)
        self._has_leader_flown = False
        self._begin_ns = self._client.now_ns()

    async def run(self, duration_s: float) -> None:
        """Send goals until the time is over or no vehicle follows any more."""
        end_ns = self._begin_ns + int(duration_s * 1e9)
        self._ground.follow_pauses.append(self._pause)
        try:
            while self._client.now_ns() < end_ns:
                end_ns += await self._wait_while_lost()
                self._pause.update()
                if self._pause.is_paused:
                    end_ns += await self._pause.wait()
                    self._order_anew()

                self._note_stopped()
                self._fail_refused(is_over=False)
                if not self._still_following() or not self._can_follow_leader():
                    break

                await self._order_goals()
                await asyncio.sleep(_PERIOD_S)
        finally:
            self._ground.follow_pauses.remove(self._pause)

    async def hold(self) -> Results:
        """Order the followers to hold, except those that were stopped or landed.

        Returns:
            The results; none if an operator has taken the fleet, all were brought home, or the
            script ends.
        """
        self._note_stopped()
        is_taken = self._ground.watch.takeover() is not None
        is_ending = self._ground.is_ending  # the end of the script orders in place of this
        have_other_order = is_taken or is_ending or self._pause.has_brought_home
        holding = [name for name, one in self._followers.items() if one.holds_in_the_end]
        if not holding or have_other_order:
            return {}
        return await self._ground.order(Hold(vehicles=tuple(holding)), _HOLD_S)

    async def end(self) -> Results:
        """End the following after its time: let the vehicles hold, and judge who has failed."""
        self._fail_refused(is_over=True)
        held = await self.hold()
        results = {**held, **self._failed}
        if not self._failed:
            return results

        duration_s = (self._client.now_ns() - self._begin_ns) * 1e-9
        step = step_result(f"follow {self._leader}", duration_s, results)
        self._ground.steps.append(step)
        intent = Goto(vehicles=tuple(results), goals={}, follows=self._leader)
        await self._ground.go_on_or_fail(intent, results)
        return results

    async def _wait_while_lost(self) -> int:
        """Wait while this ground hears no vehicle, and return for how long [ns]."""
        client = self._client
        begin_ns = client.now_ns()
        was_lost = await self._ground.link.wait_while_lost()
        if not was_lost:
            return 0

        await client.wait_for(self._hears_leader, _HEARD_S)
        await self._restart_stopped()
        self._order_anew()  # the vehicles may not have received the last goals
        return client.now_ns() - begin_ns

    async def _restart_stopped(self) -> None:
        """Order those to hold who hold by a failsafe, so that they take goals again.

        The failsafe may have been that they heard nobody, as this ground did.
        """
        stopped = self._pause.stopped()
        holding = [name for name, telemetry in stopped.items() if telemetry.state == "holding"]
        is_taken = self._ground.watch.takeover() is not None
        if not holding or is_taken:
            return
        held = await self._ground.order(Hold(vehicles=tuple(holding)), _HOLD_S)
        for name in holding:
            # another task or a person may have given an order during the wait
            newest = self._client.newest_order(name)
            if newest is not None and newest.results[name].order_id == held[name].order_id:
                self._followers[name].own_order = newest
        self._pause.begin_anew(holding)

    def _can_follow_leader(self) -> bool:
        """Return whether the leader can still be followed; otherwise say why not.

        A leader that stands when the following begins, or that a pilot flies, can be followed.
        """
        leader = self._leader
        if leader in self._ground.left_out - self._left_out_before:
            self._ground.say(f"  the mission goes on without {leader}: nobody follows it any more")
            return False

        view = self._client.state.vehicles[leader]
        telemetry = view.telemetry
        if telemetry is None or view.position_enu_m(self._client.now_ns()) is None:
            self._fail_leader("It does not report where it is.")
            return False

        if telemetry.state in ("taking off", "flying", "holding") or telemetry.is_flown_by_hand:
            self._has_leader_flown = True
            return True
        if not self._has_leader_flown:
            return True

        if telemetry.reason in ("", ORDERED):
            self._ground.say(f"  {leader} lands: nobody follows it any more")
        else:
            self._fail_leader(telemetry.reason)
        return False

    def _fail_leader(self, reason: str) -> None:
        """Note and say that the leader has failed."""
        self._failed[self._leader] = VehicleResult(self._leader, "", "failed", reason)
        self._ground.say(f"  nobody follows {self._leader} any more: {reason}")

    def _hears_leader(self, state: FleetState) -> bool:
        return state.vehicles[self._leader].is_fresh(self._client.now_ns())

    def _order_anew(self) -> None:
        """Let the next goals be ordered also if the leader has not moved."""
        for follower in self._followers.values():
            follower.accepted_goal_enu_m = None
            follower.accepted_ns = self._client.now_ns()
            follower.refusal = None

    # -- who follows no longer ---------------------------------------------------------------------

    def _still_following(self) -> dict[str, _Follower]:
        """Return the vehicles that still get goals, by name."""
        return {name: one for name, one in self._followers.items() if one.is_following}

    def _note_stopped(self) -> None:
        """Note and say who follows no longer, by an order of the mission or by a failsafe."""
        self._forget(self._ground.left_out - self._left_out_before)
        is_taken = self._ground.watch.takeover() is not None
        if is_taken or self._pause.has_brought_home:  # all have other orders
            return
        ordered = self._ordered_elsewhere()
        if ordered:
            self._ground.say(f"  {listed(ordered)}: another order ends following {self._leader}")
            self._forget(ordered)

        skipped = []
        for name, telemetry in self._pause.stopped().items():
            if telemetry.reason != ORDERED:
                reason = telemetry.reason or f"It is {telemetry.state}."
                self._fail(VehicleResult(name, telemetry.order_id, "failed", reason))
                self._forget([name])
            else:
                skipped.append(name)
        if skipped:
            self._ground.say(f"  {', '.join(skipped)} skips the rest of following {self._leader}")
            self._follow_without(skipped)

    def _ordered_elsewhere(self) -> list[str]:
        """Return the followers to which the mission or a person here has given another order."""
        if self._ground.is_ending:
            return []  # these are orders of the end; the next goals are refused because of it
        not_taken = (None, "sent", "refused", "no answer")
        return [
            name
            for name in self._still_following()
            if self._other_order_phase(name) not in not_taken
        ]

    def _other_order_phase(self, name: str) -> Phase | None:
        """Return how far a vehicle is with a newer order than this one's; None: it has none."""
        newest = self._client.newest_order(name)
        if newest is None or newest is self._followers[name].own_order:
            return None
        return newest.results[name].phase

    def _fail_refused(self, *, is_over: bool) -> None:
        """Fail the vehicles whose goals were all refused for too long.

        Args:
            is_over: whether the following is over; then a shorter time is too long, and so is any
                time in which a vehicle has accepted no goal at all.
        """
        now_ns = self._client.now_ns()
        for name, follower in self._still_following().items():
            if follower.refusal is None:
                continue

            since_ns = self._begin_ns if follower.accepted_ns is None else follower.accepted_ns
            if not is_over:
                limit_s = _REFUSED_S
            elif follower.accepted_ns is None:
                limit_s = 0.0
            else:
                limit_s = _REFUSED_AT_END_S

            if (now_ns - since_ns) * 1e-9 > limit_s:
                # it holds in the end: it may still fly to an earlier goal
                self._fail(follower.refusal)
                self._follow_without([name])

    def _fail(self, result: VehicleResult) -> None:
        """Note and say that a vehicle follows no longer, though nobody has ordered so."""
        self._failed[result.vehicle] = result
        self._ground.say(f"  {result.vehicle} follows {self._leader} no longer: {result.reason}")

    def _forget(self, names: Collection[str]) -> None:
        """Give these vehicles no more orders, not even to hold."""
        for name, follower in self._followers.items():
            if name in names:
                follower.holds_in_the_end = False
        self._follow_without(names)

    def _follow_without(self, names: Collection[str]) -> None:
        """Give these vehicles no more goals."""
        for name, follower in self._followers.items():
            if name in names:
                follower.is_following = False
        self._pause.leave_out(tuple(names))

    # -- goals -------------------------------------------------------------------------------------

    async def _order_goals(self) -> None:
        """Send the followers to their goals, without waiting for this order to end.

        Goals that have hardly moved are not sent again, if the vehicles have accepted the last
        ones.

        Raises:
            ConfigError: the script's connection has ended.
            FleetTaken: an operator has taken the fleet.
        """
        view = self._client.state.vehicles[self._leader]
        position_enu_m = view.position_enu_m(self._client.now_ns())
        if position_enu_m is None or view.telemetry is None:
            return
        # a vehicle that has not answered another order may be about to take it
        offsets = {
            name: follower.offset_enu_m
            for name, follower in self._still_following().items()
            if self._other_order_phase(name) != "sent"
        }
        goals = _goals(self._client, position_enu_m, view.telemetry.velocity_enu_m_s, offsets)
        if not any(self._followers[name].needs(goal) for name, goal in goals.items()):
            for name in goals:
                self._followers[name].accepted_ns = self._client.now_ns()
            return

        taken = self._ground.watch.takeover()
        if taken is not None:
            raise FleetTaken(taken)

        goto = Goto(vehicles=tuple(goals), goals=goals, follows=self._leader)
        await self._ground.check_open(goto)
        order = await self._client.submit(goto, is_by_mission=True)
        for name in order.planned.orders:
            self._followers[name].own_order = order
        for result in order.results.values():  # some may be refused already
            self._note_answer(goals, result)
        order.add_listener(functools.partial(self._note_answer, goals))

    def _note_answer(self, goals: Mapping[str, Xyz], result: VehicleResult) -> None:
        """Note whether a vehicle has accepted its goal; the answer may come late.

        Args:
            goals: goals of the order.
            result: progress of the order with the vehicle.
        """
        follower = self._followers[result.vehicle]
        if not follower.is_following:
            return
        if result.phase in ("accepted", "done"):
            follower.accepted_goal_enu_m = goals[result.vehicle]
            follower.accepted_ns = self._client.now_ns()
            follower.refusal = None
        elif result.phase in ("refused", "no answer"):
            follower.refusal = result


def present_offsets(client: FleetClient, leader: str, names: Sequence[str]) -> dict[str, Xyz]:
    """Return the present offsets of vehicles from a leader [m], ENU.

    Args:
        client: fleet client that has been started.
        leader: the vehicle that is followed.
        names: names of the vehicles; the leader itself is left out.

    Raises:
        ConfigError: a vehicle does not report its position.
    """
    client.fleet.select([leader])

    positions: dict[str, Xyz] = {}
    unknown = []
    for name in dict.fromkeys((leader, *names)):
        position_enu_m = client.state.vehicles[name].position_enu_m(client.now_ns())
        if position_enu_m is None:
            unknown.append(name)
        else:
            positions[name] = position_enu_m
    if unknown:
        raise ConfigError(
            f"{', '.join(unknown)} does not report where it is, so nobody can follow."
        )

    x, y, z = positions.pop(leader)
    return {
        name: (position[0] - x, position[1] - y, position[2] - z)
        for name, position in positions.items()
    }


def _goals(
    client: FleetClient, position_enu_m: Xyz, velocity_enu_m_s: Xyz, offsets: Mapping[str, Xyz]
) -> dict[str, Xyz]:
    """Return the followers' goals, ahead of the leader's present position and inside the fence."""
    ahead_enu_m = [
        coordinate_m + _GOAL_LEAD_S * speed_m_s
        for coordinate_m, speed_m_s in zip(position_enu_m, velocity_enu_m_s, strict=True)
    ]

    goals = {}
    for name, (x, y, z) in offsets.items():
        goal = (ahead_enu_m[0] + x, ahead_enu_m[1] + y, ahead_enu_m[2] + z)
        goals[name] = _inside(client.fleet, client.fleet.vehicles[name], goal)
    return goals


def _inside(fleet: FleetConfig, follower: Vehicle, goal: Xyz) -> Xyz:
    """Return the point nearest to the goal that is inside the fence and not too low."""
    x, y, z = flight_space_of(fleet).nearest_inside(goal, _INSIDE_M)
    least_m = max(LOWEST_M, least_height_m(follower))
    return (x, y, max(z, float(touchable_ground_at_m(fleet, x, y)) + least_m))
