"""The flight as a table: (step, event) -> (next step, request to PX4, ...). Pure data.

Several rows may have the same step and event. The first row with a true predicate is applied. If
there is no such row, an event changes nothing, and an order is refused. A vehicle counts as armed,
in OFFBOARD, landed or disarmed only when PX4 says so. Therefore steps wait for PX4, and a request
that has no effect is repeated.

The rows are grouped: the orders of operators, the actions of failsafes, and the events of a tick
(without poses, on the ground, in take-off, flight and landing). docs/flight.md is generated from
this table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from onboard.agent_commands import (
    Arm,
    Command,
    Disarm,
    Kill,
    Px4Land,
    RebootPx4,
    RequestHeartbeat,
    SetOffboard,
)
from onboard.bus.schema import OrderOutcome, Severity
from onboard.flight import effects, sentences
from onboard.flight import predicates as p
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightEvent as E
from onboard.flight.types import FlightStep as S
from onboard.flight.types import FlightView

Predicate = Callable[[FlightContext, FlightView], bool]
Effect = Callable[[FlightContext, FlightView], None]
Text = str | Callable[[FlightContext, FlightView], str]

CAUSE = "{cause}"  # placeholder for the reason of the failsafe or the order


class Row(NamedTuple):
    """One row of the table."""

    steps: Sequence[S]
    event: E
    when: Predicate | None = None  # None: always
    to: S | None = None  # next step. None: the step continues; the same step: it starts again
    # Command to PX4. It is sent at once if a step begins. In a row without a next step it is
    # repeated until PX4 has obeyed.
    request: Command | None = None
    effect: Effect | None = None  # sets the goal of the step
    reason: Text | None = None  # new reason, shown beside the state; None: it stays unchanged
    ends: tuple[OrderOutcome, Text] | None = None  # ends the order in progress: outcome, sentence
    says: tuple[Severity, str, Text] | None = None  # event for people: severity, code, sentence


_START = (S.WAITING, S.READY, S.LANDED)
_ARMED = (S.ARM_OFFBOARD, S.ARM_ARMING, S.ARMED, S.TAKEOFF_OFFBOARD, S.TAKEOFF_ARMING)
_STARTING = tuple(step for step in _ARMED if step is not S.ARMED)
_FREE = (S.CLIMB, S.LEG, S.PATH, S.ARRIVED, S.HOLDING)
_MAY_BEGIN_PATH = (S.LEG, S.ARRIVED, S.HOLDING)
_DOWN = (S.DESCENT, S.CONTACT)
_WITHOUT_POSES = (S.COASTING, S.SINKING)
_PX4_MAY_LAND = (
    S.ARM_ARMING,
    S.TAKEOFF_ARMING,
    S.ARMED,
    S.LIFTOFF,
    *_FREE,
    S.TAKEOVER,
    *_WITHOUT_POSES,
    *_DOWN,
)
_SILENT = (S.FAILED, S.FAILED_DISARMING, S.KILLING)
_DISARMABLE = (
    *_START,
    *_ARMED,
    S.DISARMING,
    S.DISARMED,
    S.FAILSAFE_DISARMING,
    S.CONTACT,
    S.PX4_LANDING,
)
_NO_OFFBOARD = f"PX4 did not enter OFFBOARD within {p.CONFIRM_TIMEOUT_S:.0f} s"
_STILL_FLIES = f"{_NO_OFFBOARD}: {sentences.WITHOUT_AGENT}"
_PATH_LATE = f"Not at the end of its path after {p.PATH_END_TIMEOUT_S:.0f} s; holding."
_REST_LATE = f"Not at rest after {p.HOLD_TIMEOUT_S:.0f} s; still trying to hold."

# fmt: off
ORDERS = (
    Row(_START, E.ARM, to=S.ARM_OFFBOARD, effect=effects.stay_on_ground, reason=""),
    Row(_START, E.TAKEOFF, to=S.TAKEOFF_OFFBOARD, effect=effects.stay_on_ground, reason=""),
    Row((S.ARMED,), E.TAKEOFF, to=S.LIFTOFF, effect=effects.lift_off, reason=""),
    Row(_FREE, E.MOVE, to=S.LEG, effect=effects.fly_leg, reason=""),
    Row(_MAY_BEGIN_PATH, E.FOLLOW_PATH, to=S.PATH, effect=effects.begin_path, reason=""),
    Row((S.ARRIVED, S.HOLDING), E.HOLD, when=p.at_goal, to=S.HOLDING, reason="ordered"),
    Row(_FREE, E.HOLD, to=S.HOLDING, effect=effects.stop_here, reason="ordered"),
    # Without poses it cannot hold yet: it does so when they return.
    Row((S.COASTING,), E.HOLD, to=S.COASTING, reason="ordered"),

    # An agent that started while its vehicle was flying, or that lost the vehicle, takes over from
    # PX4's hold. PX4 flies until it confirms OFFBOARD, so only PX4 can land the vehicle. The
    # heartbeat shows whether a pilot has taken over in the meantime.
    Row((*_SILENT, S.TAKEOVER), E.HOLD, to=S.TAKEOVER, request=RequestHeartbeat(),
        effect=effects.take_over, reason=S.TAKEOVER.text),

    # Hold, land and disarm all abort a start. Until PX4 confirms that it is armed, they disarm it;
    # afterwards they land it.
    Row((S.LIFTOFF,), E.HOLD, to=S.DESCENT, effect=effects.descend, reason="ordered"),
    Row(_ARMED, E.LAND, when=p.px4_is_armed, to=S.DISARMING, request=Disarm(), reason=""),
    Row(_ARMED, E.LAND, to=S.DISARMED, request=Disarm(), reason=""),
    Row(_STARTING, E.HOLD, when=p.px4_is_armed, to=S.DISARMING, request=Disarm(), reason=""),
    Row(_STARTING, E.HOLD, to=S.DISARMED, request=Disarm(), reason=""),

    Row((S.LIFTOFF, *_FREE), E.LAND, to=S.DESCENT, effect=effects.descend, reason="ordered"),
    Row((S.DESCENT,), E.LAND, to=S.DESCENT, effect=effects.descend_here, reason="ordered"),
    Row((S.COASTING,), E.LAND, to=S.SINKING, reason="ordered"),
    # It lands already, so nothing changes. A vehicle that stands gets no thrust again.
    Row((S.SINKING, S.CONTACT, S.PX4_LANDING), E.LAND),
    # These orders are done at once, because the vehicle already stands on the ground.
    Row((S.LANDED,), E.LAND, ends=("done", sentences.STANDS)),
    # Only the move `home` gets here, and only for a vehicle on its take-off spot.
    Row(_START, E.MOVE, ends=("done", sentences.STANDS_AT_HOME)),
    Row((S.DISARMING,), E.LAND, when=p.px4_reports_the_ground),  # it stands, and is disarmed
    # While PX4 is silent, nobody knows whether a pilot flies. So the ground sends a landing that
    # spares pilots straight to PX4, and asks it first.
    Row((*_SILENT, S.TAKEOVER, S.DISARMING), E.LAND, when=p.px4_cannot_tell_of_a_pilot,
        ends=("failed", sentences.NOBODY_KNOWS_OF_A_PILOT)),
    # These rows also apply after a kill, because the kill may have been lost. The rows of LANDING
    # distinguish a fall from a landing. If PX4 receives sticks, a heartbeat is requested first,
    # which shows whether a pilot flies.
    Row((*_SILENT, S.TAKEOVER, S.DISARMING), E.LAND, when=p.px4_hears_sticks, to=S.PX4_LANDING,
        request=RequestHeartbeat(), reason=sentences.ordered_or_killed),
    Row((*_SILENT, S.TAKEOVER, S.DISARMING), E.LAND, to=S.PX4_LANDING, request=Px4Land(),
        reason=sentences.ordered_or_killed),

    # CONTACT removes the thrust, so the vehicle stays on the ground even if PX4 sees a lift-off in
    # the meantime. If PX4 no longer reports the ground, the vehicle lands, because the order means
    # that it must come down.
    Row((S.LIFTOFF,), E.DISARM, when=p.px4_reports_the_ground, to=S.CONTACT, request=Disarm(),
        effect=effects.look_for_ground, reason="ordered"),
    Row((S.LIFTOFF, S.CLIMB), E.DISARM, to=S.DESCENT, effect=effects.descend,
        reason=sentences.LANDS_TO_DISARM),
    Row(_DISARMABLE, E.DISARM, when=p.px4_is_armed, to=S.DISARMING, request=Disarm(),
        effect=effects.forget_kill, reason=""),
    Row(_DISARMABLE, E.DISARM, to=S.DISARMED, request=Disarm(),
        effect=effects.forget_kill, reason=""),
    Row(_SILENT, E.DISARM, to=S.FAILED_DISARMING, request=Disarm()),

    Row(_START, E.REBOOT, to=S.REBOOTING, request=RebootPx4(),
        effect=effects.forget_kill, reason=S.REBOOTING.text),

    Row(tuple(S), E.KILL, when=p.px4_is_armed_in_the_air, to=S.KILLING, request=Kill(),
        effect=effects.note_kill, reason=sentences.killed,
        says=("critical", "killed", sentences.killed_in_the_air)),
    Row(tuple(S), E.KILL, to=S.KILLING, request=Kill(),
        effect=effects.note_kill, reason=sentences.killed),
)

FAILSAFES = (
    Row((S.LEG,), E.FAILSAFE_SLOW, when=p.not_slowed_yet, effect=effects.slow_down, reason=CAUSE),
    Row((S.CLIMB,), E.FAILSAFE_SLOW, when=p.not_slowed_yet, effect=effects.slow_climb,
        reason=CAUSE),
    Row((S.PATH,), E.FAILSAFE_SLOW, effect=effects.slow_path),

    Row((S.ARRIVED,), E.FAILSAFE_HOLD, when=p.at_goal, to=S.HOLDING, reason=CAUSE),
    Row((S.CLIMB, S.LEG, S.PATH, S.ARRIVED), E.FAILSAFE_HOLD, to=S.HOLDING,
        effect=effects.stop_here, reason=CAUSE),
    # The order has failed, but the vehicle continues to fly without poses. It holds when poses
    # return.
    Row((S.COASTING,), E.FAILSAFE_HOLD, when=p.has_order, to=S.COASTING, reason=CAUSE),

    Row((S.LIFTOFF, *_FREE), E.FAILSAFE_LAND, to=S.DESCENT, effect=effects.descend, reason=CAUSE),
    Row((S.COASTING,), E.FAILSAFE_LAND, to=S.SINKING, reason=CAUSE),
    Row((S.TAKEOVER,), E.FAILSAFE_LAND, when=p.px4_hears_sticks, to=S.PX4_LANDING,
        request=RequestHeartbeat(), reason=CAUSE),
    Row((S.TAKEOVER,), E.FAILSAFE_LAND, to=S.PX4_LANDING, request=Px4Land(), reason=CAUSE),
    Row(_PX4_MAY_LAND, E.FAILSAFE_PX4_LAND, when=p.px4_hears_sticks, to=S.PX4_LANDING,
        request=RequestHeartbeat(), reason=CAUSE),
    Row(_PX4_MAY_LAND, E.FAILSAFE_PX4_LAND, to=S.PX4_LANDING, request=Px4Land(), reason=CAUSE),

    Row((*_ARMED, S.DISARMING), E.FAILSAFE_DISARM, to=S.FAILSAFE_DISARMING,
        request=Disarm(), reason=CAUSE),
    Row((*_ARMED, S.DISARMING, S.LIFTOFF, *_FREE, S.TAKEOVER, *_WITHOUT_POSES, *_DOWN,
         S.PX4_LANDING), E.FAILSAFE_STOP, to=S.FAILED, effect=effects.note_fall, reason=CAUSE),
)

# Among the rows of ticks, those for a vehicle without poses come first.
WITHOUT_POSES = (
    Row((S.CLIMB, S.LEG, S.ARRIVED, S.HOLDING), E.TICK, when=p.is_dead_reckoned, to=S.COASTING,
        effect=effects.sink),
    Row((S.PATH,), E.TICK, when=p.is_dead_reckoned, to=S.COASTING,
        effect=effects.sink, ends=("failed", sentences.NO_POSE)),
    Row((S.LIFTOFF,), E.TICK, when=p.is_dead_reckoned, to=S.SINKING, effect=effects.sink,
        reason=sentences.NO_POSE_AT_LIFTOFF,
        says=("warning", "landing", sentences.NO_POSE_AT_LIFTOFF)),
    Row((S.DESCENT,), E.TICK, when=p.is_dead_reckoned, to=S.SINKING, effect=effects.sink),

    Row((S.COASTING,), E.TICK, when=p.has_poses_again_on_leg, to=S.LEG, effect=effects.resume),
    Row((S.COASTING,), E.TICK, when=p.has_poses_again_in_climb, to=S.CLIMB, effect=effects.resume),
    Row((S.COASTING,), E.TICK, when=p.has_poses_again, to=S.HOLDING, effect=effects.hold_again),
    Row((S.SINKING,), E.TICK, when=p.has_poses_again_for_a_while, to=S.DESCENT,
        effect=effects.descend),
    Row(_WITHOUT_POSES, E.TICK, when=p.touched_down_without_poses, to=S.CONTACT,
        effect=effects.look_for_ground),
)

GROUND = (
    Row((S.WAITING,), E.PREFLIGHT_PASSED, to=S.READY),
    Row((S.READY,), E.PREFLIGHT_REFUSED, to=S.WAITING),

    Row((S.REBOOTING,), E.TICK, when=p.px4_has_rebooted, to=S.WAITING,
        reason="", ends=("done", sentences.REBOOTED)),
    Row((S.REBOOTING,), E.TICK, when=p.px4_is_armed, to=S.WAITING,
        reason="", ends=("failed", sentences.ARMED_MEANWHILE)),
    Row((S.REBOOTING,), E.TICK, when=p.px4_has_not_rebooted_in_time, to=S.WAITING,
        reason="", ends=("timed out", sentences.not_rebooted)),

    Row((S.FAILSAFE_DISARMING,), E.TICK, when=p.px4_stays_disarmed, to=S.WAITING),
    Row((S.FAILSAFE_DISARMING,), E.TICK, when=p.px4_is_on_ground, request=Disarm()),
    Row((*_START, S.FAILSAFE_DISARMING), E.TICK, when=p.px4_flies_without_agent, to=S.FAILED,
        effect=effects.forget_kill, reason=sentences.FLIES_WITHOUT_AGENT),
    Row((S.ARMED,), E.TICK, when=p.px4_confirms_disarmed, to=S.READY, reason="",
        says=("warning", "auto-disarmed", "PX4 disarmed by itself before take-off.")),

    Row((S.DISARMING,), E.TICK, when=p.px4_stays_disarmed, to=S.READY,
        reason="", ends=("done", sentences.DISARMED)),
    Row((S.DISARMING,), E.TICK, when=p.px4_has_not_confirmed_in_time, to=S.FAILED,
        reason=sentences.still_armed, ends=("timed out", sentences.still_armed)),

    # An arming request sent before the disarming may take effect only now.
    Row((S.DISARMED,), E.TICK, when=p.px4_is_armed, to=S.DISARMING, request=Disarm()),
    Row((S.DISARMED,), E.TICK, when=p.px4_stays_disarmed, to=S.READY,
        ends=("done", sentences.DISARMED)),
    Row((S.DISARMED,), E.TICK, when=p.px4_has_not_confirmed_in_time, to=S.READY,
        ends=("timed out", sentences.still_armed)),

    Row((S.FAILED_DISARMING, S.KILLING), E.TICK, when=p.px4_confirms_disarmed, to=S.FAILED,
        ends=("done", sentences.DISARMED)),
    Row((S.FAILED_DISARMING, S.KILLING), E.TICK, when=p.px4_has_not_confirmed_in_time, to=S.FAILED,
        ends=("timed out", sentences.still_armed)),
    Row((S.DISARMING, S.FAILED_DISARMING), E.TICK, when=p.px4_is_armed, request=Disarm()),
    Row((S.KILLING,), E.TICK, when=p.px4_is_armed, request=Kill()),
    Row((S.FAILED,), E.TICK, when=p.px4_is_disarmed_on_ground, to=S.LANDED,
        reason=sentences.reason_on_ground, says=("info", "landed", "On the ground and disarmed.")),
)

TAKEOFF = (
    Row((S.ARM_OFFBOARD,), E.TICK, when=p.px4_confirms_offboard, to=S.ARM_ARMING),
    Row((S.TAKEOFF_OFFBOARD,), E.TICK, when=p.px4_confirms_offboard, to=S.TAKEOFF_ARMING),
    Row((S.ARM_OFFBOARD, S.TAKEOFF_OFFBOARD), E.TICK, when=p.px4_has_not_confirmed_in_time,
        to=S.FAILSAFE_DISARMING, request=Disarm(),
        reason=f"{_NO_OFFBOARD}.", ends=("failed", f"{_NO_OFFBOARD}.")),
    Row((S.ARM_OFFBOARD, S.TAKEOFF_OFFBOARD), E.TICK, when=p.setpoints_have_streamed,
        request=SetOffboard()),

    Row((S.ARM_ARMING,), E.TICK, when=p.px4_confirms_armed, to=S.ARMED, ends=("done", "Armed.")),
    Row((S.TAKEOFF_ARMING,), E.TICK, when=p.px4_confirms_armed, to=S.LIFTOFF,
        effect=effects.lift_off),
    Row((S.ARM_ARMING, S.TAKEOFF_ARMING), E.TICK, when=p.px4_has_not_confirmed_in_time,
        to=S.FAILSAFE_DISARMING, request=Disarm(),
        reason=sentences.not_armed, ends=("failed", sentences.not_armed)),
    Row((S.ARM_ARMING, S.TAKEOFF_ARMING), E.TICK, request=Arm()),

    Row((S.LIFTOFF,), E.TICK, when=p.lifted_off, to=S.CLIMB),
    # its poses may be those of another body
    Row((S.LIFTOFF,), E.TICK, when=p.lift_off_unseen, to=S.PX4_LANDING, request=Px4Land(),
        reason=sentences.UNSEEN_LIFTOFF, ends=("failed", sentences.UNSEEN_LIFTOFF),
        says=("critical", "unseen-liftoff", sentences.UNSEEN_LIFTOFF)),
    Row((S.LIFTOFF,), E.TICK, when=p.lift_off_late, to=S.CONTACT, effect=effects.look_for_ground,
        reason=sentences.NO_LIFTOFF, ends=("failed", sentences.NO_LIFTOFF),
        says=("critical", "no-liftoff", sentences.NO_LIFTOFF)),
    Row((S.CLIMB,), E.TICK, when=p.climbs_on, effect=effects.climb_on),
    Row((S.CLIMB,), E.TICK, when=p.arrived, to=S.ARRIVED, ends=("done", sentences.at_height)),
    Row((S.CLIMB,), E.TICK, when=p.climb_late, to=S.HOLDING, effect=effects.stop_here,
        reason="the climb took too long", ends=("timed out", sentences.not_at_height)),
)

FLYING = (
    Row((S.LEG,), E.TICK, when=p.arrived_to_land, to=S.DESCENT,
        effect=effects.descend, reason="ordered"),
    Row((S.LEG,), E.TICK, when=p.arrived, to=S.ARRIVED, ends=("done", sentences.at_position)),

    # The order to follow the path stays in progress. It is done at the end of this leg, which is
    # the end of the path.
    Row((S.PATH,), E.TICK, when=p.path_skipped, to=S.LEG, effect=effects.skip_to_end, reason=""),
    Row((S.PATH,), E.TICK, when=p.left_behind_to_land, to=S.DESCENT, effect=effects.descend,
        reason=sentences.left_behind, ends=("failed", sentences.left_behind)),
    Row((S.PATH,), E.TICK, when=p.left_behind, to=S.HOLDING, effect=effects.stop_here,
        reason=sentences.left_behind, ends=("failed", sentences.left_behind)),
    Row((S.PATH,), E.TICK, when=p.path_ended, to=S.ARRIVED, effect=effects.stay_at_end,
        ends=("done", sentences.at_position)),
    Row((S.PATH,), E.TICK, when=p.path_late, to=S.HOLDING, effect=effects.stop_here,
        reason="the path took too long", ends=("timed out", _PATH_LATE)),
    Row((S.PATH,), E.TICK, effect=effects.follow_path),

    Row((S.HOLDING,), E.TICK, when=p.at_rest, ends=("done", sentences.holding)),
    Row((S.HOLDING,), E.TICK, when=p.rest_late, ends=("timed out", _REST_LATE)),

    Row((S.TAKEOVER,), E.TICK, when=p.px4_left_its_hold, to=S.FAILED,
        reason=sentences.left_its_hold, ends=("failed", sentences.left_its_hold)),
    Row((S.TAKEOVER,), E.TICK, when=p.px4_confirms_disarmed, to=S.FAILED,
        effect=effects.note_fall, reason=sentences.MOTORS_STOPPED,
        ends=("failed", sentences.MOTORS_STOPPED),
        says=("critical", "disarmed-in-flight", sentences.MOTORS_STOPPED)),
    Row((S.TAKEOVER,), E.TICK, when=p.px4_is_taken_over, to=S.HOLDING,
        reason="ordered", ends=("done", "Taken over from PX4's hold; holding.")),
    Row((S.TAKEOVER,), E.TICK, when=p.px4_has_not_confirmed_in_time, to=S.FAILED,
        reason=_STILL_FLIES, ends=("failed", _STILL_FLIES)),
    Row((S.TAKEOVER,), E.TICK, when=p.setpoints_have_streamed, request=SetOffboard()),
)

LANDING = (
    # After a landing, PX4 disarms only once the vehicle has stood for seconds. If PX4 disarms
    # earlier, the kill has taken effect.
    Row((S.PX4_LANDING,), E.TICK, when=p.falls_by_kill, to=S.FAILED,
        ends=("failed", sentences.falls_by_kill)),
    Row((S.PX4_LANDING,), E.TICK, when=p.kill_had_no_effect,
        effect=effects.forget_kill, reason="ordered"),
    # A kill switch, or a kill past this agent. After a touchdown PX4 disarms a vehicle at rest.
    Row((S.DESCENT, S.CONTACT, S.PX4_LANDING), E.TICK, when=p.falls_disarmed, to=S.FAILED,
        effect=effects.note_fall, reason=sentences.MOTORS_STOPPED,
        ends=("failed", sentences.MOTORS_STOPPED),
        says=("critical", "disarmed-in-flight", sentences.MOTORS_STOPPED)),
    # Without poses only PX4 knows. This agent sends thrust until it sees the contact.
    Row((S.SINKING,), E.TICK, when=p.stopped_while_sinking, to=S.FAILED,
        effect=effects.note_fall, reason=sentences.MOTORS_STOPPED,
        ends=("failed", sentences.MOTORS_STOPPED),
        says=("critical", "disarmed-in-flight", sentences.MOTORS_STOPPED)),

    Row((S.DESCENT,), E.TICK, when=p.touched_down, to=S.CONTACT, effect=effects.look_for_ground),
    Row((S.CONTACT,), E.TICK, when=p.falls, to=S.DESCENT, effect=effects.descend),
    Row((S.DESCENT,), E.TICK, when=p.is_kept_off, to=S.DESCENT, effect=effects.descend_here),
    Row((S.DESCENT,), E.TICK, when=p.feels_for_ground, effect=effects.feel_for_ground),
    Row((S.DESCENT,), E.TICK, when=p.ground_is_lower, to=S.DESCENT, effect=effects.descend_further),

    Row((S.SINKING, S.CONTACT, S.PX4_LANDING), E.TICK, when=p.landed_by_order, to=S.LANDED,
        ends=("done", sentences.landed_as_ordered)),
    Row((S.SINKING, S.CONTACT, S.PX4_LANDING), E.TICK, when=p.landed, to=S.LANDED,
        ends=("failed", sentences.why_landed), says=("info", "landed", sentences.LANDED)),
    Row((S.CONTACT,), E.TICK, when=p.px4_should_have_disarmed, request=Disarm()),

    Row((S.PX4_LANDING,), E.TICK, when=p.px4_refuses_to_land, request=Px4Land(),
        ends=("failed", sentences.px4_does_not_land)),
    Row((S.PX4_LANDING,), E.TICK, when=p.px4_does_not_land, request=Px4Land()),
    # The vehicle has never left the ground, or the request to land was lost.
    Row((S.PX4_LANDING,), E.TICK, when=p.px4_stays_armed_on_ground, request=Disarm()),
    Row((S.PX4_LANDING,), E.TICK, when=p.px4_landing_late,
        ends=("timed out", sentences.not_landed)),
)
# fmt: on

ROWS = (*ORDERS, *FAILSAFES, *WITHOUT_POSES, *GROUND, *TAKEOFF, *FLYING, *LANDING)


def _by_step_and_event() -> dict[tuple[S, E], tuple[Row, ...]]:
    """Return the rows of each step and event, in the order of the table."""
    table: dict[tuple[S, E], tuple[Row, ...]] = {}
    for row in ROWS:
        for step in row.steps:
            rows_before = table.get((step, row.event), ())
            table[step, row.event] = (*rows_before, row)
    return table


TABLE = _by_step_and_event()
