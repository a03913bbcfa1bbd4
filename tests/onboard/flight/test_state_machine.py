"""How a row of the flight table is carried out: what ends, what is said and what is sent to PX4."""

from __future__ import annotations

from typing import Any, Literal

import pytest
from msgspec.structs import replace

from onboard.agent_commands import (
    Arm,
    Command,
    Disarm,
    Kill,
    PlayTune,
    Publish,
    Px4Land,
    RequestHeartbeat,
)
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import Event, Order, OrderKind, PathOrder
from onboard.control.path import path_id, path_of, to_bytes
from onboard.flight import effects, sentences, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.follow_flight import FollowFlight
from onboard.flight.path_flight import PathFlight
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import Action
from onboard.types import Goal
from onboard.vectors import Vec3
from tests.onboard.agent.rig import fleet

_FLEET = fleet()
_VEHICLE = _FLEET.vehicles["mav0"]
_NOW_NS = 50_000_000_000
_RESTING = path_of([[100.0, *[0.0] * 16, 1.0, *[0.0] * 15]])  # a metre above the origin


def _order(kind: OrderKind, **changes: Any) -> Order:
    values = {"order_id": "o", "author": "Ada", "stamp_ns": 0, "deadline_ns": 0, **changes}
    return Order(kind=kind, **values)


_TAKES_OFF = _order("takeoff", order_id="t", height_m=10.0)
_MOVES = _order("move", order_id="m", position_enu_m=(2.0, 0.0, 1.0))


def _flight(step: FlightStep, **changes: Any) -> FlightContext:
    """A flight whose step has just begun, with a goal a metre above the origin."""
    values = {
        "step_ns": _NOW_NS,
        "steady_since_ns": _NOW_NS,
        "goal": Goal(Vec3(0.0, 0.0, 1.0), 0.0, 1),
    }
    return FlightContext(
        **{"fleet": _FLEET, "vehicle": _VEHICLE, "step": step, **values, **changes}
    )


def _view(after_s: float = 0.0, **changes: Any) -> FlightView:
    """What is seen so long after the step has begun; the changes may be of the view or of PX4."""
    now_ns = _NOW_NS + round(after_s * 1e9)
    in_view = {name: changes.pop(name) for name in list(changes) if hasattr(FlightView, name)}
    view = FlightView(
        now_ns=now_ns,
        position_enu_m=(0.0, 0.0, 1.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        has_position=True,
        snapshot=Snapshot(**{"landed": Landed.IN_AIR, "landed_ns": now_ns, **changes}),
    )
    return replace(view, **in_view)


def _taken(flight: FlightContext) -> tuple[list[Event], list[Command]]:
    """The events that the flight has published since the last call, and its other commands."""
    events: list[Event] = []
    requests: list[Command] = []
    for command in flight.take_commands():
        if isinstance(command, Publish):
            assert isinstance(command.message, Event)
            events.append(command.message)
        else:
            requests.append(command)
    return events, requests


# -- orders ----------------------------------------------------------------------------------------


def test_a_new_order_ends_the_one_before_it_and_goes_at_full_speed() -> None:
    follows = FollowFlight(leader="mav1", is_paused=True)
    flight = _flight(FlightStep.LEG, order=_MOVES, is_slow=True, follow=follows, reason="near")
    state_machine.begin_order(flight, _view(1.0), _order("move", position_enu_m=(3.0, 0.0, 1.0)))

    (ended,), requests = _taken(flight)
    assert (ended.order_id, ended.order_outcome, ended.severity) == ("m", "superseded", "info")
    assert ended.code == "order-move"
    assert ended.sentence == "Ended by order move of Ada."
    assert requests == []

    assert flight.order is not None
    assert flight.order.order_id == "o"
    assert (flight.step, flight.reason, flight.is_slow) == (FlightStep.LEG, "", False)
    assert flight.goal.position_enu_m == (3.0, 0.0, 1.0)
    assert (flight.step_ns, flight.steady_since_ns) == (_NOW_NS + 10**9, _NOW_NS + 10**9)
    assert flight.follow == FollowFlight()


def test_a_long_name_is_cut_off_where_an_order_ends_another_one() -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES)
    state_machine.begin_order(flight, _view(1.0), _order("hold", author="A" * 60_000))

    (ended,), _ = _taken(flight)
    assert ended.sentence == f"Ended by order hold of {'A' * 60}."


