"""Orders between two sleeps of a script: of each vehicle only the last one is sent."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec.structs import replace

from groundstation.crazyswarm.orders import ScriptOrders
from groundstation.missions.ground import step_result
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Intent
from groundstation.orders.result import OrderFailed, VehicleResult
from groundstation.paths.pieces import fitted
from groundstation.verdict.observations import StepResult
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.config.obstacles import Obstacle


class Standing:
    """A fleet whose vehicles stand on the ground."""

    names = ("mav0", "mav1", "mav2")

    def __init__(self) -> None:
        self.client = SimpleNamespace(now_ns=time.monotonic_ns)
        self.ground = SimpleNamespace(order=self.order)
        self.telemetry = SimpleNamespace(
            state="ready",
            yaw_deg=0.0,
            position_enu_m=(-1.6, 0.0, 0.0),
            goal_position_enu_m=(-1.6, 0.0, 0.0),
        )
        self.said: list[str] = []
        self.steps: list[StepResult] = []
        self.cuts: list[asyncio.Event] = []  # one for each order to move, which cuts it off

    def __getitem__(self, name: str) -> Any:
        return SimpleNamespace(is_flying=False, telemetry=self.telemetry)

    async def takeoff(self, height_m: float, names: list[str], timeout_s: float) -> None:
        """Take off, which takes a moment."""
        await asyncio.sleep(0.02)

    async def order(self, intent: Intent, timeout_s: float, change: Any) -> None:
        """Move until something else cuts it off."""
        cut = asyncio.Event()
        self.cuts.append(cut)
        await cut.wait()
        results = {
            name: VehicleResult(name, "1", "superseded", "Ended by another order.")
            for name in intent.names
        }
        self.steps.append(step_result(str(intent), 1.0, results))
        raise OrderFailed(intent, results)

    async def land(self, names: list[str], timeout_s: float) -> None:
        """Land, which takes a moment."""
        self.said.append(f"land {','.join(names)}")
        await asyncio.sleep(0.02)
        self.said.append("landed")

    async def kill(self, names: tuple[str, ...]) -> None:
        """Stop the motors."""
        self.said.append(f"kill {','.join(names)}")


class BlockingStanding:
    """The same fleet for a script, in an event loop of its own."""

    def __init__(self) -> None:
        self.fleet = Standing()
        self.loop = asyncio.new_event_loop()

    def run(self, function: Callable[[Any], Coroutine[Any, Any, Any]]) -> Any:
        """Run a function of the fleet to its end."""
        return self.loop.run_until_complete(function(self.fleet))


@pytest.fixture
def blocking() -> Iterator[BlockingStanding]:
    standing = BlockingStanding()
    yield standing
    standing.loop.close()


@pytest.fixture
def orders(blocking: Any) -> ScriptOrders:
    return ScriptOrders(blocking)


@pytest.mark.parametrize(("begin_x_m", "has_proposal"), [(0.0, False), (3.0, True)])
def test_a_slower_trajectory_is_proposed_unless_it_leads_through_a_wall(
    fleet: FleetConfig, orders: ScriptOrders, begin_x_m: float, has_proposal: bool
) -> None:
    wall = Obstacle(name="wall", polygon_enu_m=((-1, 1.0), (1, 1.0), (1, 1.3), (-1, 1.3)))
    points = np.array([[begin_x_m, y, 1.0, 0.0] for y in (0.0, 0.75, 1.5, 2.25, 3.0)])
    refusal = ConfigError("It cannot be flown.")

    async def refuse(paths: object) -> None:
        raise refusal

    walled = replace(fleet, obstacles=(wall,))
    orders.fleet = cast(Any, SimpleNamespace(config=walled, follow_path=refuse))
    with pytest.raises(ConfigError) as raised:
        asyncio.run(orders._follow({"mav1": fitted(np.arange(0.0, 25.0, 5.0), points)}))
    assert ("A timescale that is 1.25 times as long" in str(raised.value)) == has_proposal


def test_a_take_off_replaces_a_stop_before_it(orders: ScriptOrders) -> None:
    orders.stop("mav0")
    orders.stop("mav1")
    orders.takeoff("mav0", 1.0, 2.0)
    assert orders._batch.stops == ["mav1"], "mav0 would be disarmed while it takes off"
    assert list(orders._batch.takeoffs) == ["mav0"]


def test_a_stop_replaces_arming_and_a_take_off_and_follows_a_landing(orders: ScriptOrders) -> None:
    orders.arm("mav0")
    orders.takeoff("mav1", 1.0, 2.0)
    orders.land("mav2", 2.0)
    for name in ("mav0", "mav1", "mav2"):
        orders.stop(name)
    assert orders._batch.arms == []
    assert orders._batch.takeoffs == {}
    assert orders._batch.landings == {"mav2": 2.0}
    assert orders._batch.stops == ["mav0", "mav1", "mav2"]


def test_arming_replaces_a_stop_before_it(orders: ScriptOrders) -> None:
    orders.stop("mav0")
    orders.arm("mav0")
    assert orders._batch.stops == []
    assert orders._batch.arms == ["mav0"]


def test_an_emergency_drops_what_is_not_sent_and_refuses_what_would_fly(
    orders: ScriptOrders, blocking: BlockingStanding
) -> None:
    orders.takeoff("mav0", 1.0, 2.0)
    orders.kill_all()
    assert blocking.fleet.said == ["kill mav0,mav1,mav2"]
    assert orders._batch.takeoffs == {}, "mav0 would take off after its motors were stopped"

    with pytest.raises(OrderError, match=r"goTo is refused, because emergency\(\) has stopped"):
        orders.go_to("mav0", (0.0, 0.0, 1.0), 0.0, 2.0)
    with pytest.raises(OrderError, match="takeoff is refused"):
        orders.takeoff("mav1", 1.0, 2.0)
    with pytest.raises(OrderError, match="arm is refused"):
        orders.arm("mav1")
    assert orders._batch.moves == {}


def test_the_end_of_a_script_sends_what_no_sleep_has_sent_and_waits_for_its_end(
    orders: ScriptOrders, blocking: BlockingStanding
) -> None:
    orders.land("mav0", 0.01)
    orders.finish()
    assert blocking.fleet.said == ["land mav0", "landed"]


@pytest.mark.parametrize("end", [KeyboardInterrupt(), SystemExit(143)], ids=["Ctrl-C", "SIGTERM"])
def test_the_end_of_a_script_that_was_interrupted_in_a_sleep_sends_nothing(
    orders: ScriptOrders,
    blocking: BlockingStanding,
    monkeypatch: pytest.MonkeyPatch,
    end: BaseException,
) -> None:
    def interrupted(function: Callable[[Any], Coroutine[Any, Any, Any]]) -> None:
        function(blocking.fleet).close()
        raise end

    with monkeypatch.context() as patch:
        patch.setattr(blocking, "run", interrupted)
        with pytest.raises(type(end)):
            orders.pass_time(1.0, waits_for_moves=True)
    orders.land("mav0", 0.01)
    orders.finish()
    assert blocking.fleet.said == []


@pytest.mark.parametrize("is_replaced", [True, False], ids=["by the script", "by others"])
def test_only_a_move_that_the_script_itself_replaces_has_not_failed_when_it_is_cut_off(
    orders: ScriptOrders, blocking: BlockingStanding, is_replaced: bool
) -> None:
    fleet = blocking.fleet
    for name in ("mav0", "mav1"):
        orders.go_to(name, (0.0, 0.0, 1.0), 0.0, 8.0)
    orders.pass_time(0.0, waits_for_moves=False)
    orders.go_to("mav0", (1.0, 0.0, 1.0), 0.0, 8.0)
    if is_replaced:
        orders.go_to("mav1", (2.0, 0.0, 1.0), 0.0, 8.0)
    orders.pass_time(0.0, waits_for_moves=False)

    fleet.cuts[0].set()
    if is_replaced:
        orders.pass_time(0.01, waits_for_moves=False)
        assert fleet.steps == []
    else:
        with pytest.raises(OrderFailed, match="mav1 superseded: Ended by another order"):
            orders.pass_time(10.0, waits_for_moves=False)
        assert [step.vehicles for step in fleet.steps] == [
            dict.fromkeys(("mav0", "mav1"), "superseded")
        ]

    fleet.cuts[1].set()
    with pytest.raises(OrderFailed):
        orders.pass_time(10.0, waits_for_moves=False)
    assert len(fleet.steps) == (1 if is_replaced else 2)


def test_relative_goals_begin_where_the_command_before_leads_and_not_where_telemetry_is(
    orders: ScriptOrders, blocking: BlockingStanding
) -> None:
    orders.takeoff("mav0", 1.5, 2.0)
    orders.pass_time(0.0, waits_for_moves=True)
    assert orders.spot("mav0") == ((-1.6, 0.0, 1.5), 0.0)

    blocking.fleet.telemetry.state = "flying"
    orders.go_to("mav0", (1.0, 2.0, 1.0), 90.0, 8.0)
    orders.pass_time(0.0, waits_for_moves=True)
    assert orders.spot("mav0") == ((1.0, 2.0, 1.0), 90.0)

    # once it has ended, the vehicle may be elsewhere
    blocking.fleet.cuts[0].set()
    with pytest.raises(OrderFailed):
        orders.pass_time(10.0, waits_for_moves=True)
    assert orders.spot("mav0") == ((-1.6, 0.0, 0.0), 0.0)


def test_relative_turns_add_up_to_the_headings_of_the_moves_and_not_to_measured_ones(
    orders: ScriptOrders, blocking: BlockingStanding
) -> None:
    telemetry = blocking.fleet.telemetry
    telemetry.state = "holding"
    orders.go_to("mav0", (1.0, 2.0, 1.0), 90.0, 8.0)
    orders.pass_time(0.0, waits_for_moves=False)
    blocking.fleet.cuts[0].set()
    with pytest.raises(OrderFailed):
        orders.pass_time(10.0, waits_for_moves=True)

    telemetry.goal_position_enu_m = (1.0, 2.0, 1.0)
    telemetry.yaw_deg = 86.0
    assert orders.spot("mav0") == ((1.0, 2.0, 1.0), 90.0)
    telemetry.goal_position_enu_m = (1.0, 3.0, 1.0)  # a failsafe has led it elsewhere
    assert orders.spot("mav0") == ((1.0, 3.0, 1.0), 86.0)

    telemetry.goal_position_enu_m = (1.0, 2.0, 1.0)
    orders.land("mav0", 0.01)
    orders.pass_time(0.1, waits_for_moves=True)
    assert orders.spot("mav0") == ((1.0, 2.0, 1.0), 86.0)
