"""The verbs of the mission API, for one, some or all vehicles of a fleet.

Each verb of `groundstation/orders/intents.py` is a method here: its arguments are the fields of
the intent, and it returns one result per vehicle. Other methods consist of several orders or of
none: they follow paths or another vehicle, wait for conditions and react to them.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import math
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from numbers import Integral
from typing import NamedTuple, get_args

import numpy as np

from groundstation.client.client import FleetClient
from groundstation.fleet.slot_owners import (
    by_vehicle,
    out_of_service,
    slot_owner_of,
    vehicles_of_slots,
)
from groundstation.fleet.state import FleetState
from groundstation.fleet.stoppable import stoppable
from groundstation.formations.frame import FormationPaths
from groundstation.formations.slots import formation_names, formation_slots
from groundstation.mission_files.wall_time import (
    WallTime,
    check_wall_time,
    local_now,
    wall_time,
)
from groundstation.missions.argument_checks import (
    as_position,
    as_positions,
    check_duration,
    check_number,
    check_timeout,
)
from groundstation.missions.conditions import (
    ConditionTimeout,
    EventsOfWait,
    FleetMoment,
    WaitCondition,
)
from groundstation.missions.following import follow, present_offsets
from groundstation.missions.ground import MissionGround
from groundstation.missions.path_following import follow_paths
from groundstation.missions.vehicle_names import ByVehicle, Vehicles, as_names, by_name
from groundstation.orders.degrees import goal_enu_m
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import (
    DEFAULT_EVERY_S,
    DEFAULT_HEIGHT_M,
    Arm,
    Assign,
    BringHome,
    Disable,
    Disarm,
    Enable,
    Formation,
    Goto,
    Hold,
    Home,
    Intent,
    Kill,
    Land,
    Locate,
    Move,
    Pause,
    Reboot,
    Resume,
    Rotate,
    Skip,
    Swap,
    Takeoff,
    Yaw,
    means_all,
)
from groundstation.orders.obstacle_crossings import path_refusals
from groundstation.orders.path_orders import OnLag
from groundstation.orders.result import OrderFailed, Results
from groundstation.paths.lights import TimedColour
from groundstation.paths.pieces import through
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.control.path import Path
from onboard.plain_text import capitalised
from onboard.tuples import Xyz

GoalOrGoals = Xyz | ByVehicle[Xyz]

_LOOK_S = 0.5  # time between two checks for a pause during a wait
_EVER_S = 1e9  # timeout of a wait that ends only with its condition


def _check_condition(condition: object) -> None:
    """Refuse anything but a condition, such as a function."""
    if not isinstance(condition, WaitCondition):
        raise ConfigError(
            f"{type(condition).__name__!r} is no condition. Use one of"
            " groundstation.missions.conditions, for instance separation_above(1.0), or make one:"
            " WaitCondition(words, holds, value)."
        )


def _check_reaction(reaction: object) -> None:
    """Refuse anything but a function, such as what a call of a verb returns."""
    if callable(reaction):
        return
    if inspect.iscoroutine(reaction):
        reaction.close()  # otherwise Python warns that it was never awaited
    raise ConfigError(
        f"reacting: {type(reaction).__name__!r} is no function that could be called later. Write "
        "the function without parentheses, for instance fleet.hold."
    )


def _done_by(results: Results) -> list[str]:
    """Return the vehicles that did what was ordered."""
    return [name for name, result in results.items() if result.is_done]


class _Selection(NamedTuple):
    """The vehicles that an argument selects."""

    names: tuple[str, ...]
    is_everybody: bool  # whether the argument means all without naming them


class Group:
    """Vehicles of a fleet that are ordered together.

    Every verb waits for the end of its order and returns one result per vehicle. It raises
    ``OrderFailed``, with the results, when a vehicle did not do it, and ``ConfigError`` when the
    order makes no sense. ``vehicles`` selects some vehicles of the group; ``timeout_s`` is the
    longest wait [s], in vehicle time.

    Args:
        ground: gives the mission's orders and keeps their results.
        names: names of the vehicles.
    """

    def __init__(self, ground: MissionGround, names: Sequence[str]) -> None:
        self.ground = ground
        self._names = tuple(names)

    @property
    def names(self) -> tuple[str, ...]:
        """Vehicles of this group that take part; if none does, all that the group names.

        So vehicles that the mission goes on without can still be ordered by their names.
        """
        taking_part = self._taking_part
        if not taking_part:
            return self._names
        return taking_part

    @property
    def _taking_part(self) -> tuple[str, ...]:
        return tuple(name for name in self._names if name not in self.ground.left_out)

    @property
    def client(self) -> FleetClient:
        """The ground's end of the bus."""
        return self.ground.client

    @property
    def config(self) -> FleetConfig:
        """The fleet file."""
        return self.ground.client.fleet

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""
        return self.ground.client.state

    def select(self, vehicles: Vehicles, *, with_lost: bool = False) -> tuple[str, ...]:
        """Return the names of the vehicles of this group that an argument selects.

        The name of a vehicle that was swapped selects the spare that has its place.

        Args:
            vehicles: "all", names or indices.
            with_lost: whether "all" includes vehicles to whose failure the mission has reacted.

        Raises:
            ConfigError: a vehicle is not in this group, or none is named.
        """
        return self._selected(vehicles, with_lost=with_lost).names

    def _selected(self, vehicles: Vehicles, *, with_lost: bool = False) -> _Selection:
        """Return what :meth:`select` returns, and whether the argument means all."""
        names = as_names(vehicles)
        if means_all(names):
            if with_lost:
                return _Selection(self.names, is_everybody=True)
            return _Selection(self.ground.without_lost(self.names), is_everybody=True)

        selected = vehicles_of_slots(self.config.select(names), self.state)
        self._check_in_group(selected)
        return _Selection(selected, is_everybody=False)

    def _select_for_service(self, vehicles: Vehicles) -> tuple[str, ...]:
        """Return the vehicles of this group that an order of service names.

        Each name means the vehicle itself, whoever has its place, and "all" those out of service
        too.

        Raises:
            ConfigError: a vehicle is not in this group, or none is named.
        """
        names = as_names(vehicles)
        if means_all(names):
            return self._names
        selected = self.config.select(names)
        self._check_in_group(selected)
        return selected

    def _check_in_group(self, names: Sequence[str]) -> None:
        """Refuse vehicles that are not in this group."""
        not_in_group = [name for name in names if name not in self._names]
        if not_in_group:
            raise ConfigError(
                f"{', '.join(not_in_group)} is not among {', '.join(self._names)}. "
                "Order the whole fleet."
            )

    async def arm(self, vehicles: Vehicles = "all", *, timeout_s: float = 15.0) -> Results:
        """Arm on the ground."""
        selected = self._selected(vehicles)
        intent = Arm(vehicles=selected.names, is_everybody=selected.is_everybody)
        return await self.order(intent, timeout_s)

    async def disarm(self, vehicles: Vehicles = "all", *, timeout_s: float = 15.0) -> Results:
        """Disarm on the ground."""
        return await self.order(Disarm(vehicles=self.select(vehicles, with_lost=True)), timeout_s)

    async def locate(self, vehicles: Vehicles = "all", *, timeout_s: float = 5.0) -> Results:
        """Play a tune, so that an operator sees which vehicles these are."""
        return await self.order(Locate(vehicles=self.select(vehicles, with_lost=True)), timeout_s)

    async def reboot(self, vehicles: Vehicles, *, timeout_s: float = 40.0) -> Results:
        """Restart PX4, on the ground and disarmed.

        The order is done when PX4 is heard with a clock that has begun again.

        Args:
            vehicles: vehicles to order.
            timeout_s: longest wait [s].
        """
        return await self.order(Reboot(vehicles=self.select(vehicles)), timeout_s)

    async def disable(self, vehicles: Vehicles, *, timeout_s: float = 5.0) -> Results:
        """Take vehicles out of service: "all" excludes them, and they refuse to start.

        Args:
            vehicles: vehicles to order; they stand on the ground, disarmed.
            timeout_s: longest wait [s].
        """
        intent = Disable(vehicles=self._select_for_service(vehicles))
        try:
            results = await self.order(intent, timeout_s)
        except OrderFailed as error:  # others may have done it
            self._note_disabled(error.results)
            raise
        self._note_disabled(results)
        return results

    def _note_disabled(self, results: Results) -> None:
        """Go on without the vehicles that are out of service after an order."""
        self.ground.note_disabled(_done_by(results))

    async def enable(self, vehicles: Vehicles, *, timeout_s: float = 5.0) -> Results:
        """Let vehicles that were disabled take part in flights again.

        Args:
            vehicles: vehicles to order.
            timeout_s: longest wait [s].
        """
        intent = Enable(vehicles=self._select_for_service(vehicles))
        try:
            results = await self.order(intent, timeout_s)
        except OrderFailed as error:  # others may have done it
            self._note_enabled(error.results)
            raise

        # the next order leaves out vehicles that still report to be out of service
        def is_reported(state: FleetState) -> bool:
            return out_of_service(state).isdisjoint(_done_by(results))

        await self.client.wait_for(is_reported, timeout_s)
        self._note_enabled(results)
        return results

    def _note_enabled(self, results: Results) -> None:
        """Let the vehicles take part again that are in service after an order."""
        enabled = _done_by(results)
        self.ground.disabled.difference_update(enabled)
        self.ground.left_out.difference_update(enabled)

    async def swap(self, vehicle: str, spare: str, *, timeout_s: float = 5.0) -> Results:
        """Replace a vehicle by a spare that stands on its take-off spot; both are disarmed.

        From then on the name of the vehicle means the spare: in paths, goals and formations.

        Args:
            vehicle: vehicle that is out of service from then on.
            spare: vehicle that takes part instead.
            timeout_s: longest wait [s].

        Raises:
            ConfigError: they are not two vehicles.
        """
        names = self.config.select(as_names([vehicle, spare]))
        if len(names) != 2:
            raise ConfigError(
                f"A swap is of two vehicles, and this one names {', '.join(names)}. Name the "
                "vehicle and its spare."
            )
        intent = Swap(vehicles=names)
        results = await self.order(intent, timeout_s)
        if len(_done_by(results)) < len(results):
            return results  # each keeps its place, and the mission goes on without who refused

        def is_reported(state: FleetState) -> bool:
            excluded = out_of_service(state)
            return intent.swapped in excluded and intent.spare not in excluded

        await self.client.wait_for(is_reported, timeout_s)
        self.ground.note_disabled([intent.swapped])
        self.ground.disabled.discard(intent.spare)
        self.ground.left_out.discard(intent.spare)
        return results

    async def takeoff(
        self,
        height_m: float = DEFAULT_HEIGHT_M,
        vehicles: Vehicles = "all",
        *,
        by: int = 0,
        every_s: float = DEFAULT_EVERY_S,
        timeout_s: float = 40.0,
    ) -> Results:
        """Take off, all at once or in waves.

        A wave starts only if all vehicles of the waves before it fly, except those that the mission
        goes on without.

        Args:
            height_m: height above the fleet's origin [m].
            vehicles: vehicles to order.
            by: number of vehicles in a wave; 0: all at once.
            every_s: time from the arrival of a wave to the start of the next [s].
            timeout_s: longest wait for a wave [s].
        """
        selected = self._selected(vehicles)
        intent = Takeoff(
            vehicles=selected.names,
            is_everybody=selected.is_everybody,
            height_m=height_m,
            by=by,
            every_s=every_s,
        )
        return await self.order(intent, timeout_s)

    async def move(
        self,
        position_enu_m: Xyz,
        vehicles: Vehicles = "all",
        *,
        yaw_deg: float | None = None,
        duration_s: float = 0.0,
        timeout_s: float = 40.0,
    ) -> Results:
        """Move one vehicle to a goal, or several vehicles in their present formation.

        Before a formation is ordered, it is the first one of the fleet file.

        Args:
            position_enu_m: goal of one vehicle, or position of the formation [m], ENU.
            vehicles: vehicles to order.
            yaw_deg: heading to turn to, counterclockwise from east; None: the present one.
            duration_s: duration of the move [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait [s].

        Raises:
            ConfigError: a vehicle stands where the position belongs.
        """
        if isinstance(position_enu_m, str | Integral):
            raise ConfigError(
                f"move: {position_enu_m!r:.80} is no position, which comes first. To move one "
                'vehicle, write: move((1.0, 0.0, 1.2), "mav0").'
            )
        selected = self._selected(vehicles)
        intent = Move(
            vehicles=selected.names,
            is_everybody=selected.is_everybody,
            position_enu_m=position_enu_m,
            is_of_formation=selected.is_everybody and len(self._names) > 1,
            yaw_deg=yaw_deg,
            duration_s=duration_s,
        )
        return await self.order(intent, timeout_s)

    async def go_to(
        self,
        goals: GoalOrGoals,
        *,
        yaw_deg: float | None = None,
        duration_s: float = 0.0,
        timeout_s: float = 40.0,
    ) -> Results:
        """Go to a goal, or send each vehicle to its own goal.

        All goals are one order, which is checked as a whole, so vehicles may change places.

        Args:
            goals: a position [m], ENU, for a group of one vehicle; or a position for each name or
                index.
            yaw_deg: heading to turn to, counterclockwise from east; None: the present one.
            duration_s: duration of the move [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait [s].

        Raises:
            ConfigError: a goal is not three finite numbers.
            OrderError: several vehicles would share one goal.
        """
        if not isinstance(goals, Mapping):
            if len(self.names) != 1:
                raise OrderError(
                    "Several vehicles cannot share one goal: give each its own, {name: (x, y, z)}."
                )
            goals = {self.names[0]: goals}

        named_goals = by_name(goals, self.config, "go_to", "position")
        positions = {name: as_position(goal, "go_to") for name, goal in named_goals.items()}
        own_goals = by_vehicle(positions, self.state)
        intent = Goto(
            vehicles=self.select(list(own_goals)),
            goals=own_goals,
            yaw_deg=yaw_deg,
            duration_s=duration_s,
        )
        return await self.order(intent, timeout_s)

    def place(self, latitude_deg: float, longitude_deg: float, height_m: float) -> Xyz:
        """Return a position on Earth as a goal [m], ENU.

        Args:
            latitude_deg: latitude of the position.
            longitude_deg: longitude of the position.
            height_m: height in the fleet frame, like the third coordinate of every goal [m].

        Raises:
            ConfigError: the fleet file has no origin, the position is too far from the origin, or
                a value is no finite number.
        """
        check_number(latitude_deg, "place", "degrees")
        check_number(longitude_deg, "place", "degrees")
        check_number(height_m, "place", "metres")
        return goal_enu_m(self.config, latitude_deg, longitude_deg, height_m)

    async def formation(
        self,
        name: str,
        position_enu_m: Xyz | None = None,
        vehicles: Vehicles = "all",
        *,
        spacing_m: float | None = None,
        rotation_deg: float = 0.0,
        yaw_deg: float | None = None,
        assign: Assign = "ids",
        duration_s: float = 0.0,
        timeout_s: float = 40.0,
    ) -> Results:
        """Take up a formation.

        Args:
            name: name of the formation in the fleet file.
            position_enu_m: position of the formation [m], ENU; None: the mean of the vehicles'
                present positions.
            vehicles: vehicles to order.
            spacing_m: distance of the two nearest slots [m], to which the formation is stretched;
                None: the distance in the fleet file.
            rotation_deg: angle by which the formation is turned, counterclockwise.
            yaw_deg: heading of each vehicle, counterclockwise from east; None: the present one.
            assign: "ids": each vehicle has its own slot; "nearest": slots are assigned so that the
                longest flight is as short as possible.
            duration_s: duration of the move [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait [s].

        Raises:
            ConfigError: the fleet file has no such formation.
        """
        if name not in formation_names(self.config):
            known = ", ".join(formation_names(self.config)) or "none"
            raise ConfigError(f"'{name}' is no formation of this fleet; it has {known}.")

        names, is_everybody = self._selected(vehicles)
        if is_everybody:
            slots = formation_slots(self.config, name)
            names = tuple(
                vehicle for vehicle in names if slot_owner_of(vehicle, self.state) in slots
            )

        intent = Formation(
            vehicles=names,
            is_everybody=is_everybody,
            name=name,
            position_enu_m=position_enu_m,
            spacing_m=spacing_m,
            rotation_deg=rotation_deg,
            yaw_deg=yaw_deg,
            assign=assign,
            duration_s=duration_s,
        )
        return await self.order(intent, timeout_s)

    async def rotate(
        self,
        angle_deg: float,
        vehicles: Vehicles = "all",
        *,
        duration_s: float = 0.0,
        timeout_s: float = 40.0,
    ) -> Results:
        """Turn the present formation; each vehicle flies straight to its new slot.

        Args:
            angle_deg: angle to turn by, counterclockwise.
            vehicles: vehicles to order.
            duration_s: duration of the move [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait [s].
        """
        selected = self._selected(vehicles)
        intent = Rotate(
            vehicles=selected.names,
            is_everybody=selected.is_everybody,
            angle_deg=angle_deg,
            duration_s=duration_s,
        )
        return await self.order(intent, timeout_s)

    async def yaw(
        self, yaw_deg: float, vehicles: Vehicles = "all", *, timeout_s: float = 15.0
    ) -> Results:
        """Turn each vehicle to a heading, without changing its position.

        Args:
            yaw_deg: heading, counterclockwise from east.
            vehicles: vehicles to order.
            timeout_s: longest wait [s].
        """
        selected = self._selected(vehicles)
        intent = Yaw(
            vehicles=selected.names,
            is_everybody=selected.is_everybody,
            yaw_deg=yaw_deg,
        )
        return await self.order(intent, timeout_s)

    async def home(
        self,
        vehicles: Vehicles = "all",
        *,
        height_m: float | None = None,
        duration_s: float = 0.0,
        timeout_s: float = 90.0,
    ) -> Results:
        """Fly back to the take-off spots of the fleet file, land there and disarm.

        This is one order, which is checked as a whole.

        Args:
            vehicles: vehicles to order.
            height_m: height of the way back, above the fleet's origin [m]; None: each vehicle keeps
                its present height, or rises above its spot.
            duration_s: duration of the way back [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait [s].
        """
        selected = self._selected(vehicles)
        intent = Home(
            vehicles=selected.names,
            is_everybody=selected.is_everybody,
            height_m=height_m,
            duration_s=duration_s,
        )
        return await self.order(intent, timeout_s)

    async def bring_home(
        self,
        vehicles: Vehicles = "all",
        *,
        height_m: float | None = None,
        duration_s: float = 0.0,
        timeout_s: float = 90.0,
    ) -> Results:
        """Fly back from any positions, land on the take-off spots and disarm.

        The spots are assigned so that the flights to them do not cross. A path or a formation ends.

        Args:
            vehicles: vehicles to order.
            height_m: height of the way back, above the fleet's origin [m]; None: each vehicle keeps
                its present height, or rises above its spot.
            duration_s: duration of the way back [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait [s].
        """
        selected = self._selected(vehicles)
        intent = BringHome(
            vehicles=selected.names,
            is_everybody=selected.is_everybody,
            height_m=height_m,
            duration_s=duration_s,
        )
        return await self.order(intent, timeout_s)

    async def pause(self, vehicles: Vehicles = "all", *, timeout_s: float = 5.0) -> Results:
        """Stop the clock of the paths; the order to follow them remains in force.

        Vehicles that follow another one hold where they are until `resume`.

        Args:
            vehicles: vehicles to order; all others of the same show pause with them.
            timeout_s: longest wait [s].
        """
        names = self._stoppable(self.select(vehicles))
        return await self.order(Pause(vehicles=names), timeout_s)

    async def resume(self, vehicles: Vehicles = "all", *, timeout_s: float = 5.0) -> Results:
        """Let the clock of paused paths go on.

        Args:
            vehicles: vehicles to order; a show goes on when none of its vehicles is still paused.
            timeout_s: longest wait [s].
        """
        names = self._stoppable(self.select(vehicles))
        return await self.order(Resume(vehicles=names), timeout_s)

    async def skip(self, vehicles: Vehicles = "all", *, timeout_s: float = 5.0) -> Results:
        """Leave the paths and fly straight to their ends, with the avoidance law.

        The order to follow the paths is done when all are at the ends. Then the mission goes on.
        Vehicles that follow another vehicle stop following and hold.

        Args:
            vehicles: vehicles to order; the others go on along their paths.
            timeout_s: longest wait [s].
        """
        names = self._stoppable(self.select(vehicles))
        results = await self.order(Skip(vehicles=names), timeout_s)

        # an order that follows at once is for those that still follow, so they have to report it
        def have_left(state: FleetState) -> bool:
            return not stoppable(state, _done_by(results))

        await self.client.wait_for(have_left, timeout_s)
        return results

    def _stoppable(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the vehicles that follow a path or another vehicle.

        If there are none, return all, so that the results of the order tell why it is refused.
        """
        followers = stoppable(self.state, names)
        if not followers:
            return names
        return followers

    async def follow_path(
        self,
        paths: ByVehicle[Path],
        *,
        lights: ByVehicle[Sequence[TimedColour]] | None = None,
        on_lag: OnLag = "land",
        at: str | WallTime = "",
        timeout_s: float | None = None,
    ) -> Results:
        """Let each vehicle follow its own path; all start at the same instant.

        Before that, the vehicles fly to the first points of their paths. A vehicle that leaves its
        path fails in the results only: the others go on. ``OrderFailed`` comes when no vehicle has
        arrived, or when the time is over. Vehicles that another task of the script orders elsewhere
        (``bring_home`` in a pause) are ``superseded`` and fail nothing. After the paths of a
        formation, the present formation is the one at their end.

        Args:
            paths: path of each vehicle, by name or index, see
                :func:`groundstation.paths.path_files.load_path`; or paths of a formation, see
                :func:`groundstation.formations.frame.frame_paths`.
            lights: colours of vehicles, see :func:`groundstation.paths.lights.load_lights`.
            on_lag: reaction of a vehicle that falls behind for too long; the others go on.
            at: wall-clock time at which they start; empty: at once.
            timeout_s: longest flight along the paths [s]; None: twice their own duration and a
                minute.
        """
        self.ground.check_not_ended()
        if timeout_s is not None:
            check_timeout(timeout_s, "follow_path")
        if on_lag not in get_args(OnLag):
            raise ConfigError(f"on_lag is {on_lag!r:.80}. Write {' or '.join(get_args(OnLag))}.")
        end = None
        if isinstance(paths, FormationPaths):
            end = paths.end
        named_paths = by_name(paths, self.config, "follow_path", "path")
        named_lights = by_name(lights or {}, self.config, "follow_path", "list of lights")
        self.select(list(named_paths))  # raises ConfigError for a vehicle outside this group
        for name, path in named_paths.items():
            if not isinstance(path, Path):
                raise ConfigError(
                    f"follow_path: {path!r:.80} is no path for {name}. Read its file with "
                    "load_path of groundstation.paths.path_files."
                )
        own_paths = by_vehicle(named_paths, self.state)
        start = self._time_of(at)

        # With another law than Covey's, a simulation may fly paths that Covey's law would refuse.
        is_other_law = self.config.law.built_in != "covey"
        may_fly_any_path = self.state.is_simulated and is_other_law
        if not may_fly_any_path:
            refused = path_refusals(self.config, own_paths, "follow_path")
            if refused:
                raise ConfigError(refused[0])

        results = await follow_paths(
            self.ground,
            own_paths,
            lights=by_vehicle(named_lights, self.state),
            on_lag=on_lag,
            at=start,
            timeout_s=timeout_s,
        )
        if end is not None and _done_by(results):
            self.client.hold_formation(end)
        return results

    async def fly_through(
        self, waypoints: ByVehicle[Sequence[Xyz]], *, speed_m_s: float, on_lag: OnLag = "land"
    ) -> Results:
        """Fly through waypoints on a smooth curve, from where the vehicles are to the last ones.

        Where the curve would leave a line between waypoints by more than 0.1 m and a quarter of its
        length, or by more than 0.5 m, a vehicle flies straighter, and stops at corners.

        Args:
            waypoints: waypoints of each vehicle, by name or index [m], ENU.
            speed_m_s: speed at the waypoints between the first and the last [m/s], except corners
                at which a vehicle stops; between two of these it flies slower.
            on_lag: reaction of a vehicle that falls behind for too long; the others go on.

        Raises:
            ConfigError: two successive waypoints are equal, a vehicle does not fly, or a value is
                no finite number.
        """
        check_number(speed_m_s, "fly_through", "metres per second")
        paths = {}
        named_waypoints = by_name(waypoints, self.config, "fly_through", "list of positions")
        own_waypoints = by_vehicle(named_waypoints, self.state)
        for name in self.select(list(own_waypoints)):
            telemetry = self.state.vehicles[name].telemetry
            if telemetry is None or not telemetry.is_airborne:
                if name in self.ground.left_out:
                    continue
                raise ConfigError(f"{name} does not fly: order take-off first.")

            goals = as_positions(own_waypoints[name], "fly_through")
            points = np.array([telemetry.goal_position_enu_m, *goals], dtype=float)
            yaw_rad = np.full(len(points), math.radians(telemetry.yaw_deg))
            speeds_m_s = np.full(len(points), speed_m_s)
            try:
                paths[name] = through(np.column_stack([points, yaw_rad]), speeds_m_s)
            except ValueError as error:
                raise ConfigError(f"{name}: {error}") from None

        return await self.follow_path(paths, on_lag=on_lag)

    async def follow(
        self, leader: str | int, duration_s: float, *, offsets: ByVehicle[Xyz] | None = None
    ) -> Results:
        """Follow another vehicle for a time, each at its offset; then hold.

        The followers hold even when this call is cancelled. One that a failsafe stops, or whose
        goals are refused for 5 s or at the end, fails; the others go on. One that another task of
        the script gives an order (``home``, ``yaw``) follows no longer. When the leader lands, or
        the mission goes on without it, all hold; when a failsafe lands it, or it reports no
        position, it fails as well.

        Args:
            leader: name or index of the vehicle that is followed.
            duration_s: duration [s].
            offsets: offsets of the followers from the leader, by name or index [m], ENU; None: the
                present offsets of all other vehicles of the group.

        Raises:
            ConfigError: the leader or a follower does not report where it is, or the duration or
                an offset is not of finite numbers.
        """
        self.ground.check_not_ended()
        check_duration(duration_s, "follow")
        leaders = vehicles_of_slots(self.config.select(as_names(leader)), self.state)
        if len(leaders) != 1:
            raise ConfigError(f"follow: {', '.join(leaders)} cannot all be followed. Name one.")
        (leader,) = leaders  # the spare, if the vehicle was swapped
        if offsets is not None:
            named = by_name(offsets, self.config, "follow", "offset")
            offsets_by_owner = {
                name: as_position(offset, "follow") for name, offset in named.items()
            }
        else:
            offsets_by_owner = present_offsets(self.client, leader, self.names)
        own_offsets = by_vehicle(offsets_by_owner, self.state)

        followers = self.select(list(own_offsets))
        follower_offsets = {name: own_offsets[name] for name in followers}
        return await follow(self.ground, leader, follower_offsets, duration_s)

    async def hold(self, vehicles: Vehicles = "all", *, timeout_s: float = 15.0) -> Results:
        """Hold the present position."""
        return await self.order(Hold(vehicles=self.select(vehicles)), timeout_s)

    async def land(self, vehicles: Vehicles = "all", *, timeout_s: float = 40.0) -> Results:
        """Land and disarm."""
        selected = self._selected(vehicles, with_lost=True)
        intent = Land(vehicles=selected.names, is_everybody=selected.is_everybody)
        return await self.order(intent, timeout_s)

    async def kill(self, vehicles: Vehicles, *, timeout_s: float = 5.0) -> Results:
        """Stop the motors at once, even in the air, where the vehicles fall.

        Args:
            vehicles: vehicles to order; there is no default.
            timeout_s: longest wait [s].
        """
        return await self.order(Kill(vehicles=self.select(vehicles, with_lost=True)), timeout_s)

    async def order(self, intent: Intent, timeout_s: float) -> Results:
        """Give an order, wait for its end and log the results.

        Args:
            intent: the order.
            timeout_s: longest wait for its end [s].
        """
        check_timeout(timeout_s, intent.verb)
        return await self.ground.order(intent, timeout_s)

    async def wait(self, duration_s: float) -> None:
        """Let time pass.

        Args:
            duration_s: seconds, of vehicle time.

        Raises:
            ConfigError: the duration is negative, infinite or no number.
        """
        self.ground.check_not_ended()
        check_duration(duration_s, "wait")
        await asyncio.sleep(duration_s)

    async def countdown(self, at: str | WallTime) -> None:
        """Wait until a wall-clock time; in simulated time, return at once.

        Args:
            at: time such as "21:30:00", which means the next time that a clock shows it, or a time
                with a date; at most some hours ahead.

        Raises:
            ConfigError: the text is not a time, or the time is in the past or too far ahead.
            CountdownEnded: an operator has stopped it, clocks differ, or a clock was set.
        """
        self.ground.check_not_ended()
        start = self._time_of(at)
        if start is not None:
            await self.ground.wait_for_time(start, self.names)

    def _time_of(self, at: str | WallTime) -> WallTime | None:
        """Return a wall-clock time; None if there is no wait for it."""
        if isinstance(at, WallTime):
            return at
        if at == "":
            return None

        check_wall_time(at)
        if self.client.wall_clock.is_simulated:
            self.ground.say(f"Simulated time has no wall clock: {at} counts as now.")
            return None
        return wall_time(at, local_now(self.client.wall_clock.wall_ns))

    async def until(self, condition: WaitCondition, timeout_s: float = 60.0) -> None:
        """Wait until a condition of :mod:`groundstation.missions.conditions` holds.

        Args:
            condition: condition to wait for.
            timeout_s: longest wait [s]; time in which this ground hears no vehicle, or in which an
                operator's pause stops the mission or its paths, does not count. With 0 it only
                looks whether the condition holds now.

        Raises:
            ConditionTimeout: the condition does not hold in time.
            ConfigError: it is no condition, or the timeout is no number.
        """
        self.ground.check_not_ended()
        _check_condition(condition)
        check_timeout(timeout_s, "until")
        client = self.client
        begin_ns = client.now_ns()
        events = EventsOfWait(begin_ns)

        def moment(state: FleetState) -> FleetMoment:
            return FleetMoment(
                state=state,
                now_ns=client.now_ns(),
                begin_ns=begin_ns,
                events=events.until(state),
                left_out=self.ground.left_out,
            )

        def holds(state: FleetState) -> bool:
            return condition.holds(moment(state))

        if holds(client.state):  # whatever the timeout is
            return

        link = self.ground.link
        left_s = timeout_s
        while left_s > 0.0:
            lost_before_s = link.lost_s
            look_ns = client.now_ns()
            if await client.wait_for(holds, min(left_s, _LOOK_S)):
                return
            await link.wait_while_lost()
            if not self.ground.is_paused:
                # A loss is noticed late: it may give back more time than this look has taken.
                lost_s = link.lost_s - lost_before_s
                left_s -= (client.now_ns() - look_ns) * 1e-9 - lost_s

        value = condition.value(moment(client.state))
        raise ConditionTimeout(f"Not {condition.words} within {timeout_s:g} s: {value}.")

    @contextlib.asynccontextmanager
    async def reacting(
        self,
        condition: WaitCondition,
        reaction: Callable[[], object],
        *,
        ends: bool = False,
    ) -> AsyncIterator[None]:
        """React as soon as a condition holds while the block below runs.

        Args:
            condition: condition to watch for.
            reaction: function that is called once, when the condition holds; a coroutine function
                is awaited. It runs alongside the block, which waits for it at its end. An exception
                in either of them ends both, and is raised.
            ends: whether the block is cancelled before the reaction; the mission goes on after it.

        Raises:
            ConfigError: the condition is none, or the reaction is no function.
        """
        self.ground.check_not_ended()
        _check_condition(condition)
        _check_reaction(reaction)
        body = asyncio.current_task()  # runs the block
        assert body is not None
        has_begun = False  # whether the condition has held, and the reaction has begun
        lost: Mapping[str, str] = {}  # vehicle -> reason, when the condition held

        def holds(moment: FleetMoment) -> bool:
            nonlocal lost
            if not condition.holds(moment):
                return False
            lost = condition.lost(moment)
            return True

        async def react() -> None:
            result = reaction()
            if inspect.isawaitable(result):
                await result

        async def watch() -> None:
            nonlocal has_begun
            await self.until(condition._replace(holds=holds), _EVER_S)
            has_begun = True
            self.ground.say(f"{capitalised(condition.words)}.")
            self.ground.note_lost(lost)

            if ends:
                body.cancel()
            else:
                await react()

        try:
            async with asyncio.TaskGroup() as tasks:
                watching = tasks.create_task(watch())
                try:
                    yield
                except asyncio.CancelledError:
                    # Swallow this only if the watch alone has cancelled the block. `uncancel`
                    # returns how many other cancellations were requested.
                    was_broken_off = ends and has_begun
                    if not was_broken_off or body.uncancel() > 0:
                        raise
                finally:
                    # A reaction that has begun is not cut short by the end of the block.
                    if not has_begun:
                        watching.cancel()
        except BaseExceptionGroup as failures:
            raise failures.exceptions[0] from None  # it has ended the others

        if ends and has_begun:
            await react()
