"""The failsafe table: the action for every pair of a situation and a condition, decided beforehand.
Pure data.

Of all conditions that hold, the strongest action counts, and it is kept: an action ends only by a
stronger one or by an operator's order (:func:`latched`).

The rank of an action says how much of the flight it takes away from this agent: first the speed,
then the goal, then the flight itself, then the controls. A higher rank is safer whenever something
is in doubt on which the lower rank relies, and the table uses a rank only in such cases. It is no
scale of comfort: PX4's landing does not avoid the others, and after silence PX4's own failsafe
lands. Both stand above the landing under the law, for cases in which that landing cannot be
trusted. LEVEL is a hold without a usable tick: while it lasts, setpoints are level; afterwards the
vehicle holds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import Enum, IntEnum


class Situation(Enum):
    """State of the flight, as coarsely as the failsafe table distinguishes it."""

    __hash__ = object.__hash__  # Enum's own costs a call of Python for each look-up

    GROUND = "on the ground, disarmed"
    ARMED = "armed on the ground"
    LIFTOFF = "lifting off"
    FLYING = "flying"
    LANDING = "landing by setpoint"
    PX4_LANDING = "landing by PX4"
    SILENT = "given up, no setpoints"


class Condition(Enum):
    """Everything that can be wrong, in groups. Of two conditions with the same action the first one
    is named.

    The names are codes of events, the values are words of the telemetry and of docs/failsafe.md.
    """

    __hash__ = object.__hash__

    # own motion
    POSITION_STALE = "own position stale"
    POSITION_LOST = "own position lost"
    POSITION_LOST_LONG = "own position lost for long"
    POSITION_JUMPED = "own position jumped"
    MOCAP_SWAPPED = "mocap takes it for another vehicle"
    MOCAP_FROZEN = "mocap repeats itself"
    MOCAP_LATE = "mocap late"
    SATELLITES_LOST = "satellites lost"
    POSITION_INACCURATE = "own position inaccurate"
    # autopilot
    LEFT_OFFBOARD = "PX4 left OFFBOARD"
    PX4_FAILSAFE = "PX4 left OFFBOARD by its own failsafe"
    DISARMED = "PX4 disarmed in flight"
    REBOOTED = "PX4 rebooted"
    AUTOPILOT_SILENT = "PX4 silent"
    AUTOPILOT_IMPOSSIBLE = "PX4's numbers are impossible"
    AUTOPILOT_FROZEN = "PX4 frozen"
    AUTOPILOT_BACK = "PX4 back after a standstill"
    HEARTBEAT_LOST = "PX4's heartbeat lost"
    REPORTS_CONTRADICT = "PX4's reports contradict each other"
    REPORTS_CONTRADICT_LONG = "PX4's reports contradict each other for long"
    LANDED_UNKNOWN = "PX4 does not tell whether it is on the ground"
    LANDED_WRONG = "PX4 reports the ground in flight"
    ATTITUDE_NOT_FOLLOWED = "attitude does not follow"
    THRUST_SATURATED = "thrust saturated"
    NOT_CLIMBING = "not climbing with full thrust"
    FALLEN = "on the ground though it should fly"
    # own process
    LOOP_LATE = "loop late"
    LOOP_STALLED = "loop stalled"
    LOOP_STALLED_LONG = "loop stalled for long"
    CLOCK_JUMPED = "a clock jumped"
    NOT_FINITE = "tick not finite"
    NOT_FINITE_LONG = "ticks not finite for long"
    OWN_LAW_REFUSED = "own law refused, Covey's flies"
    DISK_FULL = "disk full"
    TWIN = "another agent for this vehicle"
    SHUTDOWN = "agent asked to stop"
    # bus and ground
    BUS_LOST = "bus lost"
    BUS_LOST_LONG = "bus lost for long"
    GROUND_LOST = "ground station lost"
    GROUND_LOST_LONG = "ground station lost for long"
    ORDER_OVERDUE = "order overdue"
    # other vehicles
    COLLISION_SUSPECTED = "collision suspected"
    SEPARATION_BREACHED = "separation breached"
    SEPARATION_PREDICTED = "separation will be lost"
    LAW_INFEASIBLE = "avoidance infeasible"
    NEIGHBOUR_UNSEEN = "neighbour silent and not seen"
    NEIGHBOUR_SILENT = "neighbour silent"
    NEIGHBOUR_INVALID = "neighbour without position"
    NEIGHBOUR_UNCOOPERATIVE = "neighbour does not do what it says"
    NEIGHBOUR_IMPLAUSIBLE = "neighbour's word cannot be true"
    NEIGHBOUR_STALE = "neighbour's messages late"
    NEIGHBOUR_BACK = "neighbour heard again"
    CONFIG_DIFFERS = "neighbour with another fleet file or law"
    # energy and space
    BATTERY_WARNING = "battery low"
    BATTERY_LOW = "battery at the landing level"
    BATTERY_FALLING = "battery falling fast"
    BATTERY_UNKNOWN = "battery not told"
    FENCE_NEAR = "geofence near"
    FENCE_BREACH = "geofence crossed"
    FENCE_BREACH_LONG = "geofence crossed for long"
    CEILING = "above the ceiling"


class Action(IntEnum):
    """Actions from the mildest to the strongest; the number is the rank."""

    GO_ON = 0  # at most reported
    REFUSE = 1  # no take-off while it lasts
    SLOW = 2  # the order goes on at reduced speed
    HOLD = 3  # stop here; the order has failed
    LEVEL = 4  # hold without a usable tick: level attitude at hover thrust while it lasts
    LAND = 5  # land by setpoint, under the avoidance law
    PX4_LAND = 6  # command PX4's landing, then silence
    DISARM = 7  # on the ground only
    STOP = 8  # no more setpoints


WORDS: dict[Action, str] = {
    Action.GO_ON: "going on",
    Action.REFUSE: "no take-off",
    Action.SLOW: "flying slowly",
    Action.HOLD: "holding",
    Action.LEVEL: "level at hover thrust",
    Action.LAND: "landing",
    Action.PX4_LAND: "PX4 lands",
    Action.DISARM: "disarming",
    Action.STOP: "no more setpoints are sent",
}

_C, _A = Condition, Action

TABLE: dict[tuple[Situation, Condition], Action] = {
    (situation, condition): action
    for condition, row in {
        # condition: GROUND, ARMED, LIFTOFF, FLYING, LANDING, PX4_LANDING, SILENT
        # own dead reckoning is better than PX4's for some seconds, and the others hear where it
        # leads; PX4's landing avoids nobody, was 1 to 2.3 m off after 4 s, and ended two flights of
        # five in a collision. Whatever else holds, a flight without a position brakes and sinks
        # (docs/flight.md); back in time, its order goes on
        _C.POSITION_STALE: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.POSITION_LOST: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON),
        _C.POSITION_LOST_LONG: (
            _A.REFUSE,
            _A.DISARM,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # on the ground it may be believed again: a vehicle can be carried there. Nobody starts from
        # such a place. In the air, without these samples, the estimate continues on attitude and
        # thrust, which is good enough for the 0.2 s until it counts as stale: braking under the law
        # is better than flying on
        _C.POSITION_JUMPED: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.MOCAP_SWAPPED: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.MOCAP_FROZEN: (_A.REFUSE, _A.GO_ON, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # the estimate compensates the age, but its error grows with the speed
        _C.MOCAP_LATE: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # PX4's own position runs away from then on: down by dead reckoning, out of the others'
        # heights
        _C.SATELLITES_LOST: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # no distance that the others keep covers it: down before it is worse, under the law with
        # what it has
        _C.POSITION_INACCURATE: (
            _A.REFUSE,
            _A.DISARM,
            _A.LAND,
            _A.LAND,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # whoever took the controls flies it, also out of PX4's landing, which is not commanded
        # again then
        _C.LEFT_OFFBOARD: (_A.GO_ON, _A.DISARM, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        _C.PX4_FAILSAFE: (_A.GO_ON, _A.DISARM, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON, _A.GO_ON),
        # the kill switch was used: never arm again by itself; in a landing it is how the landing
        # ends
        _C.DISARMED: (_A.GO_ON, _A.GO_ON, _A.STOP, _A.STOP, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # it has forgotten modes, parameters that were not saved, and where its local origin was
        _C.REBOOTED: (_A.REFUSE, _A.DISARM, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        _C.AUTOPILOT_SILENT: (_A.REFUSE, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        # nobody can fly by them, and as for a silent one PX4's own failsafe is what is left
        _C.AUTOPILOT_IMPOSSIBLE: (_A.REFUSE, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        # setpoints sent to it now would be obeyed late, all at once
        _C.AUTOPILOT_FROZEN: (_A.REFUSE, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        # it flew on its last setpoint meanwhile, and its own failsafe is timed by the clock that
        # stood still
        _C.AUTOPILOT_BACK: (_A.GO_ON, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # attitude still arrives, so it follows setpoints; but its mode is not known any more
        _C.HEARTBEAT_LOST: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # one wrong datagram ends no flight; from several on nobody knows which of two senders is
        # the PX4
        _C.REPORTS_CONTRADICT: (
            _A.REFUSE,
            _A.DISARM,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        _C.REPORTS_CONTRADICT_LONG: (
            _A.REFUSE,
            _A.DISARM,
            _A.LAND,
            _A.LAND,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # a landing under the law ends by its own signs of contact and by PX4's word that it is
        # disarmed
        _C.LANDED_UNKNOWN: (_A.REFUSE, _A.DISARM, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # a PX4 that believes to have landed disarms soon: the lower it is by then, the better
        _C.LANDED_WRONG: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # our setpoints do not reach the motors; PX4's own landing does not depend on them
        _C.ATTITUDE_NOT_FOLLOWED: (
            _A.GO_ON,
            _A.GO_ON,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.GO_ON,
            _A.GO_ON,
        ),
        _C.THRUST_SATURATED: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.NOT_CLIMBING: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # after a collision or a failed motor: thrust does not help; PX4's failsafe for lost
        # setpoints disarms
        _C.FALLEN: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.STOP, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.LOOP_LATE: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.LOOP_STALLED: (_A.GO_ON, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # PX4 has begun to land meanwhile: new setpoints would interrupt its landing
        _C.LOOP_STALLED_LONG: (
            _A.GO_ON,
            _A.DISARM,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # wrong ages have rows of their own; the jump itself changes nothing in flight
        _C.CLOCK_JUMPED: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.NOT_FINITE: (_A.REFUSE, _A.GO_ON, _A.LAND, _A.LEVEL, _A.LEVEL, _A.GO_ON, _A.GO_ON),
        _C.NOT_FINITE_LONG: (
            _A.REFUSE,
            _A.DISARM,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.PX4_LAND,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # Covey's law was computed beside it all the time, so nothing is missing; the next flight
        # begins with it again
        _C.OWN_LAW_REFUSED: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # no flight begins without a record; none ends because of it
        _C.DISK_FULL: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # on the ground neither flies; an agent in the air goes on, since the second one sends
        # nothing
        _C.TWIN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.SHUTDOWN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BUS_LOST: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BUS_LOST_LONG: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # no start is completed without anybody; in flight it is no emergency: the order is
        # finished, the vehicle holds
        _C.GROUND_LOST: (_A.GO_ON, _A.DISARM, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # nobody comes back, and PX4's failsafe for an empty battery would land all at once, without
        # avoidance
        _C.GROUND_LOST_LONG: (_A.GO_ON, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # a take-off has time limits of its own; a landing that does not come down is left to PX4
        _C.ORDER_OVERDUE: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.HOLD, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        # land, but under the law: PX4's landing would not keep away from the other vehicle
        _C.COLLISION_SUSPECTED: (
            _A.REFUSE,
            _A.DISARM,
            _A.LAND,
            _A.LAND,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # the law already separates them as hard as it can: stopping or landing would only interrupt
        # that
        _C.SEPARATION_BREACHED: (
            _A.REFUSE,
            _A.DISARM,
            _A.GO_ON,
            _A.SLOW,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        _C.SEPARATION_PREDICTED: (
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.SLOW,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # no goal is pursued without avoidance
        _C.LAW_INFEASIBLE: (_A.GO_ON, _A.GO_ON, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # nobody knows where it is: a vehicle that holds is at least where the others expect it
        _C.NEIGHBOUR_UNSEEN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # avoided where the mocap measures it, with full responsibility on our side
        _C.NEIGHBOUR_SILENT: (
            _A.REFUSE,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # like a silent one
        _C.NEIGHBOUR_INVALID: (
            _A.REFUSE,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # with full responsibility on our side, too, but its next motion cannot be predicted
        _C.NEIGHBOUR_UNCOOPERATIVE: (
            _A.REFUSE,
            _A.GO_ON,
            _A.GO_ON,
            _A.SLOW,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        # the same, and it is avoided where it says or where the mocap sees it, whichever is nearer
        _C.NEIGHBOUR_IMPLAUSIBLE: (
            _A.REFUSE,
            _A.DISARM,
            _A.GO_ON,
            _A.SLOW,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        _C.NEIGHBOUR_STALE: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # its newest message gives its position, so it is believed at once
        _C.NEIGHBOUR_BACK: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # it does not take off either; in flight nobody knows by which rules it avoids: all of it is
        # left to us
        _C.CONFIG_DIFFERS: (_A.REFUSE, _A.DISARM, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BATTERY_WARNING: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BATTERY_LOW: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # it would be empty before the vehicle is down if that waited for the landing level
        _C.BATTERY_FALLING: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # no flight goes on whose end nobody can foresee
        _C.BATTERY_UNKNOWN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.FENCE_NEAR: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # the vehicle holds at a point inside
        _C.FENCE_BREACH: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.FENCE_BREACH_LONG: (
            _A.REFUSE,
            _A.DISARM,
            _A.LAND,
            _A.LAND,
            _A.GO_ON,
            _A.GO_ON,
            _A.GO_ON,
        ),
        _C.CEILING: (_A.GO_ON, _A.GO_ON, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
    }.items()
    for situation, action in zip(Situation, row, strict=True)
}

_RANK = {condition: rank for rank, condition in enumerate(Condition)}


def decide(
    situation: Situation, conditions: Collection[Condition]
) -> tuple[Action, Condition | None]:
    """Decide by the table.

    Args:
        situation: of the vehicle.
        conditions: all that hold.
    Returns:
        the strongest action, and the condition that demands it: of several the first one in
            :class:`Condition`. Without
        conditions GO_ON and None.
    """
    if not conditions:
        return Action.GO_ON, None
    best: tuple[Action, Condition | None] = (Action.GO_ON, None)
    for condition in in_order(conditions):
        action = TABLE[situation, condition]
        if best[1] is None or action > best[0]:
            best = action, condition
    return best


def needs_level(situation: Situation, conditions: Iterable[Condition]) -> bool:
    """Whether the setpoint of this tick must be level, whatever else is done.

    Args:
        situation: of the vehicle.
        conditions: all that hold.
    Returns:
        True if any of them demands LEVEL.
    """
    return any(TABLE[situation, condition] is Action.LEVEL for condition in conditions)


_KEPT = {Action.REFUSE: Action.GO_ON, Action.LEVEL: Action.HOLD}


def latched(before: Action, demanded: Action) -> Action:
    """Return the action that follows another one without an order in between: never a weaker one.

    Args:
        before: action of the last tick. A level flight leaves a hold, since its order has failed; a
            refusal leaves nothing.
        demanded: by the conditions that hold now.
    Returns:
        the action of this tick.
    """
    return max(_KEPT.get(before, before), demanded)


def in_order(conditions: Iterable[Condition]) -> list[Condition]:
    """Sort conditions.

    Args:
        conditions: any.
    Returns:
        the same in the order of the table.
    """
    return sorted(conditions, key=_RANK.__getitem__)
