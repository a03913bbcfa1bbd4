"""Crazyswarm's blocking script interface: commands return at once, ``timeHelper.sleep`` waits.

All commands of a kind between two sleeps are one order: several ``goTo`` are checked together, so
vehicles may change places. The script's clock stands still while a vehicle is late. A take-off or a
landing may take longer than the script says; the ``sleep`` then ends later, after the order.
"""

from __future__ import annotations

import math
import select
import sys
from collections.abc import Callable, Sequence
from pathlib import Path as FilePath
from typing import Any, NoReturn

import numpy as np

from groundstation.crazyswarm.orders import ScriptOrders
from groundstation.crazyswarm.script_check import (
    NOT_FLOWN,
    longest_timescale,
    refuse_too_small_a_fleet,
    refuse_unknown_ids,
    refuse_what_is_not_flown,
)
from groundstation.crazyswarm.uav_trajectory import path_of_trajectory, refuse_unflyable_trajectory
from groundstation.missions.argument_checks import (
    as_position,
    as_scalar,
    check_duration,
    check_number,
)
from groundstation.missions.blocking import BlockingFleet
from groundstation.missions.connection import call_after_last_line
from groundstation.orders.grammar import OrderError
from groundstation.paths.pieces import backwards, moved, slowed
from onboard.arrays import Array
from onboard.bus.schema import Light
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.control.path import Path, point_at

_PRESSED_AFTER_S = 2.0  # time after which a button counts as pressed if there is no terminal


class Crazyswarm:
    """The fleet under Crazyswarm's names.

    Args:
        crazyflies_yaml: a fleet file (``.toml``). In a file or text of Crazyswarm only the number
            of vehicles counts; ``covey fly script --fleet`` names the fleet file.
        parent_parser: not used.
        args: not used.
        fleet: a fleet file or its path; None: the fleet of ``covey fly script``.

    Raises:
        ConfigError: there is no valid fleet file, the fleet is too small, or the script calls a
            command that is not flown or uses vehicles that the fleet does not have.
        NotReady: a vehicle is not ready in time.
    """

    def __init__(
        self,
        crazyflies_yaml: str | None = None,
        parent_parser: object = None,
        args: object = None,
        *,
        fleet: FleetConfig | str | FilePath | None = None,
    ) -> None:
        if not fleet and crazyflies_yaml is not None and crazyflies_yaml.endswith(".toml"):
            fleet = crazyflies_yaml

        # The script is the file that calls this.
        script = sys._getframe(1).f_code.co_filename
        refuse_what_is_not_flown(script)
        orders = ScriptOrders(BlockingFleet(fleet or None))
        refuse_too_small_a_fleet(crazyflies_yaml, orders.fleet.config)
        refuse_unknown_ids(script, orders.fleet.config)

        self.timeHelper = TimeHelper(orders)
        self.allcfs = CrazyflieServer(orders, longest_timescale(script))
        self.input = Buttons(self.timeHelper)
        call_after_last_line(orders.finish)


class TimeHelper:
    """The script's clock."""

    def __init__(self, orders: ScriptOrders) -> None:
        self._orders = orders
        self.visualizer = Visualizer()

    def time(self) -> float:
        """Return the script's time [s]: vehicle time without the lateness of vehicles."""
        return self._orders.time_s

    def sleep(self, duration: float) -> None:
        """Let time pass, and wait for orders that should have ended by then.

        Args:
            duration: time on the script's clock [s]; a negative one counts as 0.

        Raises:
            ConfigError: it is no finite number.
            OrderFailed: a vehicle did not do what was ordered.
        """
        duration = as_scalar(duration)
        check_number(duration, "sleep", "seconds")
        self._orders.pass_time(max(0.0, float(duration)), waits_for_moves=True)

    def sleepForRate(self, rateHz: float) -> None:
        """Let one period of a rate pass, without waiting for moves.

        Args:
            rateHz: the rate [Hz].

        Raises:
            ConfigError: it is no finite number above 0.
        """
        rateHz = as_scalar(rateHz)
        check_number(rateHz, "sleepForRate", "hertz")
        if rateHz <= 0.0:
            raise OrderError(f"sleepForRate: {rateHz:g} Hz is no rate. Give one above 0.")
        self._orders.pass_time(1.0 / rateHz, waits_for_moves=False)

    def isShutdown(self) -> bool:
        """Return False: Ctrl-C ends the program by an exception, and the vehicles land."""
        return False


