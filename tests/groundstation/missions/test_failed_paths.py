"""Paths that are not followed to the end: the step fails, or the mission goes on without some."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import pytest

from groundstation.missions.ground import MissionGround
from groundstation.missions.path_following import follow_paths
from groundstation.orders.result import OrderFailed, Results
from onboard.config.fleet import FleetConfig
from tests.groundstation.conftest import FakeBus
from tests.groundstation.missions.test_path_begins import begin_above_the_starts

ALL = ("mav0", "mav1", "mav2")


class Flight:
    """Vehicles that all start along their paths; some of them arrive, and some leave."""

    def __init__(self, fleet: FleetConfig, bus: FakeBus, client: Any) -> None:
        self.lines: list[str] = []
        self.ground = MissionGround(client, say=self._say)
        self._bus = bus
        self._paths = begin_above_the_starts(fleet, bus)
        self._arrived: Collection[str] = ()
        self._failed: Collection[str] = ()
        bus.accept_only = {"follow_path"}

    async def follow(
        self,
        names: Sequence[str] = ALL,
        *,
        arrived: Collection[str] = (),
        failed: Collection[str] = (),
    ) -> Results:
        self._arrived = arrived
        self._failed = failed
        paths = {name: self._paths[name] for name in names}
        return await follow_paths(self.ground, paths, lights={}, on_lag="land", timeout_s=0.25)

    def _say(self, line: str) -> None:
        self.lines.append(line)
        if not line.startswith("follow_path"):
            return
        for name, order in self._bus.orders:
            if order.kind == "follow_path" and name in self._arrived:
                self._bus._end(name, order, "")
            elif order.kind == "follow_path" and name in self._failed:
                self._bus._end(name, order, "fail")


@pytest.fixture
def flight(fleet: FleetConfig, bus: FakeBus, client: Any) -> Flight:
    return Flight(fleet, bus, client)


@pytest.mark.parametrize("arrived", [(), ("mav0",)])
async def test_the_step_fails_when_the_users_time_is_over(
    flight: Flight, arrived: Sequence[str]
) -> None:
    with pytest.raises(OrderFailed, match=r"mav2 unfinished: not finished within 0\.25 s"):
        await flight.follow(arrived=arrived)
    assert "  mav1 unfinished: not finished within 0.25 s (the order was accepted)." in flight.lines


async def test_the_step_fails_when_all_have_left_their_paths(flight: Flight) -> None:
    with pytest.raises(OrderFailed, match="The motor is weak") as error:
        await flight.follow(failed=ALL)
    assert {result.phase for result in error.value.results.values()} == {"failed"}


async def test_the_others_go_on_when_one_has_left_its_path(flight: Flight) -> None:
    results = await flight.follow(arrived=ALL[1:], failed=["mav0"])
    assert [name for name, result in results.items() if result.is_done] == ["mav1", "mav2"]
    assert flight.ground.left_out == set()


async def test_a_mission_that_goes_on_leaves_out_who_has_not_arrived(flight: Flight) -> None:
    flight.ground.goes_on_without = True
    await flight.follow(arrived=["mav0"], failed=["mav1"])
    assert flight.ground.left_out == {"mav1", "mav2"}
    assert "The mission goes on without mav1, mav2." in flight.lines
    with pytest.raises(OrderFailed):
        await flight.follow(["mav0"], failed=["mav0"])
