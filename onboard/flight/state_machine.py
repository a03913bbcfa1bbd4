"""The state machine of a flight: applies the rows of the flight table. Only this module writes the
step.

An order or an action of the failsafe table starts a step. :func:`advance` moves to the next step at
a tick, when telemetry and estimate allow it. All of these are FlightEvents. For an event,
:func:`_match` finds the step's first row with a true predicate, and :func:`_apply` carries it out.

Requests to PX4 and events for people are collected in the context until the core takes them.
"""

from __future__ import annotations

from onboard.agent_commands import PlayTune, RequestHeartbeat
from onboard.bus.schema import Order, OrderOutcome, Severity
from onboard.flight import contact, sentences
from onboard.flight.context import FlightContext
from onboard.flight.flight_table import CAUSE, TABLE, Row, Text
from onboard.flight.predicates import is_steady
from onboard.flight.types import FlightEvent, FlightStep, FlightView
from onboard.safety.failsafe_table import Action

# a request is repeated after this time, because PX4 may have missed it, or refused it at that
# moment
_REPEAT_NS = 1_200_000_000

# A vehicle may still climb when its landing begins. In this time its lowest height is not updated
# while it climbs, so that the climb does not count as a failed landing.
_STILL_CLIMBING_S = 1.0

# kind of an order -> event
_EVENT_OF_ORDER = {
    event.value.removeprefix("order "): event
    for event in FlightEvent
    if event.value.startswith("order ")
}
_EVENT_OF_ACTION = {
    Action.SLOW: FlightEvent.FAILSAFE_SLOW,
    Action.HOLD: FlightEvent.FAILSAFE_HOLD,
    # the level setpoint lasts one tick and is chosen when it is sent; the flight itself holds
    Action.LEVEL: FlightEvent.FAILSAFE_HOLD,
    Action.LAND: FlightEvent.FAILSAFE_LAND,
    Action.PX4_LAND: FlightEvent.FAILSAFE_PX4_LAND,
    Action.DISARM: FlightEvent.FAILSAFE_DISARM,
    Action.STOP: FlightEvent.FAILSAFE_STOP,
}


# -- orders ----------------------------------------------------------------------------------------


def accepts(step: FlightStep, order_kind: str) -> bool:
    """Return whether the table has a row for this order in this step."""
    return (step, _EVENT_OF_ORDER[order_kind]) in TABLE


