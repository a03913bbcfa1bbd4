"""A spare has the place of the vehicle that it stands in for: in orders, homes, slots and paths."""

from __future__ import annotations

import asyncio
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

from groundstation.client.preflight_page import page_of
from groundstation.fleet import state as fleet_state
from groundstation.fleet.state import FleetState
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions import conditions
from groundstation.missions.api import Fleet
from groundstation.missions.conditions import FleetMoment, WaitCondition
from groundstation.missions.runner import MissionRun
from groundstation.orders.grammar import OrderError, parse
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.plan import plan_order
from groundstation.orders.result import OrderResult
from onboard.bus.schema import SERVICE
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping
from tests.groundstation.console.fake import telemetry

SECOND = 1_000_000_000


def fleet_with_a_fourth_vehicle() -> FleetConfig:
    """The paper's fleet with a spare, mav3, that has no slot in any formation."""
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text(encoding="utf-8"))
    data["vehicles"]["mav3"] = {
        **data["vehicles"]["mav2"],
        "system_id": 4,
        "start_enu_m": [3.0, 3.0, 0.0],
        "agent": "tcp/127.0.0.1:7463",
        "autopilot": "udpin://127.0.0.1:14543",
        "direct": "udpout://127.0.0.1:18573",
        "mocap_body": "mav3",
    }
    return fleet_from_mapping(data)


async def tell(client: Any, bus: Any, name: str, **changes: Any) -> None:
    """Have a vehicle tell something, and wait until the client has folded it."""
    bus.tell(name, **changes)
    newest = bus.vehicles[name].sequence

    def is_folded(state: FleetState) -> bool:
        telemetry = state.vehicles[name].telemetry
        return telemetry is not None and telemetry.sequence >= newest

    assert await client.wait_for(is_folded, 5.0)


@pytest.fixture
async def standing(fleet: FleetConfig, bus: Any, client: Any) -> Any:
    """A client whose mav1 was carried away, and whose spare mav2 stands on the spot of mav1."""
    x, y, z = fleet.vehicles["mav1"].start_enu_m
    await tell(client, bus, "mav1", position_enu_m=(x + 2.0, y, z))
    await tell(client, bus, "mav2", position_enu_m=(x + 0.1, y, z), disabled_by="olga")
    return client


@pytest.fixture
async def swapped(bus: Any, standing: Any) -> Any:
    """The same after the swap."""
    await tell(standing, bus, "mav1", disabled_by="olga")
    await tell(standing, bus, "mav2", disabled_by="", stands_in_for="mav1")
    return standing


def refusal(client: Any, line: str) -> str:
    planned = client.plan(line)
    assert not planned.orders
    return " ".join(planned.refusals.values())


async def test_a_swap_disables_one_vehicle_and_gives_its_place_to_the_other(standing: Any) -> None:
    orders = standing.plan("swap mav1 mav2").orders
    assert orders["mav1"].kind == "disable"
    assert orders["mav2"].kind == "stand_in"
    assert orders["mav2"].stands_in_for == "mav1"


async def test_a_swap_back_gives_the_place_to_its_first_owner(bus: Any, swapped: Any) -> None:
    x, y, z = swapped.fleet.vehicles["mav1"].start_enu_m
    await tell(swapped, bus, "mav1", position_enu_m=(x, y, z))
    await tell(swapped, bus, "mav2", position_enu_m=(x + 2.0, y, z))
    await tell(swapped, bus, "mav1", position_enu_m=(x, y - 2.0, z))
    assert "mav1 stands 2.0 m from its own spot" in refusal(swapped, "swap mav2 mav1")
    await tell(swapped, bus, "mav1", position_enu_m=(x, y, z))
    orders = swapped.plan("swap mav2 mav1").orders
    assert orders["mav2"].kind == "disable"
    assert orders["mav1"].stands_in_for == "mav1"


@pytest.fixture
async def without_mav1(bus: Any) -> None:
    """Nobody ever hears mav1: its computer is dead."""
    del bus.vehicles["mav1"]


@pytest.mark.usefixtures("without_mav1")
async def test_a_swapped_vehicle_that_nobody_hears_gets_no_order(bus: Any, client: Any) -> None:
    spot_enu_m = client.fleet.vehicles["mav1"].start_enu_m
    await tell(client, bus, "mav2", position_enu_m=spot_enu_m)
    assert set(client.plan("swap mav1 mav2").orders) == {"mav2"}


