"""From a line of text to one checked order per vehicle."""

from __future__ import annotations

import itertools
import math
from typing import Any

import msgspec
import numpy as np
import pytest

from groundstation.fleet.state import FleetState, fold, initial
from groundstation.orders.grammar import OrderError, parse
from groundstation.orders.held_formation import HeldFormation, slots_of
from groundstation.orders.intents import (
    INTENTS,
    Arm,
    Disarm,
    Formation,
    Goto,
    Hold,
    Home,
    Intent,
    Kill,
    Land,
    Locate,
    Move,
    Rotate,
    Takeoff,
    Yaw,
)
from groundstation.orders.plan import PlannedOrder, check_again, plan_order
from onboard.bus.codec import decode, encode
from onboard.bus.schema import Order
from onboard.config.fences import Fence, FenceCircle
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.config.obstacles import Obstacle
from onboard.config.validation import check_fleet
from tests.groundstation.conftest import telemetry

ALL = ("mav0", "mav1", "mav2")
# words that a line does not read as the name of a vehicle
WORDS = {"all", "nearest"}.union(*(kind.options for kind in INTENTS.values()))
NONE = HeldFormation(None)


def planned(intent: Intent, fleet: FleetConfig, state: FleetState | None = None) -> PlannedOrder:
    return plan_order(
        intent, fleet, state, held=HeldFormation("triangle"), author="tester", now_ns=5
    )


def flying_at(fleet: FleetConfig, spots: dict[str, Any]) -> FleetState:
    state = initial(fleet)
    for name, at in spots.items():
        message = telemetry(
            name, state="flying", is_airborne=True, position_enu_m=at, goal_position_enu_m=at
        )
        state = fold(state, message, 0)
    return state


WELL_FORMED = [
    ("takeoff all 1.0", Takeoff(vehicles=ALL, is_everybody=True, height_m=1.0)),
    ("takeoff", Takeoff(vehicles=ALL, is_everybody=True, height_m=1.0)),
    ("takeoff 1.5", Takeoff(vehicles=ALL, is_everybody=True, height_m=1.5)),
    ("takeoff 1", Takeoff(vehicles=("mav1",), height_m=1.0)),
    ("takeoff 1-2 1.2", Takeoff(vehicles=("mav1", "mav2"), height_m=1.2)),
    ("TAKEOFF mav0,mav2 2", Takeoff(vehicles=("mav0", "mav2"), height_m=2.0)),
    ("move all 2 0 1.2", Move(vehicles=ALL, is_everybody=True, position_enu_m=(2.0, 0.0, 1.2))),
    (
        "move mav1 2 -1 1.2 in 8",
        Move(vehicles=("mav1",), position_enu_m=(2.0, -1.0, 1.2), duration_s=8.0),
    ),
    (
        "formation triangle 0 1.2 1.0",
        Formation(vehicles=ALL, is_everybody=True, position_enu_m=(0.0, 1.2, 1.0), name="triangle"),
    ),
    ("formation triangle", Formation(vehicles=ALL, is_everybody=True, name="triangle")),
    (
        "formation triangle 0-1 0 1 1",
        Formation(vehicles=("mav0", "mav1"), position_enu_m=(0.0, 1.0, 1.0), name="triangle"),
    ),
    (
        "goto mav0 2 0 1 1 0 2 1 yaw -90 in 8 s",
        Goto(
            vehicles=("mav0", "mav1"),
            goals={"mav0": (2, 0, 1), "mav1": (0, 2, 1)},
            yaw_deg=-90.0,
            duration_s=8.0,
        ),
    ),
    (
        "formation triangle 1.6 0 1 1 turned 30 yaw 90",
        Formation(
            vehicles=ALL,
            is_everybody=True,
            position_enu_m=(0.0, 1.0, 1.0),
            name="triangle",
            spacing_m=1.6,
            rotation_deg=30.0,
            yaw_deg=90.0,
        ),
    ),
    ("rotate 90", Rotate(vehicles=ALL, is_everybody=True, angle_deg=90.0)),
    ("rotate 0-1 -45 in 5", Rotate(vehicles=("mav0", "mav1"), angle_deg=-45.0, duration_s=5.0)),
    ("yaw mav1 -90", Yaw(vehicles=("mav1",), yaw_deg=-90.0)),
    ("home", Home(vehicles=ALL, is_everybody=True)),
    ("home 0,2 1.5", Home(vehicles=("mav0", "mav2"), height_m=1.5)),
    ("land mav2", Land(vehicles=("mav2",))),
    ("hold", Hold(vehicles=ALL, is_everybody=True)),
    ("arm", Arm(vehicles=ALL, is_everybody=True)),
    ("disarm 0", Disarm(vehicles=("mav0",))),
    ("kill mav1", Kill(vehicles=("mav1",))),
    ("  land   all ", Land(vehicles=ALL, is_everybody=True)),
    ("land", Land(vehicles=ALL, is_everybody=True)),
    ("land 0-2", Land(vehicles=ALL)),
]


