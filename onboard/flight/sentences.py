"""Sentences for people: reasons of steps and ends of orders, as the flight table uses them.
Pure.
"""

from __future__ import annotations

from onboard.bus.schema import Order
from onboard.flight.arrival import position_text
from onboard.flight.context import FlightContext
from onboard.flight.path_flight import CATCH_UP_LIMIT_S
from onboard.flight.predicates import CONFIRM_TIMEOUT_S, REBOOT_TIMEOUT_S
from onboard.flight.types import FlightView

LOCATED = (
    "The tune was sent to PX4, which does not confirm it: listen, or look at the row that blinks."
)
WITHOUT_AGENT = "it flies without this agent."  # the end of other sentences
FLIES_WITHOUT_AGENT = (
    "PX4 flies without this agent: order land or kill; or order hold, to take over from PX4's hold."
)
DISARMED = "PX4 is disarmed."
NO_POSE = "Its position is not known any more, so it left the path."
NO_POSE_AT_LIFTOFF = "Its position was lost at the lift-off: landing."
LANDED = "Landed and disarmed."
STANDS = "It stands on the ground already, disarmed."
STANDS_AT_HOME = "It stands at its take-off spot already, disarmed."
LANDS_TO_DISARM = "It has left the ground: it lands at once, and is disarmed there."
REBOOTED = "PX4 has started anew. Its preflight takes some seconds."
ARMED_MEANWHILE = "PX4 was armed meanwhile, and does not start anew."
MOTORS_STOPPED = "PX4 has disarmed in the air: the motors have stopped, and it falls."
NOBODY_KNOWS_OF_A_PILOT = (
    "PX4 is silent, so it is not known whether a pilot flies: PX4 was not told to land."
)
NO_LIFTOFF = (
    "The vehicle did not leave the ground: check propellers, battery and hover_thrust_frac."
)
UNSEEN_LIFTOFF = (
    "The vehicle was not seen to leave the ground, but PX4 reports that it flies: PX4 lands it. "
    "Check what measures its position, propellers, battery and hover_thrust_frac."
)


def killed(flight: FlightContext, view: FlightView) -> str:
    """Return the reason of a killed vehicle's state."""
    author = ""
    if flight.order is not None:
        author = flight.order.author[:60]
    return f"Killed by order of {author}."


def killed_in_the_air(flight: FlightContext, view: FlightView) -> str:
    """Return the sentence about a kill in the air, with the order's author and node."""
    order = flight.order
    if order is None:
        return ""
    node = "an unnamed ground"
    if order.node:
        node = order.node[:60]
    return f"Killed in the air by order of {order.author[:60]} (from {node})."


def superseded(order: Order) -> str:
    """Return the sentence about an order that this one has ended."""
    return f"Ended by order {order.kind} of {order.author[:60]}."


def ordered_or_killed(flight: FlightContext, view: FlightView) -> str:
    """Return the reason of an ordered landing. After a kill, the kill remains the reason."""
    if flight.was_killed:
        return flight.reason
    return "ordered"


def falls_by_kill(flight: FlightContext, view: FlightView) -> str:
    """Return the end of a landing that was ordered after a kill."""
    return f"{flight.reason} Its motors have stopped and it falls: no order can land it."


def lands_unless_killed(flight: FlightContext) -> str:
    """Return the sentence about what an order to land does after a kill."""
    return f"{flight.reason} It falls; PX4 lands it only if the kill did not reach its motors."


def left_its_hold(flight: FlightContext, view: FlightView) -> str:
    """Return the reason why a takeover has ended."""
    mode = _mode_words(view)
    return f"PX4 left its hold before it was taken over (now {mode}): {WITHOUT_AGENT}"


def reason_on_ground(flight: FlightContext, view: FlightView) -> str:
    """Return why a vehicle on the ground failed, without advice about its flight."""
    if flight.reason == FLIES_WITHOUT_AGENT or flight.reason.endswith(WITHOUT_AGENT):
        return "It came down without this agent."
    return flight.reason


def still_armed(flight: FlightContext, view: FlightView) -> str:
    """Return the reason why an order to disarm or to kill has not been confirmed."""
    if view.snapshot.is_armed:
        sentence = "PX4 is still armed"
    else:
        sentence = "PX4 has not said that it is disarmed"
    return f"{sentence}. {_px4_words(flight, view)}".strip()


def disabled(flight: FlightContext) -> str:
    """Return why a vehicle that is out of service does not start."""
    name = flight.vehicle.name
    return f"{name} is disabled by {flight.disabled_by[:60]}: order enable {name} to fly it."


def stands_in(flight: FlightContext) -> str:
    """Return the sentence that names the vehicle whose place in the fleet this one has taken."""
    name = flight.vehicle.name
    if not flight.stands_in_for:
        return f"{name} takes part in flights, from its own place."
    return f"{name} stands in for {flight.stands_in_for}: with its spot, slots and paths."