@pytest.mark.usefixtures("without_mav1")
async def test_a_swap_is_done_with_the_spare_if_nobody_hears_the_other(
    bus: Any, client: Any
) -> None:
    spot_enu_m = client.fleet.vehicles["mav1"].start_enu_m
    await tell(client, bus, "mav2", position_enu_m=spot_enu_m)
    order = OrderResult(client.plan("swap mav1 mav2"))
    assert not order.is_done

    order.update("mav2", "done", "")
    assert order.is_done
    assert "not heard" in order.results["mav1"].sentence


@pytest.mark.parametrize(
    ("who", "told", "words"),
    [
        ("mav1", {"is_armed": True}, "on the ground only, disarmed: mav1 is armed"),
        ("mav2", {"is_airborne": True, "state": "flying"}, "disarmed: mav2 is flying"),
        ("mav2", {"position_enu_m": (9.0, 9.0, 0.0)}, "from the spot of mav1"),
        ("mav2", {"is_position_valid": False}, "does not report where it stands"),
        ("mav2", {"stands_in_for": "mav0", "disabled_by": ""}, "swap mav2 mav0 first"),
        ("mav0", {"stands_in_for": "mav1"}, "mav0 has the place of mav1: write swap mav0 mav2"),
    ],
)
async def test_a_swap_that_cannot_be_is_refused_for_both_with_the_reason(
    bus: Any, standing: Any, who: str, told: dict[str, Any], words: str
) -> None:
    await tell(standing, bus, who, **told)
    sentence = refusal(standing, "swap mav1 mav2")
    assert words in sentence
    assert "not sent, because" in sentence


async def test_a_swapped_vehicle_that_is_still_on_the_spot_has_to_be_carried_away(
    bus: Any, standing: Any
) -> None:
    await tell(standing, bus, "mav1", position_enu_m=standing.fleet.vehicles["mav1"].start_enu_m)
    assert "mav1 still stands on the spot" in refusal(standing, "swap mav1 mav2")


@pytest.mark.parametrize("line", ["swap mav1", "swap", "swap mav1 mav1", "swap mav0 mav1 mav2"])
def test_a_swap_is_of_two_vehicles(fleet: FleetConfig, line: str) -> None:
    with pytest.raises(OrderError, match="A swap is of two vehicles"):
        parse(line, fleet)


def test_a_spare_that_the_fleet_file_lacks_is_refused(fleet: FleetConfig) -> None:
    with pytest.raises(OrderError, match="'mav7' is not a vehicle of fleet"):
        parse("swap mav1 mav7", fleet)


async def test_all_leaves_out_a_vehicle_whose_place_another_one_has(bus: Any, swapped: Any) -> None:
    bus.tell("mav1", disabled_by="")  # its agent was started anew
    assert set(swapped.plan("takeoff all 1.0").orders) == {"mav0", "mav2"}


async def test_a_vehicle_that_stands_in_for_nobody_of_the_fleet_keeps_its_place(
    bus: Any, standing: Any
) -> None:
    await tell(standing, bus, "mav0", stands_in_for="../etc")
    home_enu_m = standing.plan("home mav0").orders["mav0"].position_enu_m
    assert home_enu_m[:2] == standing.fleet.vehicles["mav0"].start_enu_m[:2]


async def test_home_and_slots_are_those_of_the_place(fleet: FleetConfig, swapped: Any) -> None:
    home_enu_m = swapped.plan("home mav2").orders["mav2"].position_enu_m
    assert home_enu_m is not None
    assert home_enu_m[:2] == fleet.vehicles["mav1"].start_enu_m[:2]

    name, slots = next(iter(fleet.formations.items()))
    orders = swapped.plan(f"formation {name} mav0,mav2 0 0 1").orders
    for vehicle, place in (("mav0", "mav0"), ("mav2", "mav1")):
        goal_enu_m = orders[vehicle].position_enu_m
        assert goal_enu_m is not None
        assert math.dist(goal_enu_m[:2], slots[place][:2]) < 1e-9


async def test_a_mission_that_names_the_swapped_vehicle_is_flown_by_its_spare(
    fleet: FleetConfig, swapped: Any, bus: Any
) -> None:
    goals = {"mav0": [-1.0, 2.0, 1.0], "mav1": [1.0, 2.0, 1.0]}
    steps = [
        {"do": "takeoff", "vehicles": "mav0,mav1"},
        {"do": "goto", "goals": goals},
        {"do": "land", "vehicles": "mav0,mav1"},
    ]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="t.toml", fleet=fleet)
    lines: list[str] = []
    verdict = await asyncio.wait_for(MissionRun(mission, swapped, say=lines.append).run(), 20.0)
    assert verdict.passed, verdict.summary

    flown = {name: order for name, order in bus.orders if order.kind == "move"}
    assert set(flown) == {"mav0", "mav2"}
    assert flown["mav2"].position_enu_m == (1.0, 2.0, 1.0)
    assert "mav2 flies in the place of mav1." in lines
    assert not any("goes on without" in line for line in lines)