class Visualizer:
    """``timeHelper.visualizer``: accepts every call and draws nothing.

    Crazyswarm's visualizer has methods for graphs, ellipsoids and frames. Covey draws in the
    console and on the page.
    """

    def __getattr__(self, name: str) -> Any:
        return self._draw_nothing

    def _draw_nothing(self, *_: object, **__: object) -> None:
        """Draw nothing."""


class Buttons:
    """``swarm.input``: the Enter key; without a terminal it counts as pressed after two seconds."""

    def __init__(self, clock: TimeHelper) -> None:
        self._clock = clock
        self._since_s = math.nan  # time of the first question since the last press; NaN: none
        self._has_terminal = sys.stdin is not None and sys.stdin.isatty()

    def checkIfButtonIsPressed(self) -> bool:
        """Return whether Enter has been pressed."""
        self._clock.sleep(0.0)

        if self._has_terminal:
            readable, _, _ = select.select([sys.stdin], [], [], 0.0)
            if not readable:
                return False
            sys.stdin.readline()
            return True

        if math.isnan(self._since_s):
            self._since_s = self._clock.time()
        if self._clock.time() - self._since_s < _PRESSED_AFTER_S:
            return False
        self._since_s = math.nan
        return True

    def waitUntilButtonPressed(self) -> None:
        """Wait for Enter."""
        while not self.checkIfButtonIsPressed():
            self._clock.sleep(0.1)

    waitUntilAnyButtonPressed = waitUntilButtonPressed
    checkIfAnyButtonIsPressed = checkIfButtonIsPressed