def has_stand_in(name: str, other: str) -> str:
    """Return the sentence that another vehicle has this one's place in the fleet."""
    return f"{other} stands in for {name}: order swap {other} {name} to fly {name} again."


def not_rebooted(flight: FlightContext, view: FlightView) -> str:
    """Return the reason why an order to reboot has not been confirmed, with PX4's own words."""
    sentence = f"PX4's clock has not begun anew within {REBOOT_TIMEOUT_S:.0f} s."
    if view.snapshot.heartbeat_ns <= flight.step_ns:
        sentence = f"PX4 has not been heard again within {REBOOT_TIMEOUT_S:.0f} s."
    return f"{sentence} {_px4_words(flight, view)}".strip()


def not_armed(flight: FlightContext, view: FlightView) -> str:
    """Return the reason why PX4 did not arm, with PX4's own words if there are any."""
    sentence = f"PX4 did not arm within {CONFIRM_TIMEOUT_S:.0f} s."
    return f"{sentence} {_px4_words(flight, view)}".strip()


def _px4_words(flight: FlightContext, view: FlightView) -> str:
    """Return PX4's newest status text; empty if none has arrived since the step began."""
    if view.snapshot.status_text_ns > flight.step_ns:
        return view.snapshot.status_text
    return ""


def at_height(flight: FlightContext, view: FlightView) -> str:
    """Return the end of a take-off."""
    _, _, z_m = view.position_enu_m
    return f"At {z_m:.2f} m."


def not_at_height(flight: FlightContext, view: FlightView) -> str:
    """Return the end of a take-off that takes too long."""
    return f"Not at its height after {flight.seconds(view):.0f} s; holding."


def not_landed(flight: FlightContext, view: FlightView) -> str:
    """Return the end of a landing by PX4 that takes too long."""
    return f"PX4 has not landed after {flight.seconds(view):.0f} s: land it with the transmitter."


def at_position(flight: FlightContext, view: FlightView) -> str:
    """Return the end of a move."""
    return f"At {position_text(view)}."


def left_behind(flight: FlightContext, view: FlightView) -> str:
    """Return the reason why a vehicle leaves its path."""
    path = flight.path
    return (
        f"{path.lag_m:.1f} m behind its path at {path.time_s:.1f} s, "
        f"after {CATCH_UP_LIMIT_S:.0f} s in which all slowed."
    )


def paused(flight: FlightContext, view: FlightView) -> str:
    """Return the end of an order to pause, with the state of the battery."""
    return f"Pausing at {flight.path.time_s:.1f} s of its path. {_battery_words(flight, view)}"


def _battery_words(flight: FlightContext, view: FlightView) -> str:
    """Return the sentence about the charge, and the charge at which the vehicle lands."""
    left_pct = 100.0 * view.snapshot.battery_frac
    land_pct = flight.fleet.fleet.battery_land_pct
    return f"The battery has {left_pct:.0f} %; at {land_pct:g} % it lands."


def resumed(flight: FlightContext, view: FlightView) -> str:
    """Return the end of an order to resume, which is given before the pause ends."""
    if not flight.path.is_paused:
        return "This vehicle was not paused."
    return f"Going on at {flight.path.time_s:.1f} s of its path, once all others go on."


def skipped(flight: FlightContext, view: FlightView) -> str:
    """Return the end of an order to skip the rest of a path."""
    return f"Leaving its path at {flight.path.time_s:.1f} s, for the end of it."


def follow_stopped(flight: FlightContext, view: FlightView, *, is_skipped: bool) -> str:
    """Return the end of an order to pause or to skip, of a vehicle that follows another one."""
    leader = flight.followed
    if is_skipped:
        return f"It follows {leader} no further, and holds here."

    battery = _battery_words(flight, view)
    return f"Holding here; `resume` lets it follow {leader} again. {battery}"


def follows_again(flight: FlightContext, view: FlightView) -> str:
    """Return the end of an order to resume, of a vehicle that follows another one."""
    return f"Following {flight.followed} again."


def holding(flight: FlightContext, view: FlightView) -> str:
    """Return the end of an order to hold."""
    return f"Holding at {position_text(view)}."


def landed_as_ordered(flight: FlightContext, view: FlightView) -> str:
    """Return the end of an order that has landed the vehicle."""
    if flight.reason == LANDS_TO_DISARM:
        return f"It had left the ground and landed at once. {LANDED}"
    return LANDED


def why_landed(flight: FlightContext, view: FlightView) -> str:
    """Return the reason why an order other than `land` ended with a landing."""
    if not flight.reason:
        return "Landed."
    return flight.reason


def px4_does_not_land(flight: FlightContext, view: FlightView) -> str:
    """Return the reason why PX4's landing has failed."""
    mode = _mode_words(view)
    return f"PX4 does not land; its mode is {mode}: land it with the transmitter."


def _mode_words(view: FlightView) -> str:
    """Return PX4's mode; "unknown" before the first heartbeat."""
    if not view.snapshot.mode:
        return "unknown"
    return view.snapshot.mode
