"""Which orders are refused, from the facts alone: every limit, and a little beside it."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.avoidance.params import law_params, still
from onboard.bus.schema import Order, OrderKind, PathOrder, Telemetry
from onboard.config.fences import Fence
from onboard.config.fleet import FleetConfig
from onboard.control.path import path_of
from onboard.control.router import surroundings
from onboard.flight import order_checks
from onboard.flight.context import FlightContext
from onboard.flight.follow_flight import FollowFlight
from onboard.flight.order_checks import OrderFacts
from onboard.flight.path_flight import PathFlight
from onboard.flight.types import FlightStep, FlightView
from tests.groundstation.console.fake import telemetry
from tests.onboard.agent.rig import fleet
from tests.onboard.flight.open_space import OPEN_SPACE

_FLEET = fleet()  # 0.8 m apart, in a box of 8 m that is 3 m high
_VEHICLE = _FLEET.vehicles["mav0"]
_BY_SATELLITES = replace(_VEHICLE, mocap_required=False)
_HEIGHTS_COUNT = replace(_FLEET, fleet=replace(_FLEET.fleet, vertical_separation_m=1.6))
_HEIGHTS_COUNT_LITTLE = replace(_FLEET, fleet=replace(_FLEET.fleet, vertical_separation_m=10.0))
_NOW_NS = 50_000_000_000

_RESTING = path_of([[100.0, *[0.0] * 16, 1.0, *[0.0] * 15]])  # a metre above the origin
_ON_PATH = PathFlight(path=_RESTING, path_id="p", show_id="s", time_s=10.0)
_LOADED = PathFlight(path=_RESTING, path_id="p")
_SHOW = PathOrder(path_id="p", show_id="s", start_ns=_NOW_NS + 10**10)
_GOAL = (1.0, 0.0, 1.0)


def _order(kind: OrderKind, **changes: Any) -> Order:
    values = {"order_id": "o", "author": "Ada", "stamp_ns": 0, "deadline_ns": 0, **changes}
    return Order(kind=kind, **values)


def _flight(step: FlightStep = FlightStep.HOLDING, **changes: Any) -> FlightContext:
    return FlightContext(**{"fleet": _FLEET, "vehicle": _VEHICLE, "step": step, **changes})


def _view(**changes: Any) -> FlightView:
    """What is seen a metre above the origin; the changes may be of the view or of PX4."""
    in_view = {name: changes.pop(name) for name in list(changes) if hasattr(FlightView, name)}
    view = FlightView(
        now_ns=_NOW_NS,
        position_enu_m=(0.0, 0.0, 1.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        has_position=True,
        snapshot=Snapshot(**{"landed_ns": _NOW_NS, "battery_frac": 0.9, **changes}),
    )
    return replace(view, **in_view)


def _facts(view: FlightView | None = None, **changes: Any) -> OrderFacts:
    values = {
        "view": view or _view(),
        "fleet": _FLEET,
        "surroundings": OPEN_SPACE,
        "others": {},
        "last_positions_enu_m": {},
        "distances_m": {},
        "not_ready": (),
        "not_ready_in_air": lambda: (),
    }
    return OrderFacts(**{**values, **changes})


def _refused(order: Order, flight: FlightContext, facts: OrderFacts | None = None) -> str:
    """The words of a refusal; empty for an order that is accepted."""
    return order_checks.refusal(order, flight, facts or _facts()) or ""


def _check(refused: str, words: str) -> None:
    """Compare a refusal with words of it; without words, nothing may be refused."""
    assert words in refused
    assert bool(words) is bool(refused)


# -- every order -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("deadline_ns", "words"),
    [
        (0, ""),
        (_NOW_NS, ""),
        (_NOW_NS + 1, ""),
        (_NOW_NS - 1, "came 0.0 s after"),
        (_NOW_NS - 1_500_000_000, "came 1.5 s after its deadline"),
    ],
)
def test_an_order_is_late_from_its_deadline_on(deadline_ns: int, words: str) -> None:
    _check(_refused(_order("hold", deadline_ns=deadline_ns), _flight()), words)


def test_an_order_without_an_id_is_refused_unless_it_kills() -> None:
    _check(_refused(_order("hold", order_id=""), _flight()), "needs an id of its own")
    _check(_refused(_order("kill", order_id="", deadline_ns=1), _flight()), "")


@pytest.mark.parametrize("kind", ["hold", "takeoff", "arm", "land", "move"])
def test_the_sticks_of_a_pilot_are_overruled_only_for_a_landing_by_name(kind: OrderKind) -> None:
    sticks = {"sticks_ns": _NOW_NS, "sticks_before_ns": _NOW_NS - 10**8}
    by_hand = _facts(_view(is_armed=True, mode="POSCTL", **sticks))
    silent = _flight(FlightStep.FAILED)
    for reason in ("", "mission"):
        refused = _refused(_order(kind, reason=reason), silent, by_hand)
        if kind == "hold":
            _check(refused, "PX4 flies by itself (mode POSCTL)")
        elif kind == "land":
            _check(refused, "`land mav0` takes it" if reason else "")
        else:
            _check(refused, "flown by hand: once its pilot has switched to hold")
    _check(_refused(_order("land", reason="mission"), silent), "")

    # where the agent still flies, nothing is overruled
    flies = _flight(FlightStep.HOLDING)
    _check(_refused(_order("move", position_enu_m=_GOAL), flies, by_hand), "")


@pytest.mark.parametrize(
    ("kind", "step", "words"),
    [
        ("arm", FlightStep.ARMED, "is armed already"),
        ("arm", FlightStep.LEG, "cannot start now: it is flying (on the way)"),
        ("takeoff", FlightStep.ARM_OFFBOARD, "cannot start now"),
        ("takeoff", FlightStep.PX4_LANDING, "cannot start now: it is landing"),
        ("reboot", FlightStep.HOLDING, "on the ground only, disarmed: it is holding"),
        ("disarm", FlightStep.HOLDING, "is in the air: order land"),
        ("follow_path", FlightStep.CLIMB, "No path begins while it is taking off (climb)"),
        ("follow_path", FlightStep.READY, "does not fly (it is ready)"),
        ("land", FlightStep.WAITING, "is not in the air (it is waiting)"),
        ("land", FlightStep.DISARMED, "is not in the air"),
        ("hold", FlightStep.DESCENT, "wait until it is down"),
        ("move", FlightStep.COASTING, "has lost its position"),
        ("hold", FlightStep.READY, "does not fly (it is ready)"),
        ("move", FlightStep.ARMED, "does not fly (it is armed)"),
        ("move", FlightStep.PX4_LANDING, "PX4 is landing the vehicle by itself, and"),
    ],
)
def test_an_order_of_another_step_says_what_the_vehicle_does(
    kind: OrderKind, step: FlightStep, words: str
) -> None:
    _check(_refused(_order(kind), _flight(step)), words)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("takeoff", "and cannot start now: look at it first"),
        ("move", "look at it before you order take-off"),
    ],
)
def test_who_was_killed_is_to_be_looked_at(kind: OrderKind, words: str) -> None:
    killed = _flight(FlightStep.KILLING, was_killed=True, reason="Killed.")
    _check(_refused(_order(kind, position_enu_m=_GOAL), killed), words)

    # a reason of PX4's own landing is not that of a kill
    landing = _flight(FlightStep.PX4_LANDING, reason="The link was lost.")
    _check(_refused(_order("hold"), landing), "PX4 is landing the vehicle by itself (The link was")


@pytest.mark.parametrize("step", [FlightStep.CONTACT, FlightStep.FAILED, FlightStep.KILLING])
@pytest.mark.parametrize("landed", [Landed.ON_GROUND, Landed.IN_AIR])
def test_a_vehicle_that_may_be_up_is_disarmed_only_where_px4_reports_the_ground(
    step: FlightStep, landed: Landed
) -> None:
    facts = _facts(_view(landed=landed))
    words = "" if landed is Landed.ON_GROUND else "does not say that the vehicle is on the ground"
    _check(_refused(_order("disarm"), _flight(step), facts), words)
    _check(_refused(_order("disarm"), _flight(FlightStep.READY), facts), "")


# -- beside the flight -----------------------------------------------------------------------------


def test_a_path_is_loaded_beside_the_flight_and_its_parts_are_checked() -> None:
    _check(_refused(_order("identify"), _flight(FlightStep.PX4_LANDING)), "")
    _check(_refused(_order("load_path"), _flight()), "needs one of its parts")


@pytest.mark.parametrize("kind", ["pause", "resume", "skip"])
def test_a_path_is_paused_while_it_is_followed_and_a_vehicle_that_is_followed_likewise(
    kind: OrderKind,
) -> None:
    _check(_refused(_order(kind), _flight()), "follows no path")
    _check(_refused(_order(kind), _flight(FlightStep.PATH, path=_ON_PATH)), "")
    follows = _flight(FlightStep.LEG, follow=FollowFlight(leader="mav1"))
    _check(_refused(_order(kind), follows), "")


@pytest.mark.parametrize("kind", ["disable", "stand_in"])
@pytest.mark.parametrize(
    ("step", "is_armed", "words"),
    [
        (FlightStep.READY, False, ""),
        (FlightStep.LANDED, False, ""),
        (FlightStep.READY, True, "it is armed"),
        (FlightStep.HOLDING, False, "it is holding"),
    ],
)
def test_a_vehicle_goes_out_of_service_and_stands_in_on_the_ground_only(
    kind: OrderKind, step: FlightStep, is_armed: bool, words: str
) -> None:
    at_its_spot = _facts(_view(is_armed=is_armed, position_enu_m=(0.0, 0.0, 0.0)))
    _check(_refused(_order(kind, stands_in_for="mav0"), _flight(step), at_its_spot), words)


def test_who_does_not_know_where_it_stands_stands_in_for_nobody() -> None:
    lost = _facts(_view(has_position=False, position_enu_m=(0.0, 0.0, 0.0)))
    order = _order("stand_in", stands_in_for="mav0")
    _check(_refused(order, _flight(FlightStep.READY), lost), "does not report where it stands")


@pytest.mark.parametrize(
    ("place", "disabled_by", "words"),
    [("mav0", "", "mav1 stands in for mav0"), ("mav0", "Ada", ""), ("", "", ""), ("mav2", "", "")],
)
def test_who_has_a_stand_in_that_flies_is_not_enabled(
    place: str, disabled_by: str, words: str
) -> None:
    other = telemetry("mav1", stands_in_for=place, disabled_by=disabled_by)
    facts = _facts(others={"mav1": other})
    _check(_refused(_order("enable"), _flight(FlightStep.READY), facts), words)


# -- at rest ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [FlightStep.WAITING, FlightStep.READY, FlightStep.LANDED])
@pytest.mark.parametrize(
    ("view", "order", "words"),
    [
        ({}, {}, ""),
        ({"position_enu_m": (0.5, 0.0, 9.0)}, {}, ""),  # how high it stands does not count
        ({"position_enu_m": (0.51, 0.0, 0.0)}, {}, "stands 0.5 m from its take-off spot"),
        ({"is_armed": True}, {}, "does not fly"),
        ({"has_position": False}, {}, "does not fly"),
        ({}, {"then_land": False}, "does not fly"),
        ({}, {"position_enu_m": None}, "does not fly"),
    ],
)
def test_home_is_done_already_where_the_vehicle_stands_disarmed_on_its_spot(
    step: FlightStep, view: dict[str, Any], order: dict[str, Any], words: str
) -> None:
    home = _order("move", **{"position_enu_m": (0.0, 0.0, 0.0), "then_land": True, **order})
    seen = _view(**{"position_enu_m": (0.0, 0.0, 0.0), **view})
    _check(_refused(home, _flight(step), _facts(seen)), words)


@pytest.mark.parametrize(
    ("changes", "is_armed", "words"),
    [
        ({}, False, ""),
        ({}, True, "is not in the air"),
        ({"has_fallen": True}, False, "mav0 fell"),
        ({"was_killed": True}, False, "look at it before"),
    ],
)
def test_land_is_done_already_where_the_vehicle_stands_unless_somebody_has_to_look_at_it(
    changes: dict[str, Any], is_armed: bool, words: str
) -> None:
    facts = _facts(_view(is_armed=is_armed))
    _check(_refused(_order("land"), _flight(FlightStep.LANDED, **changes), facts), words)


# -- a start ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["arm", "takeoff"])
def test_nothing_starts_out_of_service_or_against_the_preflight_check(kind: OrderKind) -> None:
    ready = _flight(FlightStep.READY)
    disabled = _flight(FlightStep.READY, disabled_by="Ada")
    _check(_refused(_order(kind), disabled), "is disabled by Ada")
    not_ready = _facts(not_ready=("The first.", "The second."))
    assert _refused(_order(kind), ready, not_ready) == "The first."
    _check(_refused(_order("arm", height_m=99.0), ready), "")


@pytest.mark.parametrize(
    ("height_m", "words"),
    [
        (0.7, ""),
        (0.69, "order at least 0.7 m"),
        (math.inf, "does not leave the ground"),
        (3.0, ""),
        (3.01, "outside the geofence"),
    ],
)
def test_a_take_off_leaves_the_ground_and_stays_in_the_fence(height_m: float, words: str) -> None:
    stands = _facts(_view(position_enu_m=(0.0, 0.0, 0.5)))
    order = _order("takeoff", height_m=height_m)
    _check(_refused(order, _flight(FlightStep.READY), stands), words)


@pytest.mark.parametrize(
    ("height_m", "words"),
    [(1.0, ""), (3.0, "A fence is above (0.00, 0.00) m, on the way up to 3 m: carry the vehicle")],
)
def test_a_vehicle_below_a_fence_does_not_take_off_beyond_it(height_m: float, words: str) -> None:
    bridge = {
        "name": "bridge",
        "keep": "out",
        "height_m": [1.5, 2.2],
        "buffer_m": 0.3,
        "circle": {"center_enu_m": [0.0, 0.0], "radius_m": 1.5},
    }
    config = replace(_FLEET, fences=msgspec.convert([bridge], tuple[Fence, ...]))
    stands = _facts(
        _view(position_enu_m=(0.0, 0.0, 0.0)),
        fleet=config,
        surroundings=surroundings(still(config), law_params(config, "mav0")),
    )
    order = _order("takeoff", height_m=height_m)
    _check(_refused(order, _flight(FlightStep.READY), stands), words)


def _other(x_m: float, z_m: float, **changes: Any) -> dict[str, Telemetry]:
    return {"mav1": telemetry("mav1", position_enu_m=(x_m, 0.0, z_m), **changes)}


@pytest.mark.parametrize(
    ("config", "others", "words"),
    [
        (_FLEET, _other(0.8, 0.0), ""),
        (_FLEET, _other(0.79, 0.0), "mav1 stands 0.79 m away"),
        (_FLEET, _other(0.79, 9.0), "mav1 stands 0.79 m away"),  # heights do not count
        (_FLEET, _other(0.79, 0.0, is_position_valid=False), ""),
        (_HEIGHTS_COUNT, _other(0.3, 2.59), "mav1 flies 0.30 m beside the way up, at a height of"),
        (_HEIGHTS_COUNT, _other(0.3, 2.61), ""),
        (_HEIGHTS_COUNT, _other(0.3, 0.5), "at a height of 0.50 m"),
        (_HEIGHTS_COUNT, _other(0.3, -1.59), "mav1 flies 0.30 m beside"),
        (_HEIGHTS_COUNT, _other(0.3, -1.61), ""),
        (_HEIGHTS_COUNT, _other(0.3, 0.0, is_airborne=False), "mav1 stands 0.30 m away"),
        (_HEIGHTS_COUNT_LITTLE, _other(0.3, 9.0), "mav1 flies 0.30 m beside the way up"),
    ],
)
def test_a_take_off_keeps_its_distance_from_whoever_is_beside_the_way_up(
    config: FleetConfig, others: dict[str, Telemetry], words: str
) -> None:
    facts = _facts(_view(position_enu_m=(0.0, 0.0, 0.0)), fleet=config, others=others)
    _check(_refused(_order("takeoff", height_m=1.0), _flight(FlightStep.READY), facts), words)


@pytest.mark.parametrize(
    ("is_armed", "landed", "words"),
    [
        (False, Landed.ON_GROUND, ""),
        (False, Landed.UNKNOWN, "starts anew there only"),
        (True, Landed.ON_GROUND, "PX4 is armed"),
    ],
)
def test_px4_starts_anew_disarmed_on_the_ground_only(
    is_armed: bool, landed: Landed, words: str
) -> None:
    facts = _facts(_view(is_armed=is_armed, landed=landed))
    _check(_refused(_order("reboot"), _flight(FlightStep.READY), facts), words)


# -- a path and a move -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("battery_frac", "words"),
    [(0.3, ""), (0.299, "at 30 %, below 30 %"), (0.1, "The battery is at 10 %")],
)
def test_no_path_is_begun_with_a_weak_battery(battery_frac: float, words: str) -> None:
    facts = _facts(_view(battery_frac=battery_frac))
    order = _order("follow_path", path=_SHOW)
    _check(_refused(order, _flight(path=_LOADED), facts), words)


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ({}, ""),
        ({"position_enu_m": None}, "needs a finite position"),
        ({"position_enu_m": (1.0, math.nan, 1.0)}, "needs a finite position"),
        ({"duration_s": 3600.0}, ""),
        ({"duration_s": 3600.1}, "give up to 3600 s"),
        ({"duration_s": math.nan}, "cannot take nan s"),
        ({"yaw_deg": 90.0}, ""),
        ({"yaw_deg": math.inf}, "A heading needs a finite number"),
        ({"position_enu_m": (4.01, 0.0, 1.0)}, "outside the geofence"),
        ({"position_enu_m": (0.0, 0.0, 0.2)}, ""),
        ({"position_enu_m": (9.0, 0.0, 0.19)}, "outside the geofence"),
        ({"position_enu_m": (0.0, 0.0, 0.19)}, "less than 0.2 m above the ground at 0 m. Choose"),
    ],
)
def test_a_move_leads_to_a_goal_that_can_be_flown_to(order: dict[str, Any], words: str) -> None:
    _check(_refused(_order("move", **{"position_enu_m": _GOAL, **order}), _flight()), words)


def test_goals_are_higher_for_a_vehicle_whose_height_errs() -> None:
    flight = _flight(vehicle=_BY_SATELLITES)
    _check(_refused(_order("move", position_enu_m=(0.0, 0.0, 0.5)), flight), "")
    refused = _refused(_order("move", position_enu_m=(0.0, 0.0, 0.49)), flight)
    _check(refused, "above the ground at 0 m (its height is PX4's own, which errs by that much)")


@pytest.mark.parametrize("then_land", [True, False])
@pytest.mark.parametrize(
    ("goal_enu_m", "words"),
    [
        ((1.5, 0.0, 2.2), ""),
        ((1.5, 0.0, 2.19), "less than 0.2 m above the ground at 2 m"),
        ((0.0, 0.0, 0.2), ""),
    ],
)
def test_a_goal_over_a_raised_spot_is_above_that_spot(
    goal_enu_m: tuple[float, float, float], words: str, then_land: bool
) -> None:
    raised = replace(_FLEET.vehicles["mav1"], start_enu_m=(1.5, 0.0, 2.0))
    hill = replace(_FLEET, vehicles={**_FLEET.vehicles, "mav1": raised})
    order = _order("move", position_enu_m=goal_enu_m, then_land=then_land)
    high = _view(position_enu_m=(0.0, 0.0, 2.2))
    _check(_refused(order, _flight(), _facts(high, fleet=hill)), words)


def test_a_goal_over_a_raised_spot_is_not_flown_to_through_its_side() -> None:
    raised = replace(_FLEET.vehicles["mav1"], start_enu_m=(1.5, 0.0, 2.0))
    hill = replace(_FLEET, vehicles={**_FLEET.vehicles, "mav1": raised})
    order = _order("move", position_enu_m=(1.5, 0.0, 2.4))
    for height_m, words in ((1.0, "the raised ground of a take-off spot"), (2.2, "")):
        seen = _facts(_view(position_enu_m=(0.0, 0.0, height_m)), fleet=hill)
        _check(_refused(order, _flight(), seen), words)


@pytest.mark.parametrize(
    ("config", "others", "words"),
    [
        (_FLEET, _other(1.8, 0.0, is_airborne=False, state="landed"), ""),
        (_FLEET, _other(1.79, 0.0, is_airborne=False, state="landed"), "0.79 m from mav1, which"),
        (_FLEET, _other(1.79, 0.0, is_airborne=False, is_position_valid=False), ""),
        (_FLEET, _other(1.0, 1.0, state="flying"), ""),  # it may fly away
        (_FLEET, _other(1.79, 3.0, state="landing"), "which is landing"),
        (_HEIGHTS_COUNT, _other(1.3, 3.0, state="landing"), "which is landing"),
        (_HEIGHTS_COUNT, _other(1.3, -0.59, state="landing"), "which is landing"),
        (_HEIGHTS_COUNT, _other(1.3, -0.61, state="landing"), ""),
        (_HEIGHTS_COUNT, _other(1.3, 2.61, is_airborne=False, state="landed"), ""),
        (_HEIGHTS_COUNT, _other(1.3, 2.59, is_airborne=False, state="landed"), "which is landed"),
    ],
)
def test_a_goal_keeps_its_distance_from_who_stays_on_the_ground_or_lands(
    config: FleetConfig, others: dict[str, Telemetry], words: str
) -> None:
    facts = _facts(fleet=config, others=others)
    _check(_refused(_order("move", position_enu_m=_GOAL), _flight(), facts), words)


@pytest.mark.parametrize(
    ("last_x_m", "words"),
    [(1.8, ""), (1.79, "0.79 m from mav1, which is landed and was last seen there")],
)
def test_a_goal_keeps_its_distance_from_who_stands_without_a_position(
    last_x_m: float, words: str
) -> None:
    others = _other(0.0, 0.0, is_airborne=False, is_position_valid=False, state="landed")
    facts = _facts(others=others, last_positions_enu_m={"mav1": (last_x_m, 0.0, 0.0)})
    _check(_refused(_order("move", position_enu_m=_GOAL), _flight(), facts), words)


@pytest.mark.parametrize(
    ("goal_x_m", "is_airborne", "words"),
    [(1.8, True, ""), (1.79, True, "0.79 m from the goal of mav1"), (1.0, False, "")],
)
def test_two_goals_in_the_air_are_as_far_apart_as_two_vehicles(
    goal_x_m: float, is_airborne: bool, words: str
) -> None:
    other = telemetry("mav1", goal_position_enu_m=(goal_x_m, 0.0, 1.0), is_airborne=is_airborne)
    conflict = order_checks.goal_conflict(_GOAL, {"mav1": other}, _FLEET.fleet)
    _check(conflict or "", words)


@pytest.mark.parametrize(
    ("follows", "leader", "changes", "words"),
    [
        ("mav1", "mav1", {}, ""),
        ("mav1", "mav1", {"is_paused": True}, "`resume` lets it follow mav1 again"),
        ("mav1", "mav1", {"is_skipped": True}, "skip the rest of following mav1"),
        ("", "mav1", {"is_paused": True}, ""),  # a goal of a person
        ("mav1", "", {"is_paused": True}, ""),
    ],
)
def test_goals_of_a_following_that_is_paused_or_ended_are_refused(
    follows: str, leader: str, changes: dict[str, Any], words: str
) -> None:
    flight = _flight(follow=FollowFlight(leader=leader, **changes))
    _check(_refused(_order("move", position_enu_m=_GOAL, follows=follows), flight), words)

    # a goal that is not refused for the following is checked as any other one is
    outside = _order("move", position_enu_m=(9.0, 0.0, 1.0), follows=follows)
    _check(_refused(outside, flight), words or "outside the geofence")


def test_a_refusal_cuts_off_a_name_that_anybody_may_have_written() -> None:
    ways: tuple[dict[str, Any], ...] = (
        {"is_paused": True},
        {"is_skipped": True},
        {"stopped_by": "Loop stalled: holding."},
    )
    for changes in ways:
        flight = _flight(follow=FollowFlight(leader="m" * 60, **changes))
        refused = _refused(_order("move", position_enu_m=_GOAL, follows="m" * 60), flight)
        assert refused.count("m" * 40) == 1
        assert "m" * 41 not in refused


# -- a takeover ------------------------------------------------------------------------------------

_FLYING = {"is_armed": True, "mode": "HOLD", "landed": Landed.IN_AIR}


@pytest.mark.parametrize(
    ("view", "facts", "words"),
    [
        ({}, {}, ""),
        ({"is_armed": False}, {}, "there is nothing to take over"),
        ({"landed": Landed.ON_GROUND}, {}, "there is nothing to take over"),
        ({"mode": "RTL"}, {}, "(mode RTL)"),
        ({"mode": ""}, {}, "(mode unknown)"),
        ({}, {"not_ready_in_air": lambda: ("The first.", "The second.")}, "The first."),
        ({"has_position": False}, {}, "Its position is not known"),
        ({"position_enu_m": (4.1, 0.0, 1.0)}, {}, "outside the geofence"),
        ({"position_enu_m": (1.0, 0.0, 0.13)}, {}, ""),
        ({"position_enu_m": (1.0, 0.0, 0.01)}, {}, "may stand on the ground"),
        ({"velocity_enu_m_s": (0.3, 0.4, 0.0)}, {}, ""),
        ({"velocity_enu_m_s": (0.3, 0.41, 0.0)}, {}, "still moves at 0.5 m/s"),
        ({}, {"distances_m": {"mav1": 0.8}}, ""),
        ({}, {"distances_m": {"mav1": 0.79}}, "mav1 is only 0.79 m away"),
    ],
)
def test_a_vehicle_in_the_air_is_taken_over_from_px4s_hold_at_rest_and_apart_from_others(
    view: dict[str, Any], facts: dict[str, Any], words: str
) -> None:
    seen = _facts(_view(**{**_FLYING, **view}), **facts)
    _check(_refused(_order("hold"), _flight(FlightStep.FAILED), seen), words)


@pytest.mark.parametrize(("height_m", "words"), [(0.49, "may stand on the ground"), (0.51, "")])
def test_a_low_vehicle_without_a_mocap_is_not_taken_over(height_m: float, words: str) -> None:
    by_satellites = replace(_VEHICLE, mocap_required=False)
    seen = _facts(_view(**_FLYING, position_enu_m=(1.0, 0.0, height_m)))
    flight = _flight(FlightStep.FAILED, vehicle=by_satellites)
    _check(_refused(_order("hold"), flight, seen), words)


def test_a_takeover_that_is_refused_after_a_kill_says_that_it_was_killed() -> None:
    killed = _flight(FlightStep.FAILED, was_killed=True, reason="Killed.")
    _check(_refused(_order("hold"), killed), "Killed. It is failed: look at it")
    _check(_refused(_order("hold"), killed, _facts(_view(**_FLYING))), "")


# -- what an accepted order does -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "step", "landed", "was_killed", "words"),
    [
        ("land", FlightStep.FAILED, Landed.IN_AIR, True, "PX4 lands it only if the kill did not"),
        ("land", FlightStep.FAILED, Landed.IN_AIR, False, ""),
        ("hold", FlightStep.CLIMB, Landed.IN_AIR, True, ""),
        ("disarm", FlightStep.CLIMB, Landed.IN_AIR, False, "it lands at once"),
        ("disarm", FlightStep.CLIMB, Landed.ON_GROUND, False, "it lands at once"),
        ("disarm", FlightStep.LIFTOFF, Landed.IN_AIR, False, "it lands at once"),
        ("disarm", FlightStep.LIFTOFF, Landed.ON_GROUND, False, ""),
        ("disarm", FlightStep.READY, Landed.IN_AIR, True, ""),
    ],
)
def test_an_order_that_does_more_than_its_name_says_so(
    kind: OrderKind, step: FlightStep, landed: Landed, was_killed: bool, words: str
) -> None:
    flight = _flight(step, was_killed=was_killed)
    _check(order_checks.acceptance(_order(kind), flight, _view(landed=landed)), words)