def begin_order(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Start an order that order_checks.py has accepted, and end the order in progress."""
    row = _row_of_order(flight, view, order)
    if row is None:
        return

    _finish(flight, view, "superseded", sentences.superseded(order))
    flight.order = order
    flight.follow.begin(order)
    flight.is_slow = False
    _apply(flight, view, row)


def _row_of_order(flight: FlightContext, view: FlightView, order: Order) -> Row | None:
    """Return the row for an order that is not yet in progress; its predicates see this order."""
    order_before = flight.order
    flight.order = order
    row = _match(flight, view, _EVENT_OF_ORDER[order.kind])
    flight.order = order_before
    return row


def locate(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Play a tune that shows which vehicle this is. The flight continues unchanged."""
    flight.commands.append(PlayTune())

    # PX4 does not acknowledge a tune; "identify" is the former name of the order
    flight.say(view, "info", "identify", sentences.LOCATED, order.order_id, "done")


def load_path(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Take a part of a path. The flight continues unchanged."""
    part = order.path
    assert part is not None
    flight.path.load(part)

    sentence = f"Part {part.part + 1} of {part.parts}."
    flight.say(view, "debug", "path", sentence, order.order_id, "done")


def change_path(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Pause or resume the path that is followed, or skip the rest of it.

    The order to follow the path stays in progress. The same three orders pause, resume or end the
    following of another vehicle.
    """
    if flight.followed:
        sentence = _change_following(flight, view, order)
    elif order.kind == "skip":
        flight.path.is_skipped = True
        sentence = sentences.skipped(flight, view)
    elif order.kind == "pause":
        flight.path.is_paused = True
        sentence = sentences.paused(flight, view)
    else:
        sentence = sentences.resumed(flight, view)
        flight.path.is_paused = False
    flight.say(view, "info", order.kind, sentence, order.order_id, "done")


def _change_following(flight: FlightContext, view: FlightView, order: Order) -> str:
    """Pause, resume or end the following of another vehicle; return the sentence of the reply."""
    follow = flight.follow
    if order.kind == "resume":
        follow.is_paused = False
        return sentences.follows_again(flight, view)

    sentence = sentences.follow_stopped(flight, view, is_skipped=order.kind == "skip")
    follow.is_paused = order.kind == "pause"
    follow.is_skipped = order.kind == "skip"

    row = _match(flight, view, FlightEvent.HOLD)
    if row is not None:
        _finish(flight, view, "superseded", sentences.superseded(order))
        _apply(flight, view, row)
        flight.reason = "paused" if follow.is_paused else "ordered"
    return sentence


def change_service(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Take the vehicle out of service or back into it, or let it stand in for another one.

    Other vehicles still see and avoid a vehicle that is out of service.
    """
    if order.kind == "disable":
        flight.disabled_by = "nobody named"
        if order.author:
            flight.disabled_by = order.author
        sentence = sentences.disabled(flight)
    elif order.kind == "stand_in":
        is_other = order.stands_in_for != flight.vehicle.name
        flight.stands_in_for = order.stands_in_for if is_other else ""
        flight.disabled_by = ""
        sentence = sentences.stands_in(flight)
    else:
        flight.disabled_by = ""
        sentence = f"{flight.vehicle.name} takes part in flights."
    flight.say(view, "info", order.kind, sentence, order.order_id, "done")


# -- failsafes and the preflight check -------------------------------------------------------------


def begin_failsafe(
    flight: FlightContext,
    view: FlightView,
    action: Action,
    cause: str,
    outcome: OrderOutcome = "failed",
) -> None:
    """Carry out an action of the failsafe table, if the flight table has a row for it.

    Args:
        flight: flight of this vehicle.
        view: what the flight sees at this tick.
        action: action of the failsafe table.
        cause: reason of the action in a sentence, shown beside the state.
        outcome: outcome of the order in progress, if the action ends it. SLOW ends no order.
    """
    event = _EVENT_OF_ACTION.get(action)
    if event is None:
        return
    row = _match(flight, view, event)
    if row is None:
        return

    if row.to is not None:
        _finish(flight, view, outcome, cause)
        flight.follow.stop(cause)
        flight.is_slow = False
    _apply(flight, view, row, cause)


def preflight_checked(flight: FlightContext, view: FlightView, is_ready: bool) -> None:
    """Process the result of the preflight check on the ground."""
    event = FlightEvent.PREFLIGHT_PASSED if is_ready else FlightEvent.PREFLIGHT_REFUSED
    row = _match(flight, view, event)
    if row is not None:
        _apply(flight, view, row)


# -- a tick ----------------------------------------------------------------------------------------


def advance(flight: FlightContext, view: FlightView) -> None:
    """Update the signs of contact and the times, and move to the next step if one is due."""
    flight.contact = contact.observe(
        flight.contact,
        view,
        flight.vehicle,
        sinks_without_poses=flight.step is FlightStep.SINKING,
    )

    _, _, height_m = view.position_enu_m
    _, _, climbing_m_s = view.velocity_enu_m_s
    if climbing_m_s <= 0.0 or flight.seconds(view) > _STILL_CLIMBING_S:
        flight.lowest_z_m = min(flight.lowest_z_m, height_m)

    if not is_steady(flight, view):
        flight.steady_since_ns = view.now_ns

    row = _match(flight, view, FlightEvent.TICK)
    if row is not None:
        _apply(flight, view, row)


def _match(flight: FlightContext, view: FlightView, event: FlightEvent) -> Row | None:
    """Return the first row for this step and event with a true predicate."""
    for row in TABLE.get((flight.step, event), ()):
        if row.when is None or row.when(flight, view):
            return row
    return None


def _apply(flight: FlightContext, view: FlightView, row: Row, cause: str = "") -> None:
    """Carry out a row: end the order, report, begin the next step, and send its request to PX4.

    All texts are composed before the step changes, because they describe the step that is ending.
    """
    reason = flight.reason
    if row.reason is not None:
        reason = cause if row.reason == CAUSE else _text(row.reason, flight, view)

    if row.ends is not None:
        outcome, text = row.ends
        _finish(flight, view, outcome, _text(text, flight, view))

    if row.says is not None:
        severity, code, text = row.says
        flight.say(view, severity, code, _text(text, flight, view))

    flight.reason = reason
    if row.to is not None:
        _begin_step(flight, view, row.to)

    if row.effect is not None:
        row.effect(flight, view)

    if row.request is not None:
        is_due = view.now_ns - flight.request_ns > _REPEAT_NS
        if row.to is not None or is_due:
            flight.commands.append(row.request)
            # PX4's answer to a heartbeat request leads to the next request, which must not wait
            if not isinstance(row.request, RequestHeartbeat):
                flight.request_ns = view.now_ns


def _begin_step(flight: FlightContext, view: FlightView, step: FlightStep) -> None:
    if flight.step is FlightStep.PATH and step is not FlightStep.PATH:
        flight.path.show_id = ""  # so the other vehicles of the show no longer wait for this one

    flight.step = step
    flight.step_ns = view.now_ns
    flight.steady_since_ns = view.now_ns
    flight.request_ns = 0


def _text(text: Text, flight: FlightContext, view: FlightView) -> str:
    return text if isinstance(text, str) else text(flight, view)


def _finish(flight: FlightContext, view: FlightView, outcome: OrderOutcome, sentence: str) -> None:
    """End the order in progress, if there is one."""
    order = flight.order
    flight.order = None
    if order is None:
        return

    severity: Severity = "info" if outcome in ("done", "superseded") else "warning"
    flight.say(view, severity, f"order-{order.kind}", sentence, order.order_id, outcome)