@pytest.mark.parametrize("kind", ["hold", "land"])
@pytest.mark.parametrize(
    "step",
    [
        FlightStep.ARM_OFFBOARD,
        FlightStep.ARM_ARMING,
        FlightStep.TAKEOFF_OFFBOARD,
        FlightStep.TAKEOFF_ARMING,
    ],
)
@pytest.mark.parametrize(
    ("is_armed", "after"), [(True, FlightStep.DISARMING), (False, FlightStep.DISARMED)]
)
def test_a_start_is_stopped_by_hold_and_by_land(
    kind: OrderKind, step: FlightStep, is_armed: bool, after: FlightStep
) -> None:
    flight = _flight(step)
    state_machine.begin_order(flight, _view(is_armed=is_armed), _order(kind))
    assert flight.step is after
    assert _taken(flight)[1] == [Disarm()]


def test_a_vehicle_that_stands_armed_is_stopped_by_land_and_has_nothing_to_hold() -> None:
    assert state_machine.accepts(FlightStep.ARMED, "land")
    assert not state_machine.accepts(FlightStep.ARMED, "hold")


def test_an_order_that_no_row_of_the_step_knows_changes_nothing() -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES)
    assert not state_machine.accepts(FlightStep.LEG, "takeoff")
    state_machine.begin_order(flight, _view(), _order("takeoff"))
    assert (flight.step, flight.order) == (FlightStep.LEG, _MOVES)
    assert _taken(flight) == ([], [])


@pytest.mark.parametrize(
    ("kind", "follows", "leader"),
    [("move", "mav1", "mav1"), ("hold", "mav1", ""), ("move", "", "")],
)
def test_only_a_move_follows_another_vehicle(kind: OrderKind, follows: str, leader: str) -> None:
    order = _order(kind, position_enu_m=(2.0, 0.0, 1.0), follows=follows)
    flight = _flight(FlightStep.LEG)
    state_machine.begin_order(flight, _view(), order)
    assert flight.followed == leader


def test_who_is_located_plays_a_tune_and_flies_on() -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES)
    state_machine.locate(flight, _view(), _order("identify"))
    (said,), requests = _taken(flight)
    assert requests == [PlayTune()]
    assert (said.code, said.severity, said.sentence) == ("identify", "info", sentences.LOCATED)
    assert (said.order_id, said.order_outcome, flight.order) == ("o", "done", _MOVES)


def test_a_part_of_a_path_is_taken_beside_the_flight() -> None:
    data = to_bytes(_RESTING)
    part = PathOrder(path_id=path_id(data), part=0, parts=2, data=data[:100])
    flight = _flight(FlightStep.LEG, order=_MOVES)
    state_machine.load_path(flight, _view(), _order("load_path", path=part))
    (said,), _ = _taken(flight)
    assert (said.sentence, said.code, said.severity) == ("Part 1 of 2.", "path", "debug")
    assert (said.order_id, said.order_outcome, flight.order) == ("o", "done", _MOVES)
    assert flight.path.parts == {0: data[:100]}


@pytest.mark.parametrize(
    ("kind", "was_paused", "is_paused", "is_skipped", "words"),
    [
        ("pause", False, True, False, "Pausing at 10.0 s of its path."),
        ("resume", True, False, False, "Going on at 10.0 s of its path"),
        ("resume", False, False, False, "This vehicle was not paused."),
        ("skip", True, True, True, "Leaving its path at 10.0 s"),
    ],
)
def test_a_path_is_paused_resumed_and_skipped_and_its_order_goes_on(
    kind: OrderKind, was_paused: bool, is_paused: bool, is_skipped: bool, words: str
) -> None:
    path = PathFlight(path=_RESTING, show_id="s", time_s=10.0, is_paused=was_paused)
    flight = _flight(FlightStep.PATH, path=path, order=_MOVES)
    state_machine.change_path(flight, _view(), _order(kind))
    (said,), _ = _taken(flight)
    assert words in said.sentence
    assert (said.code, said.order_id, said.order_outcome) == (kind, "o", "done")
    assert (path.is_paused, path.is_skipped) == (is_paused, is_skipped)
    assert (flight.order, flight.is_paused) == (_MOVES, is_paused)