def naming(intent: Intent) -> Intent:
    """The intent as its line is read again: an order to all, written out, names each of them."""
    return msgspec.structs.replace(intent, is_everybody=False)


def test_a_well_formed_line_becomes_its_intent(fleet: FleetConfig) -> None:
    for text, expected in WELL_FORMED:
        assert parse(text, fleet) == expected, text


NO_ORDERS = [
    "",
    "   ",
    "fly all",
    "takeoff all high",
    "takeoff all 1.0 2.0",
    "takeoff 3",
    "home 7",
    "formation triangle 4",
    "takeoff all 1_0",
    "move mav1 1_0 0 1",
    "rotate 4_5",
    "takeoff all 1.0 by 1_0",
    "move all 1 2",
    "move 1 2 3",
    "move all 1 2 nan",
    "move all inf 2 1",
    "move all 1 2 1 in",
    "move all 1 2 1 in fast",
    "move all 1 2 1 in -3",
    "land all in 3",
    "goto",
    "goto all 1 2 1",
    "goto mav0 1 2",
    "goto mav0 1 2 1 mav0 2 2 1",
    "goto mav0 1 2 nan",
    "move all 1 2 1 turned 90",
    "move all 1 2 1 yaw",
    "move all 1 2 1 yaw 90 yaw 90",
    "move all 1 2 1 yaw inf",
    "rotate all",
    "rotate all 90 yaw 90",
    "yaw mav0",
    "home all 1 2",
    "formation",
    "formation square 0 0 1",
    "land mav9",
    "land 2-1",
    "land 0-7",
    "land " + "9" * 5000,
    "land " + "x" * 5000,
    "land mav0 mav1",
    "kill",
    "land all\nkill all",
    "land\x00all",
    "x" * 10_000,
]


def test_a_line_that_is_no_order_is_refused_in_words_and_never_guessed(fleet: FleetConfig) -> None:
    for text in NO_ORDERS:
        with pytest.raises(OrderError) as caught:
            parse(text, fleet)
        sentence = str(caught.value)
        assert 20 < len(sentence) < 300, text
        assert sentence.isprintable(), text


def test_an_order_written_out_is_the_same_order(fleet: FleetConfig) -> None:
    for text, intent in WELL_FORMED:
        again = parse(str(intent), fleet)
        assert again == naming(intent), (text, str(intent))


