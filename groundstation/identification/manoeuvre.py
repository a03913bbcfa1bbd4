"""The manoeuvre from which a vehicle is identified: quick and slow moves in a box."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from onboard.config.fleet import ConfigError, FleetConfig, parking_distance_m
from onboard.config.flight_space import flight_space_of
from onboard.tuples import Xyz

BOX_M = 0.6  # half width of the box
HEIGHT_M = 1.0
MOVE_COUNT = 14
_FENCE_M = 0.4  # distance that the box keeps from the fence, for the overshoot of a quick move
_CEILING_M = 0.3  # the same below the ceiling
_MIN_HEIGHT_M = 0.4  # lower flights are of no use: the ground may bear a part of the weight
_MIN_HALF_M = 0.25  # in a smaller box nothing tilts enough to be measured
_SLOW_S = 3.5  # duration of every third move
_MOVE_TIMEOUT_S = 8.0
_LEG_S = 2.2  # each move is flown at least this long


def manoeuvre(
    fleet: FleetConfig,
    name: str,
    *,
    half_m: float = BOX_M,
    height_m: float = HEIGHT_M,
    seed: int = 0,
) -> tuple[tuple[Xyz, float], ...]:
    """Return goals and durations [s] of a zigzag in a box about the vehicle's start.

    The box keeps a distance from the fence and from the spots of the other vehicles. A duration of
    0 means as fast as the limits allow.

    Args:
        fleet: the fleet file.
        name: name of the vehicle.
        half_m: largest half width of the box.
        height_m: height of the manoeuvre.
        seed: the seed of its random lengths.

    Raises:
        ConfigError: there is no room for a box of 0.25 m to each side, or the ceiling is too low.
    """
    x, y, _ = fleet.vehicles[name].start_enu_m

    # room to the other vehicles, which stand on their spots and do not give way
    others = [fleet.vehicles[other].start_enu_m for other in fleet.enabled_names if other != name]
    nearest_m = min((math.dist((x, y), other[:2]) for other in others), default=math.inf)
    apart_m = nearest_m - (parking_distance_m(fleet) + fleet.law.uncooperative_margin_m)

    west, east = fleet.fleet.geofence_m.x
    south, north = fleet.fleet.geofence_m.y
    _, ceiling = fleet.fleet.geofence_m.z
    room_m = min(x - west, east - x, y - south, north - y) - _FENCE_M
    to_area_m, _ = flight_space_of(fleet).room_m((x, y, height_m))
    room_m = min(room_m, to_area_m - _FENCE_M)
    # areas may have edges in any direction, so there the corners of the box must fit, too
    corner_factor = 1.0
    if math.isfinite(to_area_m):
        corner_factor = math.sqrt(2.0)
    half_m = min(half_m, room_m / corner_factor, apart_m)
    if not half_m >= _MIN_HALF_M:
        raise ConfigError(
            f"{fleet.path}: around the start of {name} there are {max(0.0, half_m):.2f} m to each "
            "side, the manoeuvre needs 0.25 m beside fence and neighbours. Move the start, or "
            "widen the fence."
        )

    height_m = min(height_m, ceiling - _CEILING_M)
    if not height_m >= _MIN_HEIGHT_M:
        raise ConfigError(
            f"{fleet.path}: below the fence's ceiling at {ceiling:.2f} m the manoeuvre of {name} "
            f"would fly at {height_m:.2f} m; below {_MIN_HEIGHT_M:g} m the ground disturbs it. "
            f"Raise the ceiling to {_MIN_HEIGHT_M + _CEILING_M:g} m or more."
        )
    rng = np.random.default_rng(seed)
    steps: list[tuple[Xyz, float]] = []
    for index in range(MOVE_COUNT):
        reach_m = half_m * float(rng.uniform(0.7, 1.0))
        if index % 2 == 1:
            reach_m = -reach_m

        # two moves along x, then two along y
        goal_x = x
        goal_y = y
        if (index // 2) % 2 == 0:
            goal_x += reach_m
        else:
            goal_y += reach_m

        is_slow = index % 3 == 2
        duration_s = 0.0
        if is_slow:
            duration_s = _SLOW_S
        steps.append(((round(goal_x, 3), round(goal_y, 3), height_m), duration_s))
    return tuple(steps)


def mission_text(fleet_path: Path, name: str, steps: Sequence[tuple[Xyz, float]]) -> str:
    """Return the manoeuvre as the text of a Python mission.

    A goal that is not reached in time is not a failure; the mission goes on with the next one.
    """
    first_goal, _ = steps[0]
    height_m = first_goal[2]
    listed = "".join(f"    {step!r},\n" for step in steps)
    return f'''"""Identification of {name}: quick and slow moves about its start."""

from groundstation.missions.api import OrderFailed
from groundstation.orders.intents import Move

FLEET = {str(fleet_path)!r}
EXPECT = {{"all_landed": True}}
STEPS = [
{listed}]


async def mission(fleet):
    vehicle = fleet[{name!r}]
    await vehicle.takeoff({height_m!r})
    for goal, duration_s in STEPS:
        intent = Move(vehicles=(vehicle.name,), position_enu_m=goal, duration_s=duration_s)
        fleet.say(str(intent))
        begin_ns = fleet.client.now_ns()
        results = await (await fleet.client.submit(intent)).wait({_MOVE_TIMEOUT_S!r})
        if results[vehicle.name].phase not in ("done", "unfinished"):
            raise OrderFailed(intent, results)
        # where PX4's estimate says too early that it has arrived, the leg is flown to its end
        flown_s = 1e-9 * (fleet.client.now_ns() - begin_ns)
        await fleet.wait(max(0.0, max(duration_s, {_LEG_S!r}) - flown_s))
    await fleet.wait(2.0)
    await vehicle.land()
'''
