"""Values that make no sense are refused in words when a mission gives them, and nothing is sent."""

from __future__ import annotations

import asyncio
import datetime
import math
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from groundstation.missions import conditions
from groundstation.missions.api import Fleet
from onboard.config.fleet import ConfigError

UP = (0.0, 0.0, 1.5)

reached: Any = conditions.reached  # for goals that the type checker would refuse

WRONG: list[tuple[Callable[[Any], Any], str]] = [
    (lambda flown: flown.wait(-5.0), "wait: -5.0 is no duration"),
    (lambda flown: flown.follow("mav0", -3), "follow: -3 is no duration"),
    (lambda flown: flown.follow("mav0", 3, offsets={"mav1": ("a", 0, 0)}), "follow: .* is not"),
    (lambda flown: flown.follow("mav0,mav1", 3), "mav0, mav1 cannot all be followed. Name one"),
    (lambda flown: flown.follow(flown["mav0"], 3), "type MissionVehicle names no vehicle"),
    (lambda flown: flown.follow("mav0", 3, offsets={"mav1": (0, 2)}), "follow: .* is not three"),
    (lambda flown: flown.follow("mav0", 3, offsets={"mav1": (math.nan, 0, 0)}), "follow: .*nan"),
    (lambda flown: flown.fly_through({"mav0": [UP]}, speed_m_s="fast"), "'fast' is no finite"),
    (lambda flown: flown.fly_through({"mav0": [UP]}, speed_m_s=math.nan), "nan is no finite"),
    (lambda flown: flown.fly_through({"mav0": [(0, 0, "1")]}, speed_m_s=1.0), "fly_through: .*'1'"),
    (lambda flown: flown.fly_through({"mav0": 5}, speed_m_s=1.0), "5 is no list of positions"),
    (lambda flown: flown.fly_through({"mav0": UP}, speed_m_s=1.0), "fly_through: 0.0 is not three"),
    (lambda flown: flown.fly_through({"mav0": [UP]}, speed_m_s=1.0, on_lag="slow"), "'slow'"),
    (lambda flown: flown.fly_through([UP], speed_m_s=1.0), "fly_through: .* which vehicle it is"),
    (lambda flown: flown.follow_path({}, on_lag=None), "on_lag is None. Write land or hold"),
    (lambda flown: flown.follow_path({"mav0": "a.csv"}), "'a.csv' is no path for mav0. Read its"),
    (lambda flown: flown.follow_path([1]), "follow_path: .* Give each vehicle its path"),
    (lambda flown: flown.follow_path({}, lights=["a.csv"]), "Give each vehicle its list of lights"),
    (
        lambda flown: flown.follow("mav0", 3, offsets=[UP]),
        "follow: .* which vehicle it is",
    ),
    (lambda flown: flown.follow("mav0", 3, offsets={"1-2": UP}), "names 2 vehicles for one offset"),
    (lambda flown: flown["mav0"].go_to("abc"), "go_to: 'abc' is not three finite numbers"),
    (lambda flown: flown["mav0"].go_to(np.array(1.0)), "go_to: 1.0 is not three finite numbers"),
    (lambda flown: flown["mav0"].go_to(None), "go_to: None is not three finite numbers"),
    (lambda flown: flown.go_to({"mav0": (1.0, 2.0)}), r"go_to: \(1.0, 2.0\) is not three finite"),
    (lambda flown: flown.go_to({"0-1": UP}), "'0-1' names 2 vehicles for one position"),
    (lambda flown: flown.go_to({0: UP, "mav0": UP}), "mav0 has more than one position"),
    (
        lambda flown: flown.fly_through({0: [UP], "mav0": [UP]}, speed_m_s=1.0),
        "mav0 has more than one list of positions",
    ),
    (lambda flown: flown.go_to({("mav0", 1): UP}), "'mav0, 1' names 2 vehicles for one position"),
    (lambda flown: flown.go_to({0.0: UP}), "type float names no vehicle"),
    (lambda flown: flown.move("mav0", UP), "move: 'mav0' is no position, which comes first"),
    (lambda flown: flown.move(0, UP), "move: 0 is no position, which comes first"),
    (lambda flown: flown.go_to({7: UP}), "'7' selects no vehicle: vehicles"),
    (lambda flown: flown.countdown(5), "'5' is no time of day. Write 21:30"),
    (lambda flown: flown.countdown(datetime.time(21)), "'21:00:00' is no time of day"),
    (lambda flown: flown.countdown(None), "'None' is no time of day"),
    (lambda flown: flown.place("48", 8.0, 1.0), "place: '48' is no finite number of degrees"),
    (lambda flown: flown.swap("mav0", "mav0"), "A swap is of two vehicles, .* names mav0"),
    (lambda flown: flown.swap("all", "mav0"), "A swap is of two vehicles"),
    (lambda flown: flown.swap(flown["mav0"], "mav1"), "names no vehicle"),
    (lambda flown: flown.fault("motor_weak", "mav0", after_s="x"), "fault: 'x' is no duration"),
    (lambda flown: flown.fault("motor_weak", "mav0", duration_s=math.nan), "fault: nan is no"),
    (lambda flown: flown.fault("motor_weak", "mav0", motor=[1]), r"fault: motor is \[1\]"),
    (lambda flown: flown.until(conditions.event("killed", "mav9"), 0.1), "'mav9', which is not"),
    (lambda flown: conditions.battery_below(math.nan), "battery_below: nan is no finite number"),
    (lambda flown: conditions.separation_above(math.inf), "separation_above: inf is no"),
    (lambda flown: conditions.separation_below(math.nan), "separation_below: nan is no"),
    (lambda flown: conditions.reached({"mav0": UP}, math.nan), "reached: nan is no"),
    (lambda flown: reached(UP), r"reached: .* Give each vehicle its goal, .*\"mav0\""),
    (lambda flown: flown.until(reached({7: UP}), 0.1), "'7', which is not a vehicle"),
    (lambda flown: flown["mav0"].reached((0, 0, math.nan)), "reached: .*nan"),
]


