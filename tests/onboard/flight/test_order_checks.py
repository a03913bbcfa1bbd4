"""Orders that are refused, each with a reason that a person can act on."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.bus.schema import Order, Telemetry
from onboard.config.fences import Fence
from onboard.config.obstacles import Obstacle
from onboard.estimation import wind
from onboard.flight.context import FlightContext
from onboard.flight.order_checks import refusal
from onboard.flight.types import FlightStep
from tests.onboard.agent.rig import Rig, fleet, hovering_rig, ready_rig


def _neighbour(rig: Rig, **changes: object) -> None:
    base = rig.telemetry
    assert base is not None
    message: Telemetry = msgspec.structs.replace(base, vehicle="mav1", **changes)
    rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)


FLYING: list[tuple[str, dict[str, object], str]] = [
    ("move", {"position_enu_m": (5.0, 0.0, 1.0)}, "outside the geofence"),
    ("move", {"position_enu_m": (0.0, 0.0, 3.5)}, "outside the geofence"),
    ("move", {"position_enu_m": (0.0, 0.0, 0.05)}, "above the ground"),
    ("move", {"position_enu_m": (math.nan, 0.0, 1.0)}, "finite"),
    ("move", {"position_enu_m": None}, "finite"),
    ("move", {"position_enu_m": (1.0, 0.0, 1.0), "duration_s": math.inf}, "cannot take"),
    ("move", {"position_enu_m": (1.0, 0.0, 1.0), "yaw_deg": math.nan}, "finite number of degrees"),
    ("takeoff", {"height_m": 1.0}, "cannot start now"),
    ("arm", {}, "cannot start now"),
    ("disarm", {}, "in the air"),
    ("hold", {"deadline_ns": 1}, "deadline"),
]


def test_a_flying_vehicle_refuses() -> None:
    rig = hovering_rig()
    for kind, fields, words in FLYING:
        reply = rig.order(kind, **fields)  # type: ignore[arg-type]
        assert not reply.is_accepted, (kind, fields)
        assert words in reply.reason, (kind, fields)
        assert rig.core.flight.state == "flying"


HOUSE = {"name": "house", "keep": "out", "polygon_enu_m": [[2, 2], [3, 2], [3, 3], [2, 3]]}
FIELD = {"name": "field", "keep": "in", "circle": {"center_enu_m": [0, 0], "radius_m": 3.9}}


def in_a_field() -> Rig:
    plain = fleet()
    fences = msgspec.convert([HOUSE | {"buffer_m": 0.5}, FIELD], tuple[Fence, ...])
    fenced = msgspec.structs.replace(plain, fences=fences)
    return Rig(AgentCore(fenced, "mav0", boot_id=7))


def test_goals_outside_a_field_or_in_a_house_are_refused_by_the_vehicle() -> None:
    rig = in_a_field()
    rig.fly()
    for goal, words in (
        ((2.5, 2.5, 1.0), "lies inside the fence 'house', which is to stay out of"),
        ((1.7, 2.5, 1.0), "0.30 m from the edge of the fence 'house', whose buffer is 0.5 m"),
        ((3.0, -3.0, 1.0), "lies outside the fence 'field'"),
    ):
        reply = rig.order("move", position_enu_m=goal)
        assert not reply.is_accepted
        assert words in reply.reason
    assert rig.order("move", position_enu_m=(1.0, 2.0, 1.0)).is_accepted


def test_a_goal_behind_a_wall_or_too_near_to_it_is_refused_by_the_vehicle() -> None:
    wall = {"name": "wall", "polygon_enu_m": [[2.0, -5.0], [2.2, -5.0], [2.2, 5.0], [2.0, 5.0]]}
    walled = msgspec.structs.replace(
        fleet(), obstacles=msgspec.convert([wall], tuple[Obstacle, ...])
    )
    rig = Rig(AgentCore(walled, "mav0", boot_id=7))
    rig.fly()
    reply = rig.order("move", position_enu_m=(3.0, 0.0, 1.0))
    assert not reply.is_accepted
    assert "cannot be reached from (0.00, 0.00): no way around the obstacles" in reply.reason
    assert rig.order("move", position_enu_m=(1.0, 0.0, 1.0)).is_accepted

    reply = rig.order("move", position_enu_m=(1.8, 0.0, 1.0))
    assert not reply.is_accepted
    assert "it is 0.25 m too near to an obstacle, of which mav0 keeps 0.45 m clear" in reply.reason


def test_outside_a_field_a_vehicle_holds_inside_of_it_and_then_lands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # what carries it looks like a gust, for which it would land
    monkeypatch.setattr(wind, "step", lambda memory, *_: memory)
    rig = in_a_field()
    rig.fly()
    rig.carry(2.9, -2.9, 1.0)
    assert rig.core.flight.state == "holding"
    assert math.hypot(*rig.core.flight.goal_position_enu_m[:2]) < 3.9

    def is_blown_outside() -> None:
        rig.position[:2] = (2.9, -2.9)
        rig.velocity[:] = 0.0

    rig.after_move = is_blown_outside
    rig.run(2.5)
    assert rig.core.flight.state == "landing"
    assert rig.core.flight.reason == "Geofence crossed for long: landing."


ON_GROUND: list[tuple[str, dict[str, object], str]] = [
    ("move", {"position_enu_m": (1.0, 0.0, 1.0)}, "does not fly"),
    ("hold", {}, "does not fly"),
    ("land", {}, "not in the air"),
    ("takeoff", {"height_m": 4.0}, "outside the geofence"),
    ("takeoff", {"height_m": 0.1}, "does not leave the ground"),
    ("takeoff", {"height_m": math.nan}, "does not leave the ground"),
    ("takeoff", {"height_m": 1.0, "deadline_ns": 1}, "deadline"),
]


def test_a_vehicle_on_the_ground_refuses() -> None:
    rig = ready_rig()
    for kind, fields, words in ON_GROUND:
        reply = rig.order(kind, **fields)  # type: ignore[arg-type]
        assert not reply.is_accepted, (kind, fields)
        assert words in reply.reason, (kind, fields)
    rig.run(0.5)
    assert rig.count(agent_commands.SendAttitude) == 0


def test_a_killed_vehicle_says_that_it_was_killed() -> None:
    rig = hovering_rig()
    assert rig.order("kill").is_accepted
    rig.until("landed")
    for kind in ("land", "move", "hold"):
        reply = rig.order(kind, position_enu_m=(1.0, 0.0, 1.0))
        assert not reply.is_accepted
        assert reply.reason.startswith("Killed by order of tester. It is landed"), reply


def test_a_vehicle_whose_motors_are_just_being_stopped_says_that_it_was_killed() -> None:
    rig = hovering_rig()
    assert rig.order("kill").is_accepted
    for kind in ("takeoff", "arm", "move", "hold", "follow_path"):
        reply = rig.order(kind, position_enu_m=(1.0, 0.0, 1.0), height_m=1.5)
        assert not reply.is_accepted
        assert reply.reason.startswith("Killed by order of tester. It is failed"), reply


def test_a_vehicle_that_px4_lands_says_so_and_what_can_be_done() -> None:
    config = fleet()
    flight = FlightContext(
        fleet=config,
        vehicle=config.vehicles["mav0"],
        step=FlightStep.PX4_LANDING,
        reason="The link was lost.",
    )
    facts: Any = SimpleNamespace(view=SimpleNamespace(now_ns=1, is_flown_by_hand=False))
    for kind in ("hold", "move"):
        order = Order(
            order_id="o1",
            author="tester",
            kind=kind,
            stamp_ns=0,
            deadline_ns=0,
            position_enu_m=None,
            height_m=0.0,
            duration_s=0.0,
        )
        reason = refusal(order, flight, facts) or ""
        assert "PX4 is landing the vehicle by itself (The link was lost)" in reason
        assert "order kill if it must fall" in reason


def test_a_vehicle_that_lands_is_to_be_waited_for() -> None:
    rig = hovering_rig()
    assert rig.order("land").is_accepted
    rig.until("landing")
    reply = rig.order("hold")
    assert not reply.is_accepted
    assert "wait until it is down" in reply.reason


def test_a_vehicle_that_is_not_ready_says_the_first_reason() -> None:
    rig = Rig()
    rig.has_mocap = False
    rig.run(0.5)
    assert rig.core.flight.state == "waiting"
    reply = rig.order("takeoff", height_m=1.0)
    assert not reply.is_accepted
    assert "mocap body 'mav0'" in reply.reason
    assert rig.telemetry is not None
    assert rig.telemetry.not_ready == (reply.reason,)


def test_wrong_parameters_of_px4_refuse_the_take_off() -> None:
    rig = Rig()
    rig.core.handle(
        agent_inputs.ParamsRead(("PX4 parameter COM_OF_LOSS_T is 1, this fleet needs 0.3.",)),
        rig.now_ns,
    )
    rig.run(0.5)
    assert "COM_OF_LOSS_T" in rig.order("takeoff", height_m=1.0).reason


def test_another_fleet_file_on_a_neighbour_refuses_the_take_off() -> None:
    rig = ready_rig()
    _neighbour(rig, config_hash="another", position_enu_m=(3.0, 0.0, 0.0))
    rig.run(0.1)
    assert "mav1 flies with another fleet file" in rig.order("takeoff", height_m=1.0).reason


def test_a_neighbour_within_the_safety_distance_refuses_the_take_off() -> None:
    rig = ready_rig()
    _neighbour(rig, position_enu_m=(0.5, 0.0, 0.0))
    assert "mav1 stands 0.50 m away" in rig.order("takeoff", height_m=1.0).reason


def test_a_take_off_under_a_flying_vehicle_is_refused_unless_it_stays_far_enough_below() -> None:
    cylinders = fleet()
    section = msgspec.structs.replace(cylinders.fleet, vertical_separation_m=1.2)
    rig = Rig(core=AgentCore(msgspec.structs.replace(cylinders, fleet=section), "mav0", boot_id=7))
    rig.until("ready")
    same = rig.telemetry.config_hash if rig.telemetry is not None else ""
    _neighbour(
        rig, position_enu_m=(0.5, 0.0, 2.5), is_airborne=True, state="flying", config_hash=same
    )
    assert "mav1 flies 0.50 m beside the way up" in rig.order("takeoff", height_m=2.0).reason
    assert rig.order("takeoff", height_m=1.0).is_accepted


def test_a_goal_above_a_vehicle_on_the_ground_is_refused() -> None:
    rig = hovering_rig()
    _neighbour(rig, position_enu_m=(2.0, 0.0, 0.0), is_airborne=False, state="landed")
    reply = rig.order("move", position_enu_m=(2.0, 0.3, 1.0))
    assert "0.30 m from mav1" in reply.reason


def test_two_vehicles_may_swap_their_places() -> None:
    rig = hovering_rig()
    _neighbour(
        rig, position_enu_m=(2.0, 0.0, 1.0), goal_position_enu_m=(2.0, 0.0, 1.0), is_airborne=True
    )
    reply = rig.order("move", position_enu_m=(2.0, 0.0, 1.0))
    assert reply.is_accepted
    _neighbour(
        rig, position_enu_m=(1.9, 0.0, 1.0), goal_position_enu_m=(0.0, 0.0, 1.0), is_airborne=True
    )
    rig.run(1.0)
    assert rig.core.flight.state == "flying"
    assert reply.order_id not in rig.outcomes()


def test_a_goal_on_a_neighbours_goal_is_given_up_with_a_reason() -> None:
    rig = hovering_rig()
    _neighbour(
        rig, position_enu_m=(3.0, 3.0, 1.0), goal_position_enu_m=(2.0, 0.0, 1.0), is_airborne=True
    )
    reply = rig.order("move", position_enu_m=(2.0, 0.4, 1.0))
    rig.run(1.0)
    # the other may have been ordered elsewhere, and its message be late
    assert reply.order_id not in rig.outcomes()
    rig.run(1.0)
    assert rig.outcomes()[reply.order_id] == "refused"
    assert rig.core.flight.state == "holding"


def test_land_after_giving_up_lets_px4_land() -> None:
    rig = hovering_rig()
    rig.mode = "HOLD"
    rig.run(1.2)
    assert rig.core.flight.state == "failed"
    reply = rig.order("land")
    assert reply.is_accepted
    rig.until("landed")
    assert rig.count(agent_commands.Px4Land) >= 1
    assert rig.outcomes()[reply.order_id] == "done"


def test_kill_is_never_refused_not_even_late() -> None:
    rig = Rig()
    rig.run(0.1)
    assert rig.order("kill", deadline_ns=1).is_accepted


def _end_of(rig: Rig, kind: str) -> tuple[str, str]:
    """Return outcome and sentence of the newest order of this kind."""
    event = [one for one in rig.events if one.code == f"order-{kind}"][-1]
    return event.order_outcome, event.sentence


def test_home_and_land_of_a_vehicle_that_stands_at_home_after_its_flight_are_done() -> None:
    rig = hovering_rig()
    assert rig.order("land").is_accepted
    rig.until("landed")

    assert rig.order("land").is_accepted
    assert _end_of(rig, "land") == ("done", "It stands on the ground already, disarmed.")

    home: dict[str, Any] = {"position_enu_m": (0.1, 0.0, 1.0), "then_land": True}
    assert rig.order("move", **home).is_accepted
    assert _end_of(rig, "move")[0] == "done"
    assert "take-off spot already" in _end_of(rig, "move")[1]
    assert rig.core.flight.state == "landed"
    assert not rig.order("move", position_enu_m=(0.1, 0.0, 1.0)).is_accepted


def test_home_of_a_vehicle_that_has_not_flown_is_done_at_home_and_refused_elsewhere() -> None:
    rig = ready_rig()
    assert rig.order("move", position_enu_m=(0.1, 0.0, 1.0), then_land=True).is_accepted
    assert rig.core.flight.state == "ready"
    reply = rig.order("move", position_enu_m=(2.0, 0.0, 1.0), then_land=True)
    assert "mav0 stands 2.0 m from its take-off spot: order take-off first" in reply.reason


def test_a_vehicle_that_fell_says_so_until_it_starts_again() -> None:
    rig = hovering_rig()
    rig.is_armed = False  # PX4 stops the motors in the air
    rig.has_lift = False
    rig.until("failed")
    rig.until("landed")
    for kind in ("land", "move"):
        reply = rig.order(kind, position_enu_m=(0.0, 0.0, 1.0), then_land=kind == "move")
        assert not reply.is_accepted
        assert reply.reason.startswith("mav0 fell: PX4 disarmed"), reply
        assert "Look at it" in reply.reason