@pytest.mark.parametrize(
    ("kind", "words", "reason", "is_paused"),
    [
        ("pause", "`resume` lets it follow mav1 again. The battery has 90 %;", "paused", True),
        ("skip", "It follows mav1 no further, and holds here.", "ordered", False),
    ],
)
def test_who_follows_another_vehicle_holds_for_a_pause_and_a_skip(
    kind: OrderKind, words: str, reason: str, is_paused: bool
) -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES, follow=FollowFlight(leader="mav1"))
    state_machine.change_path(flight, _view(battery_frac=0.9), _order(kind))
    (ended, said), _ = _taken(flight)
    assert (ended.order_id, ended.order_outcome) == ("m", "superseded")
    assert ended.sentence == f"Ended by order {kind} of Ada."
    assert words in said.sentence
    assert (said.code, said.order_id, said.order_outcome) == (kind, "o", "done")

    assert (flight.step, flight.order, flight.reason) == (FlightStep.HOLDING, None, reason)
    assert flight.is_paused is is_paused
    assert flight.followed == ("mav1" if is_paused else "")


def test_who_is_to_follow_again_waits_for_the_next_goal_where_it_holds() -> None:
    follows = FollowFlight(leader="mav1", is_paused=True)
    flight = _flight(FlightStep.HOLDING, follow=follows, reason="paused")
    state_machine.change_path(flight, _view(), _order("resume"))
    (said,), _ = _taken(flight)
    assert said.sentence == "Following mav1 again."
    assert (flight.step, flight.is_paused, flight.followed) == (FlightStep.HOLDING, False, "mav1")


def test_without_poses_a_following_is_paused_and_the_vehicle_holds_when_they_return() -> None:
    flight = _flight(FlightStep.COASTING, order=_MOVES, follow=FollowFlight(leader="mav1"))
    state_machine.change_path(flight, _view(is_dead_reckoned=True), _order("pause"))
    said, _ = _taken(flight)
    assert [event.order_outcome for event in said] == ["superseded", "done"]
    assert (flight.step, flight.order) == (FlightStep.COASTING, None)
    assert flight.is_paused

    state_machine.advance(flight, _view(is_dead_reckoned=False))
    assert flight.step is FlightStep.HOLDING


@pytest.mark.parametrize(
    ("kind", "changes", "disabled_by", "stands_in_for", "words"),
    [
        ("disable", {}, "Ada", "mav1", "mav0 is disabled by Ada"),
        ("disable", {"author": ""}, "nobody named", "mav1", "is disabled by nobody named"),
        ("enable", {}, "", "mav1", "mav0 takes part in flights."),
        ("stand_in", {"stands_in_for": "mav2"}, "", "mav2", "mav0 stands in for mav2"),
        ("stand_in", {"stands_in_for": "mav0"}, "", "", "takes part in flights, from its own"),
    ],
)
def test_a_vehicle_goes_out_of_service_comes_back_and_stands_in(
    kind: OrderKind, changes: dict[str, str], disabled_by: str, stands_in_for: str, words: str
) -> None:
    flight = _flight(FlightStep.READY, disabled_by="Bob", stands_in_for="mav1")
    state_machine.change_service(flight, _view(), _order(kind, **changes))
    (said,), _ = _taken(flight)
    assert words in said.sentence
    assert (said.code, said.order_id, said.order_outcome) == (kind, "o", "done")
    assert (flight.disabled_by, flight.stands_in_for) == (disabled_by, stands_in_for)


# -- failsafes and the preflight check -------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "step"),
    [
        (Action.HOLD, FlightStep.HOLDING),
        (Action.LEVEL, FlightStep.HOLDING),
        (Action.LAND, FlightStep.DESCENT),
        (Action.PX4_LAND, FlightStep.PX4_LANDING),
        (Action.STOP, FlightStep.FAILED),
    ],
)
def test_a_failsafe_that_begins_a_step_fails_the_order_with_its_cause(
    action: Action, step: FlightStep
) -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES, is_slow=True)
    state_machine.begin_failsafe(flight, _view(), action, "Too windy.")
    (ended,), requests = _taken(flight)
    assert (ended.order_id, ended.order_outcome, ended.severity) == ("m", "failed", "warning")
    assert ended.sentence == "Too windy."
    assert (flight.step, flight.reason) == (step, "Too windy.")
    assert (flight.order, flight.is_slow) == (None, False)
    assert requests == ([Px4Land()] if action is Action.PX4_LAND else [])


