"""``covey order``: exit statuses that a script can trust, one line per vehicle."""

from __future__ import annotations

import asyncio
import functools
import json
import threading
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

import pytest
from msgspec import structs

from groundstation.cli import main
from groundstation.client import one_order
from groundstation.client.client import FleetClient
from groundstation.client.direct_mavlink import DirectCommand, DirectResult
from groundstation.commands import order as give
from onboard.bus.protocol import NoRouterError
from onboard.config.fleet import FleetConfig, load_fleet
from tests.groundstation.conftest import FakeBus
from tests.onboard.bus.sessions import until

FLEET = "configs/fleets/paper.toml"
NOBODY = DirectResult(False, False, "PX4 did not answer either", has_answered=False)


def order(
    monkeypatch: pytest.MonkeyPatch,
    *words: str,
    misbehave: Mapping[str, str] | None = None,
    heights_m: Mapping[str, float] | None = None,
    heard_later: Collection[str] = (),
    never_heard: Collection[str] = (),
    sent_before: list[int] | None = None,
    connect_s: float = 0.3,
) -> int:
    """Give an order to agents that do what they are told, or misbehave.

    Args:
        words: the order.
        misbehave: how an agent does, by its vehicle.
        heights_m: of vehicles that fly above one place; the others stand.
        heard_later: vehicles whose first telemetry comes after that of the others.
        never_heard: vehicles without telemetry.
        sent_before: gets the number of orders that were sent before each of these is heard.
        connect_s: longest wait until the vehicles are heard [s].
    """
    column_m = heights_m or {}

    async def send(_: DirectCommand) -> DirectResult:
        return NOBODY

    def client(fleet: FleetConfig, **_: Any) -> FleetClient:
        bus: Any = FakeBus(fleet, has_truth=True)
        bus.misbehave = dict(misbehave or {})
        found = FleetClient(fleet, author="script", bus=bus, send=send)
        start = found.start

        def tell_later(tell: Callable[[], None]) -> None:
            if sent_before is not None:
                sent_before.append(len(bus.orders))
            tell()

        async def started(longest_s: float | None = None) -> None:
            await start(longest_s)
            for name in fleet.enabled_names:
                if name in never_heard:
                    continue
                changes: dict[str, Any] = {}
                if name in column_m:
                    changes["is_airborne"] = True
                    changes["position_enu_m"] = (0.0, 0.0, column_m[name])
                tell = functools.partial(bus.tell, name, **changes)
                if name in heard_later:
                    asyncio.get_running_loop().call_later(0.05, tell_later, tell)
                else:
                    tell()

        found.start = started  # type: ignore[method-assign]
        return found

    monkeypatch.setattr(give, "FleetClient", client)
    monkeypatch.setattr(one_order, "CONNECT_S", connect_s)
    return main(["order", "--fleet", FLEET, *words])


@pytest.mark.parametrize(
    ("misbehave", "status"),
    [
        ({}, 0),
        ({"mav1": "refuse"}, 50),
        ({"mav0": "fail", "mav1": "fail", "mav2": "refuse"}, 1),
        ({"mav0": "silent", "mav1": "silent", "mav2": "silent"}, 10),
    ],
)
def test_the_exit_status_tells_what_the_vehicles_did(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    misbehave: dict[str, str],
    status: int,
) -> None:
    assert order(monkeypatch, "hold", "all", misbehave=misbehave) == status
    lines = capsys.readouterr()
    assert len((lines.out + lines.err).splitlines()) == 3
    assert all(name in lines.err for name in misbehave)