@pytest.mark.parametrize(("call", "words"), WRONG)
async def test_a_value_that_makes_no_sense_is_refused_in_words_and_nothing_is_sent(
    client: Any, bus: Any, call: Callable[[Fleet], object], words: str
) -> None:
    flown = Fleet(client)
    await flown.takeoff(1.0)
    sent = len(bus.orders)

    async def do_it() -> None:
        result = call(flown)
        if isinstance(result, Awaitable):
            await result

    with pytest.raises(ConfigError, match=words):
        await asyncio.wait_for(do_it(), 5.0)
    assert len(bus.orders) == sent


async def test_positions_and_times_may_be_values_of_numpy(client: Any, bus: Any) -> None:
    flown = Fleet(client)
    await flown.takeoff(1.0)
    await flown.wait(np.float32(0.01))  # type: ignore[arg-type]
    offsets: Any = {"mav1": np.array([0.0, 2.0, 0.0])}
    assert (await flown.follow("mav0", 0.01, offsets=offsets))["mav1"].is_done
    assert await flown["mav2"].reached(bus.vehicles["mav2"].position_enu_m)


async def test_goals_offsets_and_waypoints_are_given_by_index_as_well(
    client: Any, bus: Any
) -> None:
    bus.accept_only = {"follow_path"}
    flown = Fleet(client)
    await flown.takeoff(1.0)
    goals: Any = {1: (0.0, 0.5, 1.0), np.int64(2): (1.5, 0.5, 1.0)}
    await flown.go_to(goals)
    assert bus.vehicles["mav1"].position_enu_m == (0.0, 0.5, 1.0)
    assert bus.vehicles["mav2"].position_enu_m == (1.5, 0.5, 1.0)

    assert (await flown.follow(0, 0.01, offsets={1: (1.5, 0.0, 0.0)}))["mav1"].is_done
    flying = asyncio.create_task(flown.fly_through({2: [(1.5, 1.0, 1.0)]}, speed_m_s=0.5))
    while bus.orders[-1][1].kind != "follow_path":  # noqa: ASYNC110 - the bus sets no Event
        await asyncio.sleep(0.01)
    assert bus.orders[-1][0] == "mav2"
    flying.cancel()
