"""Scripts connect with a flight: what they may order in the end of their connection and after."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from groundstation.client.client import FleetClient
from groundstation.missions import following
from groundstation.missions.api import AtEnd, Fleet
from groundstation.missions.conditions import flying
from groundstation.missions.connection import hosted, run_script
from groundstation.paths.pieces import fitted
from groundstation.verdict.expectations import Expect
from groundstation.verdict.observations import FlightObservations
from groundstation.verdict.verdict import judge
from onboard.config.fleet import ConfigError, FleetConfig


class ClientHost:
    """A flight whose client stays open after the end of a script, as in lockstep."""

    def __init__(self, config: FleetConfig, client: FleetClient) -> None:
        self.config = config
        self.ready_timeout_s = 5.0
        self.say = lambda line: None
        self.flown: FlightObservations | None = None
        self.at_end = "land"
        self._client = client

    @contextlib.asynccontextmanager
    async def opened(self) -> AsyncIterator[FleetClient]:
        """Return the client."""
        yield self._client


@pytest.fixture
def host(fleet: FleetConfig, client: Any) -> Iterator[ClientHost]:
    """The flight with which scripts connect."""
    host: Any = ClientHost(fleet, client)
    with hosted(host):
        yield host


async def _react(flown: Fleet) -> None:
    async with flown.reacting(flying(), flown.hold):
        pass


PATHS = {"mav0": fitted(np.arange(5.0), np.array([[0.0, 0.0, 1.0, 0.0]] * 5))}
VERBS: dict[str, Callable[[Fleet], Awaitable[object]]] = {
    "takeoff": lambda flown: flown.takeoff(1.0),
    "land": lambda flown: flown.land(),
    "go_to": lambda flown: flown["mav0"].go_to((0.0, 0.0, 1.0)),
    "waves": lambda flown: flown.takeoff(1.0, by=1),
    "follow_path": lambda flown: flown.follow_path(PATHS),
    "follow": lambda flown: flown.follow("mav0", 1.0),
    "wait": lambda flown: flown.wait(0.1),
    "countdown": lambda flown: flown.countdown("21:30:00"),
    "until": lambda flown: flown.until(flying(), 0.1),
    "reacting": _react,
    "reached": lambda flown: flown["mav0"].reached((0.0, 0.0, 0.0), timeout_s=0.1),
    "ready": lambda flown: flown.ready(0.1),
    "fault": lambda flown: flown.fault("motor_weak", "mav0"),
    "land_all": lambda flown: flown.land_all(),
    "leave": lambda flown: flown.leave("home"),
}


@pytest.mark.usefixtures("host")
async def test_every_verb_is_refused_after_the_end_of_the_connection(bus: Any) -> None:
    async with Fleet.connect() as flown:
        await flown.takeoff(1.0)
    assert [order.kind for _, order in bus.orders] == ["takeoff"] * 3 + ["land"] * 3

    for verb in VERBS.values():
        with pytest.raises(ConfigError, match="The script's flight has ended"):
            await verb(flown)
    assert len(bus.orders) == 6
    assert flown["mav0"].position_enu_m is not None, "what is known can still be read"


@pytest.mark.parametrize("at_end", ["hover", "Home", None, ["land"]])
async def test_a_state_at_the_end_that_does_not_exist_is_refused_before_a_script_connects(
    host: ClientHost, client: FleetClient, bus: Any, at_end: Any
) -> None:
    words = r"at_end is .*\. Write land, hold or home\."
    with pytest.raises(ConfigError, match=words):
        async with Fleet.connect(at_end=at_end):
            raise AssertionError("it has connected")
    with pytest.raises(ConfigError, match=words):
        await Fleet(client).leave(at_end)
    assert (host.flown, bus.orders) == (None, [])


async def _more_orders(bus: Any) -> None:
    """Wait for an order after the one to take off."""
    while len(bus.orders) == len(bus.vehicles):  # noqa: ASYNC110 - the bus sets no Event
        await asyncio.sleep(0.0)


MOVES = ("takeoff", "land", "go_to", "waves", "follow_path", "follow", "land_all", "leave")


@pytest.mark.parametrize("at_end", ["land", "home", "hold"])
@pytest.mark.usefixtures("host")
async def test_tasks_of_a_script_order_nothing_while_its_end_lands_vehicles_or_holds_them(
    bus: Any, at_end: AtEnd
) -> None:
    async def order_late(flown: Fleet, verb: str) -> object:
        await _more_orders(bus)
        return await VERBS[verb](flown)

    async with Fleet.connect(at_end=at_end) as flown:
        await flown.takeoff(1.0)
        tasks = [asyncio.create_task(order_late(flown, verb)) for verb in MOVES]

    refusals = await asyncio.gather(*tasks, return_exceptions=True)
    assert all("The script's flight has ended" in str(refusal) for refusal in refusals), refusals
    kinds = {"land": ["land"], "home": ["move", "land"], "hold": ["hold"]}[at_end]
    ordered = [order.kind for _, order in bus.orders[3:]]
    assert ordered == [kind for kind in kinds for _ in bus.vehicles]


@pytest.mark.usefixtures("host")
async def test_whoever_watches_a_script_may_kill_a_vehicle_while_the_others_are_landed(
    bus: Any,
) -> None:
    async with Fleet.connect() as flown:
        await flown.takeoff(1.0)
        bus.misbehave["mav0"] = "late"

        async def kill() -> None:
            await _more_orders(bus)
            bus.misbehave.clear()
            await flown.kill("mav0")

        killing = asyncio.create_task(kill())
    await killing
    kinds = [order.kind for name, order in bus.orders if name == "mav0"]
    assert kinds == ["takeoff", "land", "kill"]


@pytest.mark.usefixtures("host")
async def test_vehicles_that_follow_another_one_get_no_goals_in_the_end_of_a_script(
    bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following, "_PERIOD_S", 0.01)
    async with Fleet.connect(at_end="hold") as flown:
        await flown.takeoff(1.0)
        task = asyncio.create_task(flown.follow("mav0", 1.0, offsets={"mav1": (0.0, 2.0, 0.0)}))
        await _more_orders(bus)
        for name in bus.vehicles:
            bus.tell(name, velocity_enu_m_s=(1.0, 0.0, 0.0))  # so that the next goal is another

    with pytest.raises(ConfigError, match="The script's flight has ended"):
        await task
    assert [order.kind for _, order in bus.orders][4:] == ["hold"] * 3


async def test_a_cancelled_verb_stays_in_force_is_a_step_and_fails_no_flight(
    host: ClientHost, bus: Any
) -> None:
    bus.accept_only = {"follow_path"}
    async with Fleet.connect() as flown:
        await flown.takeoff(1.0)
        bus.misbehave = {"mav0": "late", "mav1": "late"}
        orders = [
            flown["mav0"].go_to((-1.5, -0.5, 1.0)),
            flown["mav1"].land(),
            flown["mav2"].follow_path({"mav2": PATHS["mav0"]}),
        ]
        tasks = [asyncio.create_task(order) for order in orders]
        await asyncio.wait(tasks, timeout=0.2)
        for task in tasks:
            task.cancel()
        assert await flown.client.wait_for(lambda state: state.is_landed("mav1"), 2.0)
        bus.misbehave.clear()

    assert flown["mav0"].position_enu_m == (-1.5, -0.5, 0.0), "it has gone on to its goal"
    assert {step.step: list(step.vehicles.values()) for step in flown.steps[1:]} == {
        "goto mav0 -1.5 -0.5 1": ["cancelled"],
        "land mav1": ["cancelled"],
        "goto mav2 0 0 1": ["done"],
        "follow_path mav2": ["cancelled"],
    }
    assert host.flown is not None
    verdict = judge(host.flown, Expect(all_landed=True))
    assert verdict.passed, verdict.sentences


@pytest.mark.parametrize("phase", ["refused", "failed"])
async def test_a_vehicle_that_refused_a_verb_or_failed_fails_the_flight_although_it_is_cancelled(
    host: ClientHost, bus: Any, phase: str
) -> None:
    async with Fleet.connect() as flown:
        await flown.takeoff(1.0)
        bus.misbehave = {"mav0": "late", "mav1": {"refused": "refuse", "failed": "fail"}[phase]}
        goals = {"mav0": (-1.5, -0.5, 1.0), "mav1": (1.5, 0.5, 1.0)}
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(flown.go_to(goals), 0.1)
        bus.misbehave.clear()

    assert flown.steps[1].vehicles == {"mav0": "cancelled", "mav1": phase}
    assert host.flown is not None
    verdict = judge(host.flown, Expect(all_landed=True))
    assert not verdict.passed


@pytest.mark.parametrize(
    ("last_line", "has_ended_by_itself"),
    [
        ("pass", True),
        ("sys.exit()", True),
        ("sys.exit(0)", True),
        ("sys.exit(143)", False),
        ("sys.exit('a vehicle is missing')", False),
        ("1 / 0", False),
        ("raise KeyboardInterrupt", False),
    ],
)
def test_what_comes_after_the_last_line_of_a_script_comes_only_if_it_has_ended_by_itself(
    host: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    last_line: str,
    has_ended_by_itself: bool,
) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\n"
        "from groundstation.missions.connection import call_after_last_line\n"
        "call_after_last_line(lambda: print('after it'))\n"
        f"{last_line}\n"
    )
    if has_ended_by_itself:
        run_script(script, (), host)
        assert capsys.readouterr().out == "after it\n"
        return

    with pytest.raises((SystemExit, ZeroDivisionError, KeyboardInterrupt)):
        run_script(script, (), host)
    assert capsys.readouterr().out == ""