def test_goals_of_one_order_are_judged_together_and_the_way_home_leads_over_the_pads(
    fleet: FleetConfig,
) -> None:
    state = flying_at(
        fleet, {"mav0": (0.0, 0.0, 1.0), "mav1": (1.5, 0.0, 1.2), "mav2": (0.0, 2.0, 1.0)}
    )
    swap = planned(parse("goto mav0 1.5 0 1 mav1 0 0 1", fleet), fleet, state)
    assert not swap.refusals
    assert swap.orders["mav0"].position_enu_m == (1.5, 0.0, 1.0)
    assert swap.orders["mav1"].position_enu_m == (0.0, 0.0, 1.0)
    alone = planned(parse("goto mav0 1.5 0 1", fleet), fleet, state)
    assert "mav1's goal" in alone.refusals["mav0"]
    close = planned(parse("goto mav0 1 0 1 mav1 1.2 0 1", fleet), fleet, state)
    assert not close.orders
    home = planned(parse("home", fleet), fleet, state)
    assert home.orders["mav1"].position_enu_m == (0.0, -1.5, 1.2)
    assert all(order.kind == "move" and order.then_land for order in home.orders.values())
    turned = planned(parse("yaw mav1 45", fleet), fleet, state)
    assert turned.orders["mav1"].position_enu_m == (1.5, 0.0, 1.2)
    assert turned.orders["mav1"].yaw_deg == 45.0


@pytest.mark.parametrize("line", ["home mav1", "bring home mav1"])
def test_the_way_home_ends_above_a_spot_that_is_higher_than_the_vehicle(
    fleet: FleetConfig, line: str
) -> None:
    raised = msgspec.structs.replace(fleet.vehicles["mav1"], start_enu_m=(0.0, -1.5, 1.4))
    hill = msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav1": raised})
    state = flying_at(hill, {"mav1": (0.0, 2.0, 1.7)})
    home = planned(parse(line, hill), hill, state)
    assert home.orders["mav1"].position_enu_m == (0.0, -1.5, pytest.approx(1.7))

    # from below it is higher, because the straight way passes over the ground 1 m before the spot
    state = flying_at(hill, {"mav1": (0.0, 2.0, 1.0)})
    home = planned(parse(line, hill), hill, state)
    highest_m = 1.0 + (1.4 + 0.3 - 1.0) * 3.5 / 2.5
    assert home.orders["mav1"].position_enu_m == (0.0, -1.5, pytest.approx(highest_m, abs=0.05))

    too_low = planned(parse(f"{line} 1.5", hill), hill, state)
    assert "above the ground at 1.4 m" in too_low.refusals["mav1"]


def test_a_take_off_that_does_not_clear_a_raised_spot_is_refused_for_all(
    fleet: FleetConfig,
) -> None:
    raised = msgspec.structs.replace(fleet.vehicles["mav1"], start_enu_m=(0.0, -1.5, 0.6))
    hill = msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav1": raised})

    def refusal(height_m: float, state: FleetState | None = None) -> str:
        order = planned(parse(f"takeoff all {height_m}", hill), hill, state)
        assert bool(order.orders) != bool(order.refusals)
        return order.refusals.get("mav1", "")

    low = "mav1: a take-off to 0.7 m does not leave the ground: order at least 0.85 m."
    assert refusal(0.7) == low
    assert not refusal(0.85)  # the vehicle may report that it stands some centimetres higher

    # one that was carried down from its spot, or to a higher one
    for stands_m, is_refused in ((0.0, False), (0.6, True)):
        on_ground = telemetry("mav1", position_enu_m=(3.0, 0.0, stands_m))
        state = fold(initial(hill), on_ground, 0)
        assert bool(refusal(0.7, state)) is is_refused


def test_a_turned_formation_is_remembered_and_turned_further(fleet: FleetConfig) -> None:
    first = planned(parse("formation triangle 0 0 1 turned 350", fleet), fleet)
    assert first.held.rotation_deg == 350.0
    spots = {name: order.position_enu_m for name, order in first.orders.items()}
    state = flying_at(fleet, spots)
    second = plan_order(
        parse("rotate 100", fleet), fleet, state, held=first.held, author="tester", now_ns=5
    )
    assert second.held.rotation_deg == pytest.approx(90.0)
    slots = slots_of(fleet, "triangle", None, 90.0)
    for name, order in second.orders.items():
        assert order.position_enu_m == pytest.approx((slots[name][0], slots[name][1], 1.0))