def test_a_landing_that_neither_agents_nor_px4s_answer_is_answered_by_nobody(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    silent = dict.fromkeys(("mav0", "mav1", "mav2"), "silent")
    assert order(monkeypatch, "land", "all", misbehave=silent) == 10
    assert capsys.readouterr().err.count("PX4 did not answer either") == 3


@pytest.mark.parametrize("heard_later", [(), ("mav0", "mav2")])
def test_who_kills_the_top_of_a_column_reads_who_is_below(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    heard_later: tuple[str, ...],
) -> None:
    column = {"mav0": 1.0, "mav1": 2.5}
    status = order(monkeypatch, "kill", "mav1", heights_m=column, heard_later=heard_later)
    assert status == 0
    assert capsys.readouterr().err == "mav1 falls on mav0, 1.5 m below.\n"


DISARMED = DirectResult(True, True, "PX4 accepted it, and it is disarmed")


def order_without_router(
    monkeypatch: pytest.MonkeyPatch,
    *words: str,
    answers: Mapping[int, DirectResult],
    without_direct: str = "",
    opens: bool = False,
) -> tuple[int, list[Any], list[DirectCommand]]:
    """Give an order in a fleet whose router does not answer.

    Args:
        words: the order.
        answers: PX4's answer to a direct command, by its system id; empty: none is sent.
        without_direct: a vehicle without a direct endpoint.
        opens: whether the router answers after the order was given.
    Returns:
        The exit status, the orders over the bus, and the commands straight to PX4.
    """
    fleet = load_fleet(FLEET)
    vehicles = dict(fleet.vehicles)
    if without_direct:
        vehicles[without_direct] = structs.replace(vehicles[without_direct], direct=None)
    section = structs.replace(fleet.fleet, routers=("tcp/127.0.0.1:1",))
    fleet = structs.replace(fleet, fleet=section, vehicles=vehicles)

    orders: list[Any] = []
    commands: list[DirectCommand] = []
    is_sent = threading.Event()

    async def send(command: DirectCommand) -> DirectResult:
        commands.append(command)
        is_sent.set()
        return answers[command.system_id]

    def client(fleet: FleetConfig, **_: Any) -> FleetClient:
        bus: Any = FakeBus(fleet)
        bus.orders = orders
        found = FleetClient(fleet, author="script", bus=bus, send=send)

        def start() -> None:
            if opens:
                assert until(lambda: found._orders.has_open("mav0", ("land", "kill")))
                return
            if answers:
                assert is_sent.wait(5.0)
            raise NoRouterError("No router of this fleet answers.")

        bus.start = start
        return found

    monkeypatch.setattr(give, "load_fleet", lambda _: fleet)
    monkeypatch.setattr(give, "FleetClient", client)
    monkeypatch.setattr(one_order, "_SILENT_S", 0.05)
    monkeypatch.setattr(one_order, "CONNECT_S", 0.05)
    return main(["order", "--fleet", FLEET, *words]), orders, commands


def test_without_a_router_a_kill_goes_straight_to_px4_and_ends_as_px4_confirms(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = {1: DISARMED, 2: DirectResult(True, False, "PX4 accepted it"), 3: NOBODY}
    status, orders, commands = order_without_router(monkeypatch, "kill", "all", answers=answers)
    assert status == 50
    assert not orders
    assert sorted(command.system_id for command in commands) == [1, 2, 3]
    lines = capsys.readouterr()
    assert "No router of this fleet has answered within 0.05 s" in lines.err
    assert lines.out.startswith("mav0: done.")
    assert "mav1: failed." in lines.err
    assert "mav2: failed." in lines.err

    status, _, _ = order_without_router(monkeypatch, "kill", "mav2", answers=answers)
    assert status == 10


def test_without_a_router_a_kill_reaches_px4_beside_a_vehicle_without_direct_path(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, commands = order_without_router(
        monkeypatch, "kill", "mav0,mav1", answers={1: DISARMED}, without_direct="mav1"
    )
    assert status == 50
    assert [command.system_id for command in commands] == [1]
    assert "mav1: no answer." in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["land", "kill"])
def test_a_router_that_answers_late_takes_a_land_or_kill_to_the_agent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    status, orders, commands = order_without_router(
        monkeypatch, verb, "mav0", answers={}, opens=True
    )
    assert status == 0
    assert [(vehicle, order.kind) for vehicle, order in orders] == [("mav0", verb)]
    assert not commands
    assert "mav0: done." in capsys.readouterr().out


def test_a_bus_that_cannot_be_opened_says_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(fleet: FleetConfig, **_: Any) -> FleetClient:
        bus: Any = FakeBus(fleet)

        def start() -> None:
            raise NoRouterError("The router's certificate is of another authority.")

        bus.start = start
        return FleetClient(fleet, author="script", bus=bus, send=nobody)

    async def nobody(command: DirectCommand) -> DirectResult:
        return NOBODY

    fleet = load_fleet(FLEET)
    section = structs.replace(fleet.fleet, routers=("tcp/127.0.0.1:1",))
    monkeypatch.setattr(give, "load_fleet", lambda _: structs.replace(fleet, fleet=section))
    monkeypatch.setattr(give, "FleetClient", refuse)
    assert main(["order", "--fleet", FLEET, "kill", "mav0"]) == 10
    assert "The router's certificate is of another authority." in capsys.readouterr().err


def test_other_orders_and_vehicles_without_direct_path_need_a_router(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (("hold", "all"), ("land", "mav1")):
        status, _, commands = order_without_router(
            monkeypatch, *words, answers={}, without_direct="mav1"
        )
        assert status == 10
        assert not commands
        assert "No router of this fleet answers." in capsys.readouterr().err


def test_a_kill_is_sent_before_the_other_vehicles_are_heard(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sent_before: list[int] = []
    status = order(
        monkeypatch,
        "kill",
        "mav1",
        heights_m={"mav0": 1.0, "mav1": 2.5},
        heard_later=("mav0", "mav2"),
        sent_before=sent_before,
    )
    assert status == 0
    assert sent_before == [1, 1]


@pytest.mark.parametrize("verb", ["land", "kill"])
@pytest.mark.parametrize("has_direct", [True, False])
def test_a_silent_vehicle_delays_the_land_or_kill_of_the_others_only_briefly(
    monkeypatch: pytest.MonkeyPatch, verb: str, has_direct: bool
) -> None:
    if not has_direct:
        _remove_direct_endpoints(monkeypatch)
    monkeypatch.setattr(one_order, "_SILENT_S", 0.05)
    begin_s = time.monotonic()
    assert order(monkeypatch, verb, "mav1,mav2", never_heard=["mav2"], connect_s=2.0) == 0
    assert time.monotonic() - begin_s < 1.5


def test_a_kill_that_has_only_the_bus_waits_until_the_bus_is_connected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _remove_direct_endpoints(monkeypatch)
    monkeypatch.setattr(one_order, "_SILENT_S", 0.01)
    sent_before: list[int] = []
    everybody = ("mav0", "mav1", "mav2")
    status = order(
        monkeypatch, "kill", "mav1", heard_later=everybody, sent_before=sent_before, connect_s=2.0
    )
    assert status == 0
    assert sent_before == [0, 0, 0]


def _remove_direct_endpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    def load_without_direct(path: str) -> FleetConfig:
        fleet = load_fleet(path)
        vehicles = {
            name: structs.replace(vehicle, direct=None) for name, vehicle in fleet.vehicles.items()
        }
        return structs.replace(fleet, vehicles=vehicles)

    monkeypatch.setattr(give, "load_fleet", load_without_direct)


def test_json_is_a_list_of_vehicles(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert order(monkeypatch, "move", "mav1", "-1", "0.5", "1.2", "--json") == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["vehicle"], row["phase"]) == ("mav1", "done")


@pytest.mark.parametrize(
    "words",
    [("tkeoff", "all"), ("land", "mav9"), ("land", "2-1"), ("land", "all", "--timeout", "-3")],
)
def test_nonsense_sends_nothing_and_is_wrong_input(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    assert order(monkeypatch, *words) == 2
    assert capsys.readouterr().err.startswith("covey: ")