def test_a_failsafe_that_slows_ends_no_order_and_slows_once() -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES)
    state_machine.begin_failsafe(flight, _view(), Action.SLOW, "Near mav1.")
    assert (flight.step, flight.order, flight.is_slow) == (FlightStep.LEG, _MOVES, True)
    assert (flight.reason, _taken(flight)) == ("Near mav1.", ([], []))

    sequence = flight.goal.sequence
    state_machine.begin_failsafe(flight, _view(), Action.SLOW, "Near mav2.")
    assert (flight.goal.sequence, flight.reason) == (sequence, "Near mav1.")


@pytest.mark.parametrize("action", [Action.GO_ON, Action.DISARM])
def test_an_action_without_a_row_of_the_step_changes_nothing(action: Action) -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES, reason="before")
    state_machine.begin_failsafe(flight, _view(), action, "A cause.")
    assert (flight.step, flight.order, flight.reason) == (FlightStep.LEG, _MOVES, "before")
    assert _taken(flight) == ([], [])


def test_a_preflight_check_leads_to_ready_and_back_on_the_ground_only() -> None:
    flight = _flight(FlightStep.WAITING)
    for is_ready, step in (
        (False, FlightStep.WAITING),
        (True, FlightStep.READY),
        (True, FlightStep.READY),
        (False, FlightStep.WAITING),
    ):
        state_machine.preflight_checked(flight, _view(), is_ready)
        assert flight.step is step

    flies = _flight(FlightStep.LEG)
    state_machine.preflight_checked(flies, _view(), is_ready=False)
    assert flies.step is FlightStep.LEG


# -- requests to PX4 -------------------------------------------------------------------------------


def _requests(flight: FlightContext, view: FlightView) -> list[Command]:
    state_machine.advance(flight, view)
    return _taken(flight)[1]


def test_a_request_is_repeated_after_more_than_1_2_s_until_px4_obeys() -> None:
    flight = _flight(FlightStep.TAKEOFF_ARMING, order=_order("takeoff"))
    sent_s = [s for s in (0.02, 0.5, 1.22, 1.221, 2.421, 2.422) if _requests(flight, _view(s))]
    assert sent_s == [0.02, 1.221, 2.422]

    armed = _view(2.5, is_armed=True, heartbeat_ns=_NOW_NS + 1)
    assert _requests(flight, armed) == []
    assert flight.step is FlightStep.LIFTOFF


def test_the_request_of_a_new_step_waits_for_no_earlier_one() -> None:
    flight = _flight(FlightStep.TAKEOFF_ARMING, order=_order("takeoff"))
    assert _requests(flight, _view(0.02)) == [Arm()]
    armed = _view(0.1, is_armed=True)
    state_machine.begin_order(flight, armed, _order("land"))
    assert _taken(flight)[1] == [Disarm()]
    # and it is repeated from then on
    assert _requests(flight, replace(armed, now_ns=_NOW_NS + 1_300_000_000)) == []
    assert _requests(flight, replace(armed, now_ns=_NOW_NS + 1_300_000_001)) == [Disarm()]


def test_a_step_that_sends_nothing_lets_the_next_one_send_at_once() -> None:
    flight = _flight(FlightStep.ARM_OFFBOARD, order=_order("arm"), request_ns=_NOW_NS)
    offboard = _view(0.2, mode="OFFBOARD", heartbeat_ns=_NOW_NS + 1)
    assert _requests(flight, offboard) == []
    assert flight.step is FlightStep.ARM_ARMING
    assert _requests(flight, replace(offboard, now_ns=offboard.now_ns + 1)) == [Arm()]


def test_a_heartbeat_that_is_asked_for_delays_no_request_that_its_answer_leads_to() -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES)
    sticks = {"sticks_ns": _NOW_NS, "sticks_before_ns": _NOW_NS - 10**8}
    state_machine.begin_failsafe(flight, _view(**sticks), Action.PX4_LAND, "A cause.")
    assert _taken(flight)[1] == [RequestHeartbeat()]
    answered = _view(0.05, mode="HOLD", heartbeat_ns=_NOW_NS + 1, **sticks)
    assert _requests(flight, answered) == [Px4Land()]