def test_a_joint_move_adds_each_vehicles_slot(fleet: FleetConfig) -> None:
    done = planned(parse("move all 0 1 1.2", fleet), fleet)
    assert {name: order.position_enu_m for name, order in done.orders.items()} == {
        "mav0": pytest.approx((0.0, 1.92, 1.2)),
        "mav1": pytest.approx((-0.8, 0.54, 1.2)),
        "mav2": pytest.approx((0.8, 0.54, 1.2)),
    }
    assert all(order.kind == "move" for order in done.orders.values())


def test_one_vehicle_moves_to_the_very_point(fleet: FleetConfig) -> None:
    done = planned(parse("move mav1 1 2 1.2", fleet), fleet)
    assert done.orders["mav1"].position_enu_m == (1.0, 2.0, 1.2)


def test_every_order_has_its_own_id_author_and_a_deadline_ahead(fleet: FleetConfig) -> None:
    orders = planned(parse("land all", fleet), fleet).orders.values()
    assert len({order.order_id for order in orders}) == 3
    assert all(
        order.author == "tester" and order.deadline_ns > order.stamp_ns == 5 for order in orders
    )


def test_a_formation_order_is_remembered_and_a_move_keeps_it(fleet: FleetConfig) -> None:
    assert planned(parse("formation triangle 0 1 1", fleet), fleet).held.name == "triangle"
    unknown = plan_order(
        parse("move all 0 1 1", fleet), fleet, None, held=NONE, author="x", now_ns=0
    )
    assert not unknown.orders
    assert all("formation" in reason for reason in unknown.refusals.values())


def test_if_one_slot_lies_outside_the_fence_nobody_moves_and_everyone_is_told_why(
    fleet: FleetConfig,
) -> None:
    done = planned(parse("move all 3.5 0 1", fleet), fleet)
    assert not done.orders
    assert "outside the geofence" in done.refusals["mav2"]
    assert "mav2 was refused" in done.refusals["mav0"]


def test_goals_and_heights_that_a_fence_does_not_allow_are_refused(fleet: FleetConfig) -> None:
    fences = (
        Fence(name="hall", keep="in", circle=FenceCircle(4.0, (0.0, 0.0)), height_m=(0.0, 2.0)),
        Fence(name="tree", keep="out", circle=FenceCircle(0.5, (0.0, 2.0)), buffer_m=0.3),
    )
    fenced = msgspec.structs.replace(fleet, fences=fences)
    for text, words in (
        ("move mav0 3 3 1", "mav0: the goal (3.00, 3.00, 1.00) lies outside the fence 'hall'"),
        ("move mav0 0 2 1", "lies inside the fence 'tree', which is to stay out of. Choose"),
        ("move mav0 0 1.3 1", "lies 0.20 m from the edge of the fence 'tree'"),
        ("takeoff all 2.5", "of 2.5 m is above 2 m, the top of the fence"),
    ):
        refusals = planned(parse(text, fenced), fenced).refusals
        assert words in refusals["mav0"], text
    assert not planned(parse("move mav0 0 1 1", fenced), fenced).refusals


def test_a_goal_without_a_way_is_refused_and_one_with_a_way_around_is_not(
    fleet: FleetConfig,
) -> None:
    def walled(north_m: float) -> FleetConfig:
        corners = ((2.0, -5.0), (2.2, -5.0), (2.2, north_m), (2.0, north_m))
        return msgspec.structs.replace(fleet, obstacles=(Obstacle("wall", polygon_enu_m=corners),))

    state = flying_at(fleet, {"mav0": (0.0, 0.0, 1.0)})
    closed = planned(parse("move mav0 3 0 1", fleet), walled(5.0), state)
    assert closed.refusals["mav0"] == (
        "mav0: the goal (3.00, 0.00, 1.00) cannot be reached from (0.00, 0.00): no way around the "
        "obstacles and fences leaves 0.45 m on both sides of mav0; choose another point."
    )
    open_north = planned(parse("move mav0 3 0 1", fleet), walled(2.0), state)
    assert not open_north.refusals
    unheard = planned(parse("move mav0 3 0 1", fleet), walled(5.0))
    assert not unheard.refusals  # the vehicle itself refuses


