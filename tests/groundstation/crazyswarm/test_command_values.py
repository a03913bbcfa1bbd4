"""Values of Crazyswarm's commands that mean nothing are refused where a script gives them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from groundstation.crazyswarm.swarm import Crazyflie, TimeHelper
from onboard.config.fleet import ConfigError, load_fleet

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"

WRONG: dict[str, tuple[Callable[[Any, Any], object], str]] = {
    "sleep": (lambda one, clock: clock.sleep(math.nan), "sleep: nan is no finite number"),
    "rate": (lambda one, clock: clock.sleepForRate(0), "sleepForRate: 0 Hz is no rate"),
    "height": (lambda one, clock: one.takeoff(math.nan, 2.0), "takeoff: nan is no finite number"),
    "landing": (lambda one, clock: one.land(0.04, math.nan), "land: nan is no duration"),
    "goal of two": (lambda one, clock: one.goTo([0, 0], 0, 2.0), r"goTo: \[0, 0\] is not three"),
    "no goal": (lambda one, clock: one.goTo(None, 0, 2.0), "goTo: None is not three"),
    "yaw": (lambda one, clock: one.goTo([0, 0, 1], math.inf, 2.0), "goTo: inf is no finite"),
    "duration": (lambda one, clock: one.goTo([0, 0, 1], 0, -1.0), "goTo: -1.0 is no duration"),
    "colour": (lambda one, clock: one.setLEDColor(math.nan, 0, 0), "setLEDColor: nan is no finite"),
    "id": (lambda one, clock: one.startTrajectory("0"), r"no trajectory '0'; it has 0\."),
}


@pytest.fixture
def sent() -> list[tuple[Any, ...]]:
    return []


@pytest.fixture
def orders(sent: list[tuple[Any, ...]]) -> Any:
    def note(*values: Any, **_: Any) -> None:
        sent.append(values)

    client = SimpleNamespace(now_ns=lambda: 0, tell=note)
    return SimpleNamespace(
        takeoff=note,
        land=note,
        go_to=note,
        follow=note,
        pass_time=note,
        fleet=SimpleNamespace(client=client),
    )


@pytest.mark.parametrize(("command", "words"), WRONG.values(), ids=WRONG)
def test_a_value_that_means_nothing_is_refused_and_nothing_is_ordered(
    orders: Any,
    sent: list[tuple[Any, ...]],
    command: Callable[[Any, Any], object],
    words: str,
) -> None:
    one: Any = Crazyflie(orders, load_fleet(PAPER).vehicles["mav0"])
    one._trajectories[0] = None
    with pytest.raises(ConfigError, match=words):
        command(one, TimeHelper(orders))
    assert sent == []


def test_numbers_of_numpy_are_numbers(orders: Any, sent: list[tuple[Any, ...]]) -> None:
    one: Any = Crazyflie(orders, load_fleet(PAPER).vehicles["mav0"])
    one.goTo(np.array([1, 2, 1]), np.float32(0.0), np.int64(3))
    one.takeoff(np.float32(1.0), np.float64(2.0))
    TimeHelper(orders).sleep(np.float64(2.5))
    assert sent == [("mav0", (1.0, 2.0, 1.0), 0.0, 3.0), ("mav0", 1.0, 2.0), (2.5,)]


def test_an_array_of_dimension_0_is_a_number(orders: Any, sent: list[tuple[Any, ...]]) -> None:
    one: Any = Crazyflie(orders, load_fleet(PAPER).vehicles["mav0"])
    one.goTo([np.array(1.0), np.array(2), 1.0], np.array(0.0), np.array(3.0))
    one.takeoff(np.array(1.0), np.array(2.0))
    clock: Any = TimeHelper(orders)
    clock.sleep(np.array(2.5))
    assert sent == [("mav0", (1.0, 2.0, 1.0), 0.0, 3.0), ("mav0", 1.0, 2.0), (2.5,)]

    with pytest.raises(ConfigError, match="sleep: nan is no finite number"):
        clock.sleep(np.array(np.nan))
