"""Vehicles as arguments of verbs: names, indices, lists and generators; nothing means nobody."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from groundstation.missions.api import Fleet
from groundstation.missions.conditions import FleetMoment, landed
from onboard.config.fleet import ConfigError


@pytest.fixture
async def flown(client: Any) -> Fleet:
    """A fleet of mav0, mav1 and mav2, which fly."""
    fleet = Fleet(client)
    await fleet.takeoff(1.0)
    return fleet


@pytest.mark.parametrize("verb", ["hold", "home", "land", "kill", "disarm"])
@pytest.mark.parametrize(
    "name_them",
    [
        lambda names: (name for name in names if name == "mav1"),
        lambda names: filter(lambda name: name == "mav1", names),
        lambda names: iter(["1"]),
        lambda names: 1,
        lambda names: [1],
        lambda names: range(1, 2),
    ],
)
async def test_a_generator_and_an_index_mean_the_vehicles_that_they_name(
    flown: Fleet, verb: str, name_them: Callable[[Any], Any]
) -> None:
    if verb == "disarm":
        await flown.land()
    assert list(await getattr(flown, verb)(name_them(flown.names))) == ["mav1"]


async def test_a_generator_that_means_all_is_an_order_to_all(flown: Fleet, bus: Any) -> None:
    await flown.land(word for word in ["all"])
    reasons = {order.reason for _, order in bus.orders if order.kind == "land"}
    await flown.takeoff(1.0)
    await flown.land("all")
    assert reasons == {order.reason for _, order in bus.orders if order.kind == "land"}


@pytest.mark.parametrize("verb", ["kill", "land", "hold", "disable", "enable", "group"])
@pytest.mark.parametrize("nobody", ["", " ", [], [""], (), iter(()), ["mav0", ""]])
async def test_an_argument_that_names_nobody_is_refused(
    flown: Fleet, bus: Any, verb: str, nobody: Any
) -> None:
    sent = len(bus.orders)
    with pytest.raises(ConfigError, match=r"list of vehicles is empty|'' is not a vehicle"):
        await getattr(flown, verb)(nobody)
    assert len(bus.orders) == sent


@pytest.mark.parametrize("wrong", [None, True, 1.5, [None], [["mav0"]]])
async def test_what_is_no_name_is_refused_with_its_type(flown: Fleet, wrong: Any) -> None:
    with pytest.raises(ConfigError, match=r"A value of type \w+ names no vehicle\. Give"):
        await flown.land(wrong)
    with pytest.raises(ConfigError, match="type MissionVehicle names no vehicle"):
        await flown.land(flown["mav0"])  # type: ignore[arg-type]


async def test_a_condition_reads_a_generator_of_names_once(flown: Fleet) -> None:
    condition = landed(name for name in flown.names if name == "mav1")
    moment = FleetMoment(flown.state, flown.client.now_ns(), 0)
    assert condition.words == "mav1 landed"
    assert not condition.holds(moment)
    assert not condition.holds(moment)