def test_a_goal_below_ground_and_a_height_above_the_fence_are_refused(fleet: FleetConfig) -> None:
    assert "above the ground" in planned(parse("move mav0 0 0 -0.2", fleet), fleet).refusals["mav0"]
    assert "3" in planned(parse("takeoff all 9.0", fleet), fleet).refusals["mav1"]


def test_numbers_that_are_not_finite_are_refused_also_without_the_parser(
    fleet: FleetConfig,
) -> None:
    for intent in (
        Move(vehicles=("mav0",), position_enu_m=(math.nan, 0.0, 1.0)),
        Takeoff(vehicles=("mav0",), height_m=math.inf),
        Move(vehicles=("mav0",), position_enu_m=(0.0, 0.0, 1.0), duration_s=math.nan),
    ):
        done = planned(intent, fleet)
        assert not done.orders
        assert "finite" in done.refusals["mav0"]


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        (Takeoff, {"height_m": "1.2"}, "height_m': it must be a number, not a text"),
        (Takeoff, {"by": 2.5}, "by': it must be a whole number"),
        (Goto, {"goals": {"mav0": (1, 2)}}, "it must be a list of length 3, not 2"),
        (Goto, {"goals": {"mav0": None}}, "it must be a list, not nothing"),
        (Goto, {"goals": {"mav0": (1.0, math.nan, 1.0)}}, "is not finite"),
        (Move, {"position_enu_m": (1.0, 2.0)}, "it must be a list of length 3, not 2"),
        (Formation, {"name": "triangle", "rotation_deg": math.inf}, "is not finite"),
        (Formation, {"name": "triangle", "assign": "far"}, "It may be ids, nearest"),
    ],
)
def test_a_value_that_no_order_may_have_is_refused_in_words_also_without_the_parser(
    fleet: FleetConfig, kind: Any, values: dict[str, Any], words: str
) -> None:
    done = planned(kind(vehicles=ALL, is_everybody=True, **values), fleet)
    assert not done.orders
    assert set(done.refusals) == set(ALL)
    assert words in done.refusals["mav0"]
    assert done.refusals["mav0"].endswith(".")


def test_a_goal_may_be_an_array_of_numpy(fleet: FleetConfig) -> None:
    values: Any = {"goals": {"mav0": np.array([1.0, 2.0, 1.0])}, "yaw_deg": np.float32(90.0)}
    message = planned(Goto(vehicles=("mav0",), **values), fleet).orders["mav0"]
    assert message.position_enu_m == (1.0, 2.0, 1.0)
    assert decode(encode(message), Order) == message


def test_unknown_vehicles_are_refused_one_by_one(fleet: FleetConfig) -> None:
    done = planned(Land(vehicles=("mav0", "ghost")), fleet)
    assert set(done.orders) == {"mav0"}
    assert "not a vehicle" in done.refusals["ghost"]