class Crazyflie:
    """One vehicle under Crazyswarm's names; lengths in metres, times in seconds, yaw in radians.

    Args:
        orders: orders of the script.
        vehicle: entry of the vehicle in the fleet file.
        longest_timescale: largest timescale with which the script starts trajectories; None if it
            is not known.
    """

    def __init__(
        self, orders: ScriptOrders, vehicle: Vehicle, longest_timescale: float | None = None
    ) -> None:
        self._orders = orders
        self._longest_timescale = longest_timescale
        self._name = vehicle.name
        self.id: int = vehicle.system_id
        self.name = vehicle.name
        self.initialPosition: Array = np.array(vehicle.start_enu_m)
        self.groupMask = 0
        self._trajectories: dict[int, Path] = {}

    def setGroupMask(self, groupMask: int) -> None:
        """Set the groups of this vehicle; each bit is a group."""
        self.groupMask = int(groupMask)

    def arm(self, arm: bool = True) -> None:
        """Arm on the ground, or disarm there; a take-off arms by itself.

        Raises:
            OrderError: the vehicle flies, and would fall if it were disarmed.
        """
        if arm:
            self._orders.arm(self._name)
        else:
            self._orders.stop(self._name)

    def takeoff(self, targetHeight: float, duration: float, groupMask: int = 0) -> None:
        """Arm and take off to a height above the fleet's origin.

        Raises:
            ConfigError: a value is no finite number.
        """
        targetHeight = as_scalar(targetHeight)
        check_number(targetHeight, "takeoff", "metres")
        duration = as_scalar(duration)
        check_duration(duration, "takeoff")
        if self._is_meant(groupMask):
            self._orders.takeoff(self._name, float(targetHeight), float(duration))

    def land(self, targetHeight: float, duration: float, groupMask: int = 0) -> None:
        """Land on the ground and disarm; the given height is not used.

        Raises:
            ConfigError: the duration is no finite number.
        """
        duration = as_scalar(duration)
        check_duration(duration, "land")
        if self._is_meant(groupMask):
            self._orders.land(self._name, float(duration))

    def stop(self, groupMask: int = 0) -> None:
        """Disarm on the ground.

        Raises:
            OrderError: the vehicle flies, and would fall.
        """
        if self._is_meant(groupMask):
            self._orders.stop(self._name)

    def goTo(
        self,
        goal: Sequence[float],
        yaw: float,
        duration: float,
        relative: bool = False,
        groupMask: int = 0,
    ) -> None:
        """Go to a goal; all goals between two sleeps are checked together.

        Raises:
            ConfigError: a value is no finite number, or the goal is not three of them.
        """
        x, y, z = as_position(goal, "goTo")
        yaw = as_scalar(yaw)
        check_number(yaw, "goTo", "radians")
        duration = as_scalar(duration)
        check_duration(duration, "goTo")
        if not self._is_meant(groupMask):
            return

        yaw_deg = math.degrees(float(yaw))
        if relative:
            (spot_x, spot_y, spot_z), spot_yaw_deg = self._orders.spot(self._name)
            x = spot_x + x
            y = spot_y + y
            z = spot_z + z
            yaw_deg = spot_yaw_deg + yaw_deg
        self._orders.go_to(self._name, (x, y, z), yaw_deg, float(duration))

    def uploadTrajectory(self, trajectoryId: int, pieceOffset: int, trajectory: Any) -> None:
        """Keep a trajectory for :meth:`startTrajectory`, which sends it to the vehicle.

        Raises:
            OrderError: the trajectory is too fast for the vehicle, or jumps between two pieces,
                even with the longest timescale in the script.
        """
        path = path_of_trajectory(trajectory)
        if self._longest_timescale is not None:
            refuse_unflyable_trajectory(
                path, self._longest_timescale, self._name, self._orders.fleet.config
            )
        self._trajectories[trajectoryId] = path

    def startTrajectory(
        self,
        trajectoryId: int,
        timescale: float = 1.0,
        reverse: bool = False,
        relative: bool = True,
        groupMask: int = 0,
    ) -> None:
        """Follow a trajectory; all trajectories between two sleeps begin at one instant.

        Raises:
            OrderError: there is no such trajectory.
        """
        if not self._is_meant(groupMask):
            return
        if trajectoryId not in self._trajectories:
            known = ", ".join(map(repr, self._trajectories)) or "none"
            raise OrderError(
                f"{self._name} has no trajectory {trajectoryId!r}; it has {known}. Upload it first."
            )

        path = slowed(self._trajectories[trajectoryId], float(timescale))
        if reverse:
            path = backwards(path)
        if relative:
            begin_x, begin_y, begin_z = point_at(path, 0.0).position_enu_m
            (spot_x, spot_y, spot_z), _ = self._orders.spot(self._name)
            offset = (spot_x - begin_x, spot_y - begin_y, spot_z - begin_z, 0.0)  # the same yaw
            path = moved(path, np.array(offset))
        self._orders.follow(self._name, path)

    def position(self) -> Array:
        """Return the reported position."""
        return np.array(self._orders.position(self._name))

    def setLEDColor(self, r: float, g: float, b: float) -> None:
        """Show and record a colour, each share from 0 to 1; no lamp of a vehicle gets it.

        Raises:
            ConfigError: a share is no finite number.
        """
        client = self._orders.fleet.client
        message = Light(
            vehicle=self._name,
            stamp_ns=client.now_ns(),
            colour=(_colour_byte(r), _colour_byte(g), _colour_byte(b)),
        )
        client.tell(Topic.LIGHT, self._name, message)

    def setParam(self, name: str, value: float) -> None:
        """Do nothing, because a Crazyflie's parameters mean nothing to PX4."""

    setParams = setParam

    def enableCollisionAvoidance(
        self, others: object = None, ellipsoidRadii: object = None
    ) -> None:
        """Do nothing: the law is always on, with ``safety_distance_m`` of the fleet file."""

    def disableCollisionAvoidance(self) -> None:
        """Do nothing: the law stays on; in simulation ``--law off`` flies without."""

    def notifySetpointsStop(self, remainValidMillisecs: float = 100, groupMask: int = 0) -> None:
        """Do nothing, because no setpoints are streamed."""

    def __getattr__(self, name: str) -> Callable[..., NoReturn]:
        """Return a method that refuses a command which is not flown.

        The check before the flight finds most of them, but not calls by a computed name.
        """
        if name not in NOT_FLOWN:
            raise AttributeError(
                f"A Crazyflie has no '{name}' here; docs/crazyswarm.md lists what there is."
            )

        def refuse(*_: object, **__: object) -> NoReturn:
            raise OrderError(f"{self._name}: {name} is refused: {NOT_FLOWN[name]}")

        return refuse

    def _is_meant(self, group_mask: int) -> bool:
        return group_mask == 0 or bool(group_mask & self.groupMask)


