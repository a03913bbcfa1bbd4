"""The manoeuvre from which a vehicle is identified: a zig-zag of quick and slow moves in a box
about its start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from onboard.config.fleet import ConfigError, FleetConfig, Vec3, parking_distance_m

BOX_M, HEIGHT_M, MOVES = 0.6, 1.0, 14
_MOVE_TIMEOUT_S, _LEG_S = 8.0, 2.2


def manoeuvre(
    fleet: FleetConfig,
    name: str,
    *,
    half_m: float = BOX_M,
    height_m: float = HEIGHT_M,
    seed: int = 0,
) -> tuple[tuple[Vec3, float], ...]:
    """Goals and durations (0: as quick as the limits allow) of a zig-zag in a box about the
    vehicle's start.

    The box keeps clear of the fence and of the places where the others stand.

    Raises:
        ConfigError: there is no room for a box of 0.25 m to each side.
    """
    x, y, _ = fleet.vehicles[name].start_enu_m
    fence = fleet.fleet.geofence_m
    others = [fleet.vehicles[other].start_enu_m for other in fleet.enabled_names if other != name]
    apart_m = min((math.dist((x, y), other[:2]) for other in others), default=math.inf)
    apart_m -= parking_distance_m(fleet) + fleet.law.uncooperative_margin_m
    room_m = min(x - fence.x[0], fence.x[1] - x, y - fence.y[0], fence.y[1] - y) - 0.4
    half_m = min(half_m, room_m, apart_m)
    if not half_m >= 0.25:
        raise ConfigError(
            f"{fleet.path}: around the start of {name} there are {max(0.0, half_m):.2f} m to each side, the manoeuvre "
            "needs 0.25 m beside fence and neighbours. Move the start, or widen the fence."
        )
    height_m = min(height_m, fence.z[1] - 0.3)
    rng = np.random.default_rng(seed)
    steps: list[tuple[Vec3, float]] = []
    for index in range(MOVES):
        reach = half_m * float(rng.uniform(0.7, 1.0)) * (1.0 if index % 2 == 0 else -1.0)
        along_x = (index // 2) % 2 == 0
        goal = (round(x + reach * along_x, 3), round(y + reach * (not along_x), 3), height_m)
        steps.append((goal, 3.5 if index % 3 == 2 else 0.0))
    return tuple(steps)


def mission_text(fleet_path: Path, name: str, steps: Sequence[tuple[Vec3, float]]) -> str:
    """The manoeuvre as a mission file in Python: a goal that is not reached in time is no failure,
    but the next one.
    """
    height_m, listed = steps[0][0][2], "".join(f"    {step!r},\n" for step in steps)
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
        # where PX4's estimate says so early that it has arrived, the leg is flown to its end all the same
        await fleet.wait(max(0.0, max(duration_s, {_LEG_S!r}) - 1e-9 * (fleet.client.now_ns() - begin_ns)))
    await fleet.wait(2.0)
    await vehicle.land()
'''