def test_goals_closer_than_the_law_can_park_are_refused(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    flying = make_telemetry(
        "mav0",
        state="flying",
        is_airborne=True,
        goal_position_enu_m=(1.0, 1.0, 1.0),
        position_enu_m=(0.0, 0.0, 1.0),
    )
    state = fold(initial(fleet), flying, 0)
    near = planned(parse("move mav1 1.5 1 1", fleet), fleet, state)
    assert "0.50 m from mav0's goal" in near.refusals["mav1"]
    assert planned(parse("move mav1 2.2 1 1", fleet), fleet, state).orders


def test_a_planned_order_is_checked_once_more_keeps_its_goals_and_is_stamped_anew(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    first = planned(parse("move mav1,mav2 0 0 1", fleet), fleet, initial(fleet))
    again = check_again(first, fleet, initial(fleet), 7)
    assert {name: order.position_enu_m for name, order in again.orders.items()} == {
        name: order.position_enu_m for name, order in first.orders.items()
    }
    assert {order.order_id for order in again.orders.values()} == {
        order.order_id for order in first.orders.values()
    }
    assert all(order.stamp_ns == 7 < order.deadline_ns for order in again.orders.values())
    goal = first.orders["mav1"].position_enu_m
    near = make_telemetry(
        "mav0", state="flying", is_airborne=True, goal_position_enu_m=goal, position_enu_m=goal
    )
    refused = check_again(first, fleet, fold(initial(fleet), near, 0), 7)
    assert not refused.orders
    assert "mav0's goal" in refused.refusals["mav1"]
    assert "mav1 was refused" in refused.refusals["mav2"]


def test_a_formation_without_position_stays_where_the_vehicles_are(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = initial(fleet)
    for name, (x, y, z) in fleet.formations["triangle"].items():
        state = fold(state, make_telemetry(name, position_enu_m=(x + 0.5, y - 0.5, z + 1.0)), 0)
    done = planned(parse("formation triangle", fleet), fleet, state)
    assert done.orders["mav0"].position_enu_m == pytest.approx((0.5, 0.42, 1.0))
    assert not planned(parse("formation triangle", fleet), fleet, initial(fleet)).orders


@pytest.mark.parametrize(
    ("text", "intent"),
    [
        (
            "formation triangle 1.6",
            Formation(vehicles=ALL, is_everybody=True, name="triangle", spacing_m=1.6),
        ),
        (
            "formation triangle 1.8 0 1.2 1.0 in 8",
            Formation(
                vehicles=ALL,
                is_everybody=True,
                position_enu_m=(0.0, 1.2, 1.0),
                name="triangle",
                spacing_m=1.8,
                duration_s=8.0,
            ),
        ),
        (
            "formation triangle 0-1 2.0",
            Formation(vehicles=("mav0", "mav1"), name="triangle", spacing_m=2.0),
        ),
        ("formation triangle 1", Formation(vehicles=("mav1",), name="triangle")),
        ("locate mav2", Locate(vehicles=("mav2",))),
    ],
)
def test_a_formation_may_be_stretched_and_vehicles_located(
    fleet: FleetConfig, text: str, intent: Intent
) -> None:
    assert parse(text, fleet) == intent
    assert parse(str(intent), fleet) == naming(intent)


@pytest.mark.parametrize("text", ["locate", "formation triangle nan", "formation triangle 1.6 0"])
def test_nobody_and_no_number_are_no_orders(fleet: FleetConfig, text: str) -> None:
    with pytest.raises(OrderError, match=r"Write|finite|not a vehicle"):
        parse(text, fleet)


def test_the_former_name_of_locate_is_answered_with_the_new_one(fleet: FleetConfig) -> None:
    with pytest.raises(OrderError, match="say: locate mav1"):
        parse("identify mav1", fleet)


def test_a_word_that_is_no_order_is_answered_with_the_orders_as_one_writes_them(
    fleet: FleetConfig,
) -> None:
    with pytest.raises(OrderError) as caught:
        parse("takof all", fleet)
    _, _, orders = str(caught.value).rstrip(".").partition("Orders are: ")
    assert "bring home" in orders.split(", ")
    assert "_" not in orders
    assert "'takof' is no order. Did you mean 'takeoff'?" in str(caught.value)


@pytest.mark.parametrize("verb", ["take", "give", "keep"])
def test_control_is_no_order_to_vehicles(fleet: FleetConfig, verb: str) -> None:
    with pytest.raises(OrderError, match=rf"'{verb} control' is no order .* in covey tui or on"):
        parse(f"{verb} control", fleet)


@pytest.mark.parametrize("text", ["formation triangle -1.6 0 0 1", "formation triangle 0.0 0 0 1"])
def test_a_spacing_that_is_none_is_refused(fleet: FleetConfig, text: str) -> None:
    planned = plan_order(
        parse(text, fleet), fleet, None, held=HeldFormation("triangle"), author="x", now_ns=0
    )
    assert not planned.orders
    assert all("no distance" in reason for reason in planned.refusals.values())


def test_the_spacing_is_that_of_the_nearest_slots_and_lasts_for_the_next_move(
    fleet: FleetConfig,
) -> None:
    stretched = slots_of(fleet, "triangle", 2.0)
    spacing_m = min(
        math.dist(stretched[a][:2], stretched[b][:2])
        for a, b in itertools.combinations(stretched, 2)
    )
    assert spacing_m == pytest.approx(2.0)
    assert slots_of(fleet, "triangle") == fleet.formations["triangle"]
    first = plan_order(
        parse("formation triangle 2.0 0 0 1", fleet), fleet, None, held=NONE, author="x", now_ns=0
    )
    assert first.held == HeldFormation("triangle", 2.0)
    then = plan_order(
        parse("move all 0 0.5 1", fleet), fleet, None, held=first.held, author="x", now_ns=0
    )

    for name in ALL:
        before = first.orders[name].position_enu_m
        after = then.orders[name].position_enu_m
        assert before is not None
        assert after is not None
        assert after[1] - before[1] == pytest.approx(0.5)
    assert then.held.spacing_m == 2.0


def test_orders_carry_the_node_by_which_the_operator_is_known(fleet: FleetConfig) -> None:
    planned = plan_order(
        parse("land all", fleet), fleet, None, held=NONE, author="x", now_ns=0, node="ground-1"
    )
    assert {order.node for order in planned.orders.values()} == {"ground-1"}


def test_a_formation_may_be_named_as_an_option_is(fleet: FleetConfig) -> None:
    slots = fleet.formations["triangle"]
    named = msgspec.structs.replace(
        fleet, formations={"nearest": slots, "turned": slots, "in": slots, "yaw": slots}
    )
    for name in named.formations:
        order = parse(f"formation {name} nearest turned 90 yaw 10 in 8", named)
        assert isinstance(order, Formation)
        assert (order.name, order.assign, order.rotation_deg) == (name, "nearest", 90.0)
        assert parse(str(order), named) == naming(order)
        plain = parse(f"formation {name}", named)
        assert isinstance(plain, Formation)
        assert (plain.name, plain.assign) == (name, "ids")


@pytest.mark.parametrize(
    ("shouted", "said"),
    [
        ("HOLD ALL", "hold all"),
        ("Land All", "land all"),
        ("MOVE mav1 0 0 1 YAW 90 IN 5 s", "move mav1 0 0 1 yaw 90 in 5 s"),
        ("formation triangle 3.0 NEAREST", "formation triangle 3.0 nearest"),
    ],
)
def test_words_of_an_order_may_be_written_in_capitals(
    fleet: FleetConfig, shouted: str, said: str
) -> None:
    assert parse(shouted, fleet) == parse(said, fleet)


@pytest.mark.parametrize(("duration_s", "is_refused"), [(3600.0, False), (3601.0, True)])
def test_a_move_takes_as_long_as_a_vehicle_accepts(
    fleet: FleetConfig, duration_s: float, is_refused: bool
) -> None:
    intent = Move(vehicles=("mav0",), position_enu_m=(0.0, 0.0, 1.0), duration_s=duration_s)
    planned = plan_order(
        intent, fleet, None, held=NONE, author="test", now_ns=0, new_id=itertools.count().__str__
    )
    assert bool(planned.refusals) is is_refused


@pytest.mark.parametrize("word", sorted(WORDS))
def test_no_vehicle_has_the_name_of_a_word_of_orders(fleet: FleetConfig, word: str) -> None:
    vehicles = dict(fleet.vehicles)
    vehicles[word] = msgspec.structs.replace(vehicles.pop("mav2"), name=word)
    named = msgspec.structs.replace(fleet, vehicles=vehicles)
    with pytest.raises(ConfigError, match=f"A vehicle is named '{word}'"):
        check_fleet(named, needs_folders=False)