async def test_scripts_swap_and_go_on_by_the_name_of_the_place(bus: Any, standing: Any) -> None:
    flown = Fleet(standing)
    swap = asyncio.create_task(flown.swap("mav1", "mav2"))
    await asyncio.sleep(0.1)
    await tell(standing, bus, "mav1", disabled_by="tester")
    await asyncio.sleep(0.1)
    assert not swap.done()  # else whoever takes off now leaves out the spare, which is not told yet
    await tell(standing, bus, "mav2", disabled_by="", stands_in_for="mav1")
    await swap
    flown.ground.leave_out_disabled()
    assert flown.names == ("mav0", "mav2")
    assert flown.select("mav1") == ("mav2",)
    assert flown["mav1"].name == "mav2"
    flown.leave_out("mav1")
    assert flown.names == ("mav0",)
    assert {order.kind for _, order in bus.orders} <= set(SERVICE)


async def test_a_refused_swap_puts_nobody_out_of_service_and_is_not_waited_for(client: Any) -> None:
    flown = Fleet(client)
    flown.ground.goes_on_without = True
    results = await asyncio.wait_for(flown.swap("mav1", "mav2"), 1.0)  # mav1 stands on the spot
    assert {result.phase for result in results.values()} == {"refused"}
    assert flown.ground.left_out == {"mav1", "mav2"}
    assert not flown.ground.disabled, "both are landed at the end of the mission"


async def test_the_preflight_page_says_whose_place_a_spare_has(swapped: Any) -> None:
    page = page_of(swapped.state.vehicles["mav2"], swapped.fleet, swapped.now_ns())
    assert "mav2 stands in for mav1" in " ".join(line.sentence for line in page.lines)


@pytest.mark.parametrize("line", ["formation triangle 0 0 1", "move all 0 0 1", "rotate 20"])
@pytest.mark.parametrize("is_swapped", [True, False])
def test_orders_to_all_about_a_formation_leave_out_a_spare_until_it_has_a_slot(
    line: str, is_swapped: bool
) -> None:
    fleet = fleet_with_a_fourth_vehicle()
    state = fleet_state.initial(fleet)
    flying = ["mav0", "mav1", "mav2", "mav3"]
    if is_swapped:
        flying.remove("mav2")
    for name in flying:
        place = "mav2" if is_swapped and name == "mav3" else ""
        x, y, _ = fleet.vehicles[name].start_enu_m
        heard = telemetry(
            name,
            sequence=1,
            position_enu_m=(x, y, 1.0),
            goal_position_enu_m=(x, y, 1.0),
            is_armed=True,
            is_airborne=True,
            state="flying",
            stands_in_for=place,
        )
        state = fleet_state.fold(state, heard, SECOND)

    planned = plan_order(
        parse(line, fleet),
        fleet,
        state,
        held=HeldFormation("triangle"),
        author="olga",
        now_ns=SECOND,
    )
    third = "mav3" if is_swapped else "mav2"
    assert set(planned.orders) == {"mav0", "mav1", third}, planned.refusals


async def test_conditions_of_a_place_are_about_the_vehicle_that_has_it(
    bus: Any, swapped: Any
) -> None:
    await tell(swapped, bus, "mav2", is_airborne=True, is_armed=True, state="flying")
    moment = FleetMoment(swapped.state, swapped.now_ns(), 0)
    assert not conditions.landed("mav1").holds(moment)
    assert conditions.flying("mav1").holds(moment)
    here = bus.vehicles["mav2"].position_enu_m
    assert conditions.reached({"mav1": here}).holds(moment)


@pytest.mark.parametrize(
    "condition",
    [
        conditions.battery_below(20.0, "mav9"),
        conditions.landed(["mav0", "mav9"]),
        conditions.reached({"mav9": (0.0, 0.0, 1.0)}),
    ],
)
async def test_a_condition_about_somebody_who_is_no_vehicle_is_a_sentence(
    client: Any, condition: WaitCondition
) -> None:
    with pytest.raises(ConfigError, match="'mav9', which is not a vehicle: mav0, mav1, mav2"):
        await Fleet(client).until(condition, 1.0)