@pytest.mark.parametrize(
    ("reason", "silent_s", "requests"),
    [
        ("the mission ends", 0.4, []),
        ("the mission ends", 0.2, [Px4Land()]),
        ("", 0.4, [Px4Land()]),  # a person who names the vehicle
    ],
)
def test_a_landing_that_spares_pilots_is_not_sent_to_a_px4_that_is_silent(
    reason: str, silent_s: float, requests: list[Any]
) -> None:
    flight = _flight(FlightStep.FAILED)
    silent = _view(silent_s, last_packet_ns=_NOW_NS, is_armed=True, mode="HOLD")
    state_machine.begin_order(flight, silent, _order("land", reason=reason))
    events, sent = _taken(flight)
    assert sent == requests
    if not requests:
        (ended,) = events
        assert ended.order_outcome == "failed"
        assert ended.sentence == sentences.NOBODY_KNOWS_OF_A_PILOT
        assert (flight.step, flight.order) == (FlightStep.FAILED, None)


def test_who_kills_in_the_air_is_named_to_everybody() -> None:
    flight = _flight(FlightStep.LEG, order=_MOVES)
    kill = _order("kill", node="ground-1")
    state_machine.begin_order(flight, _view(is_armed=True), kill)
    (ended, said), requests = _taken(flight)
    assert (ended.order_id, ended.order_outcome) == ("m", "superseded")
    assert (said.severity, said.code) == ("critical", "killed")
    assert said.sentence == "Killed in the air by order of Ada (from ground-1)."
    assert requests == [Kill()]
    assert (flight.reason, flight.was_killed) == ("Killed by order of Ada.", True)


# -- ends ------------------------------------------------------------------------------------------


def test_a_hold_is_done_at_rest_and_its_step_goes_on() -> None:
    flight = _flight(FlightStep.HOLDING, order=_order("hold"), reason="ordered")
    state_machine.advance(flight, _view(0.299))
    assert _taken(flight) == ([], [])

    state_machine.advance(flight, _view(0.301))
    (ended,), _ = _taken(flight)
    assert (ended.order_outcome, ended.severity) == ("done", "info")
    assert (flight.step, flight.reason) == (FlightStep.HOLDING, "ordered")
    assert (flight.step_ns, flight.order) == (_NOW_NS, None)


def test_a_landing_that_nobody_ordered_is_told_without_an_order() -> None:
    flight = _flight(FlightStep.CONTACT, reason="Too windy.")
    down = _view(1.0, landed=Landed.ON_GROUND, heartbeat_ns=_NOW_NS + 1)
    assert not flight.is_avoiding(down)  # it stands, and nobody may count on it to move aside
    state_machine.advance(flight, down)
    (said,), _ = _taken(flight)
    assert (said.code, said.severity, said.sentence) == ("landed", "info", sentences.LANDED)
    assert (said.order_id, said.order_outcome) == ("", "")
    assert (flight.step, flight.reason) == (FlightStep.LANDED, "Too windy.")


@pytest.mark.parametrize(("kind", "show_id"), [("hold", ""), ("land", ""), (None, "s")])
def test_the_others_of_a_show_wait_for_a_vehicle_while_it_is_on_its_path(
    kind: Literal["hold", "land"] | None, show_id: str
) -> None:
    path = PathFlight(path=_RESTING, show_id="s", time_s=10.0)
    flight = _flight(FlightStep.PATH, path=path, order=_order("follow_path"))
    if kind is None:
        state_machine.advance(flight, _view())
        assert flight.step is FlightStep.PATH
    else:
        state_machine.begin_order(flight, _view(), _order(kind))
    assert path.show_id == show_id


def test_a_path_that_begins_keeps_the_name_of_its_show() -> None:
    show = PathOrder(path_id="p", show_id="t", start_ns=_NOW_NS + 10**9)
    flight = _flight(FlightStep.HOLDING, path=PathFlight(path=_RESTING, path_id="p"))
    state_machine.begin_order(flight, _view(), _order("follow_path", path=show))
    assert (flight.step, flight.path.show_id) == (FlightStep.PATH, "t")


def test_a_failsafe_that_slows_makes_a_climb_take_twice_as_long() -> None:
    usual = _flight(FlightStep.CLIMB, order=_TAKES_OFF)
    effects.climb_on(usual, _view())

    slowed = _flight(FlightStep.CLIMB, order=_TAKES_OFF)
    effects.climb_on(slowed, _view())
    state_machine.begin_failsafe(slowed, _view(), Action.SLOW, "Mocap late.")
    assert (slowed.step, slowed.order, slowed.is_slow) == (FlightStep.CLIMB, _TAKES_OFF, True)
    assert slowed.goal.position_enu_m == usual.goal.position_enu_m
    assert slowed.goal.duration_s == pytest.approx(2.0 * usual.goal.duration_s)