def _colour_byte(share: float) -> int:
    """Return a colour's share from 0 to 1 as a byte."""
    share = as_scalar(share)
    check_number(share, "setLEDColor", "parts of full brightness")
    return round(255 * min(max(float(share), 0.0), 1.0))


class _VehiclesByKey(dict[Any, Crazyflie]):
    """Vehicles by id or by name; another key raises an error that names those there are.

    Args:
        noun: word for the kind of key, for the sentence.
        key: key in the fleet file that defines it, for the sentence.
        vehicles: vehicle of each key.
    """

    def __init__(self, noun: str, key: str, vehicles: dict[Any, Crazyflie]) -> None:
        super().__init__(vehicles)
        self._noun = noun
        self._key = key

    def __missing__(self, wanted: object) -> NoReturn:
        known = ", ".join(map(str, self))
        raise OrderError(
            f"The fleet has no vehicle with {self._noun} {wanted}; it has {known}. Write these in "
            f"the script, or give {self._key} in the fleet file."
        )


class CrazyflieServer:
    """``swarm.allcfs``: all vehicles, and commands to groups of them.

    Args:
        orders: orders of the script.
        longest_timescale: see :class:`Crazyflie`.
    """

    def __init__(self, orders: ScriptOrders, longest_timescale: float | None = None) -> None:
        self._orders = orders
        config = orders.fleet.config
        self.crazyflies = [
            Crazyflie(orders, config.vehicles[name], longest_timescale)
            for name in config.enabled_names
        ]
        self.crazyfliesById = _VehiclesByKey(
            "id", "system_id of a vehicle", {vehicle.id: vehicle for vehicle in self.crazyflies}
        )
        self.crazyfliesByName = _VehiclesByKey(
            "name", "[vehicles.NAME]", {vehicle.name: vehicle for vehicle in self.crazyflies}
        )

    def arm(self, arm: bool = True) -> None:
        """Arm all vehicles on the ground, or disarm them there."""
        for vehicle in self.crazyflies:
            vehicle.arm(arm)

    def takeoff(self, targetHeight: float, duration: float, groupMask: int = 0) -> None:
        """Let all vehicles of a group take off (0: all)."""
        for vehicle in self.crazyflies:
            vehicle.takeoff(targetHeight, duration, groupMask)

    def land(self, targetHeight: float, duration: float, groupMask: int = 0) -> None:
        """Land all vehicles of a group (0: all)."""
        for vehicle in self.crazyflies:
            vehicle.land(targetHeight, duration, groupMask)

    def stop(self, groupMask: int = 0) -> None:
        """Disarm all vehicles of a group on the ground (0: all)."""
        for vehicle in self.crazyflies:
            vehicle.stop(groupMask)

    def goTo(self, goal: Sequence[float], yaw: float, duration: float, groupMask: int = 0) -> None:
        """Move all vehicles of a group by an offset (0: all)."""
        for vehicle in self.crazyflies:
            vehicle.goTo(goal, yaw, duration, relative=True, groupMask=groupMask)

    def startTrajectory(
        self,
        trajectoryId: int,
        timescale: float = 1.0,
        reverse: bool = False,
        relative: bool = True,
        groupMask: int = 0,
    ) -> None:
        """Let all vehicles of a group follow their trajectories from one instant on (0: all)."""
        for vehicle in self.crazyflies:
            vehicle.startTrajectory(trajectoryId, timescale, reverse, relative, groupMask)

    def emergency(self) -> None:
        """Stop the motors of all at once, even in the air: they fall.

        Later commands to arm or to fly are refused.
        """
        self._orders.kill_all()

    def setParam(self, name: str, value: float) -> None:
        """Do nothing, because a Crazyflie's parameters mean nothing to PX4."""
