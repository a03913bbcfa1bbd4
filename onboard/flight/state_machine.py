"""The state machine of a flight: applies the rows of the flight table, and alone writes the step.

An order or an action of the failsafe table begins something; :func:`advance` moves it on at each
tick by what telemetry and estimate say. Each of these is a FlightEvent. Of the table's rows for the
step and the event the first counts whose predicate holds, and :func:`_apply` carries it out.

Requests to PX4 and events for people collect in the context until the core takes them.
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

_REPEAT_NS = 1_200_000_000  # PX4 may have missed a request, or have refused it for now

# A vehicle may still rise when its landing begins: that is no sign that it does not come down.
_STILL_CLIMBING_S = 1.0

_EVENT_OF_ORDER = {event.value.removeprefix("order "): event for event in FlightEvent}
_EVENT_OF_ACTION = {
    Action.SLOW: FlightEvent.FAILSAFE_SLOW,
    Action.HOLD: FlightEvent.FAILSAFE_HOLD,
    # a level setpoint is for one tick, and whoever sends it decides on it; the flight holds
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
    """Begin an order that order_checks.py has not refused; it ends the one in progress."""
    row = _match(flight, view, _EVENT_OF_ORDER[order.kind])
    if row is None:
        return

    _finish(flight, view, "superseded", f"Ended by order {order.kind} of {order.author}.")
    flight.order = order
    flight.follow.begin(order)
    flight.is_slow = False
    _apply(flight, view, row)


def locate(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Show which vehicle this is; whatever it does goes on."""
    flight.commands.append(PlayTune())

    # PX4 acknowledges no tune, so nobody can say that it was heard.
    flight.say(view, "info", "identify", sentences.LOCATED, order.order_id, "done")


def load_path(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Take a part of a path; whatever the vehicle does goes on."""
    part = order.path
    assert part is not None
    flight.path.load(part)

    sentence = f"Part {part.part + 1} of {part.parts}."
    flight.say(view, "debug", "path", sentence, order.order_id, "done")


def change_path(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Stop the clock of the path that is followed, let it go on, or skip the rest of the path.

    No order ends by it: the one to follow the path goes on. Who follows another vehicle holds, and
    goes on or not, in the same way.
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
        flight.path.is_paused = False
        sentence = sentences.resumed(flight, view)
    flight.say(view, "info", order.kind, sentence, order.order_id, "done")


def _change_following(flight: FlightContext, view: FlightView, order: Order) -> str:
    """Hold a vehicle that follows another one, let it go on, or end it here; return the answer."""
    follow = flight.follow
    if order.kind == "resume":
        follow.is_paused = False
        return sentences.follows_again(flight, view)

    sentence = sentences.follow_stopped(flight, view, is_skipped=order.kind == "skip")
    follow.is_paused = order.kind == "pause"
    follow.is_skipped = order.kind == "skip"

    row = _match(flight, view, FlightEvent.HOLD)
    if row is not None:
        _finish(flight, view, "superseded", f"Ended by order {order.kind} of {order.author}.")
        _apply(flight, view, row)
        flight.reason = "paused" if follow.is_paused else "ordered"
    return sentence


def change_service(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Take the vehicle out of service, or back, or have it stand in for another one.

    It goes on being seen and avoided.
    """
    if order.kind == "disable":
        flight.disabled_by = order.author or "nobody named"
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
    """Take an action of the failsafe table, if it demands more than is done already.

    Args:
        flight: of this vehicle.
        view: of this tick.
        action: of the failsafe table.
        cause: reason in a sentence, shown beside the state.
        outcome: end of the order in progress; to fly slowly ends none.
    """
    event = _EVENT_OF_ACTION.get(action)
    if event is None:
        return
    row = _match(flight, view, event)
    if row is None:
        return

    if row.to is not None:
        _finish(flight, view, outcome, cause)
        flight.is_slow = False
    _apply(flight, view, row, cause)


def preflight_checked(flight: FlightContext, view: FlightView, is_ready: bool) -> None:
    """Take the result of the preflight check on the ground."""
    event = FlightEvent.PREFLIGHT_PASSED if is_ready else FlightEvent.PREFLIGHT_REFUSED
    row = _match(flight, view, event)
    if row is not None:
        _apply(flight, view, row)


# -- a tick ----------------------------------------------------------------------------------------


def advance(flight: FlightContext, view: FlightView) -> None:
    """Move on by what telemetry and estimate say now."""
    flight.contact = contact.observe(flight.contact, view, flight.vehicle.mocap_required)

    height_m = view.position_enu_m[2]
    is_sinking = view.velocity_enu_m_s[2] <= 0.0
    if is_sinking or flight.seconds(view) > _STILL_CLIMBING_S:
        flight.lowest_m = min(flight.lowest_m, height_m)

    if not is_steady(flight, view):
        flight.steady_ns = view.now_ns

    row = _match(flight, view, FlightEvent.TICK)
    if row is not None:
        _apply(flight, view, row)


def _match(flight: FlightContext, view: FlightView, event: FlightEvent) -> Row | None:
    """Return the first row of the step and the event whose predicate holds."""
    for row in TABLE.get((flight.step, event), ()):
        if row.when is None or row.when(flight, view):
            return row
    return None


def _apply(flight: FlightContext, view: FlightView, row: Row, cause: str = "") -> None:
    """Carry out a row: end the order, speak, begin the next step, request something of PX4.

    The texts are written before the step changes: they speak of the one that ends.
    """
    reason = flight.reason
    if row.reason is not None:
        reason = _text(row.reason, flight, view)

    if row.ends is not None:
        outcome, text = row.ends
        _finish(flight, view, outcome, _text(text, flight, view))

    if row.says is not None:
        severity, code, text = row.says
        flight.say(view, severity, code, _text(text, flight, view))

    flight.reason = cause if reason == CAUSE else reason
    if row.to is not None:
        _begin_step(flight, view, row.to)

    if row.effect is not None:
        row.effect(flight, view)

    if row.request is not None:
        is_due = view.now_ns - flight.request_ns > _REPEAT_NS
        if row.to is not None or is_due:
            flight.commands.append(row.request)
            # a question does not delay what its answer calls for
            if not isinstance(row.request, RequestHeartbeat):
                flight.request_ns = view.now_ns


def _begin_step(flight: FlightContext, view: FlightView, step: FlightStep) -> None:
    if flight.step is FlightStep.PATH and step is not FlightStep.PATH:
        flight.path.show_id = ""  # the others do not wait for it any more

    flight.step = step
    flight.step_ns = view.now_ns
    flight.steady_ns = view.now_ns
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
