"""The state machine of a flight: applies the rows of :mod:`onboard.flight.flight_table`, and alone
writes the step.

Orders and failsafes begin something; :func:`advance` moves on by what telemetry and estimate say at
a tick. Commands and events collect in the context.
"""

from __future__ import annotations

from onboard.agent_commands import PlayTune
from onboard.bus.schema import Order, OrderOutcome, Severity
from onboard.flight import contact, sentences
from onboard.flight.context import FlightContext
from onboard.flight.flight_table import CAUSE, TABLE, Row, Text
from onboard.flight.predicates import is_steady
from onboard.flight.types import FlightEvent, FlightStep, FlightView
from onboard.safety.failsafe_table import Action

_REPEAT_NS = 1_200_000_000  # PX4 may have missed a request, or have refused it for now
# what it still rises when a landing begins is no sign that it does not come down
_STILL_CLIMBING_S = 1.0
_EVENT_OF_ORDER = {event.value.removeprefix("order "): event for event in FlightEvent}
_EVENT_OF_ACTION = {
    Action.SLOW: FlightEvent.FAILSAFE_SLOW,
    Action.HOLD: FlightEvent.FAILSAFE_HOLD,
    Action.LEVEL: FlightEvent.FAILSAFE_HOLD,  # of the setpoint of one tick decides whoever sends it
    Action.LAND: FlightEvent.FAILSAFE_LAND,
    Action.PX4_LAND: FlightEvent.FAILSAFE_PX4_LAND,
    Action.DISARM: FlightEvent.FAILSAFE_DISARM,
    Action.STOP: FlightEvent.FAILSAFE_STOP,
}


def accepts(step: FlightStep, order_kind: str) -> bool:
    """Whether the table has a row for this order in this step."""
    return (step, _EVENT_OF_ORDER[order_kind]) in TABLE


def begin_order(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Begin an order that :mod:`onboard.flight.order_checks` has not refused; it ends the one in
    progress.
    """
    row = _match(flight, view, _EVENT_OF_ORDER[order.kind])
    if row is not None:
        _finish(flight, view, "superseded", f"Ended by order {order.kind} of {order.author}.")
        flight.order, flight.is_slow = order, False
        _apply(flight, view, row)


def locate(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Show which vehicle this is; whatever it does goes on."""
    flight.commands.append(PlayTune())
    # PX4 acknowledges no tune, so nobody can say that it was heard.
    flight.say(view, "info", "identify", sentences.LOCATED, order.order_id, "done")


def load_path(flight: FlightContext, view: FlightView, order: Order) -> None:
    """Take a part of a path; whatever the vehicle does goes on."""
    assert order.path is not None
    flight.path.load(order.path)
    flight.say(
        view,
        "debug",
        "path",
        f"Part {order.path.part + 1} of {order.path.parts}.",
        order.order_id,
        "done",
    )


def begin_failsafe(
    flight: FlightContext,
    view: FlightView,
    action: Action,
    cause: str,
    outcome: OrderOutcome = "failed",
) -> None:
    """Take an action of the failsafe table, if it asks for more than is done already.

    Args:
        cause: reason in a sentence, shown beside the state.
        outcome: end of the order in progress; to fly slowly ends none.
    """
    event = _EVENT_OF_ACTION.get(action)
    row = None if event is None else _match(flight, view, event)
    if row is not None:
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


def advance(flight: FlightContext, view: FlightView) -> None:
    """Move on by what telemetry and estimate say now."""
    flight.contact = contact.observe(flight.contact, view, flight.vehicle.mocap_required)
    if view.velocity_enu_m_s[2] <= 0.0 or flight.seconds(view) > _STILL_CLIMBING_S:
        flight.lowest_m = min(flight.lowest_m, view.position_enu_m[2])
    if not is_steady(flight, view):
        flight.steady_ns = view.now_ns
    row = _match(flight, view, FlightEvent.TICK)
    if row is not None:
        _apply(flight, view, row)


def _match(flight: FlightContext, view: FlightView, event: FlightEvent) -> Row | None:
    for row in TABLE.get((flight.step, event), ()):
        if row.when is None or row.when(flight, view):
            return row
    return None


def _apply(flight: FlightContext, view: FlightView, row: Row, cause: str = "") -> None:
    reason = flight.reason if row.reason is None else _text(row.reason, flight, view)
    if row.ends is not None:
        outcome, text = row.ends
        _finish(flight, view, outcome, _text(text, flight, view))
    if row.says is not None:
        severity, code, text = row.says
        flight.say(view, severity, code, _text(text, flight, view))
    flight.reason = cause if reason == CAUSE else reason
    if row.to is not None:
        if flight.step is FlightStep.PATH and row.to is not FlightStep.PATH:
            flight.path.show_id = ""  # the others do not wait for it any more
        flight.step, flight.step_ns, flight.steady_ns, flight.request_ns = (
            row.to,
            view.now_ns,
            view.now_ns,
            0,
        )
    if row.effect is not None:
        row.effect(flight, view)
    if row.request is not None and (
        row.to is not None or view.now_ns - flight.request_ns > _REPEAT_NS
    ):
        flight.request_ns = view.now_ns
        flight.commands.append(row.request)


def _text(text: Text, flight: FlightContext, view: FlightView) -> str:
    return text if isinstance(text, str) else text(flight, view)


def _finish(flight: FlightContext, view: FlightView, outcome: OrderOutcome, sentence: str) -> None:
    """End the order in progress, if there is one."""
    order, flight.order = flight.order, None
    if order is not None:
        severity: Severity = "info" if outcome in ("done", "superseded") else "warning"
        flight.say(view, severity, f"order-{order.kind}", sentence, order.order_id, outcome)
