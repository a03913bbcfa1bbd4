"""The failsafe table: the action for every pair of a situation and a condition. Pure data.

Of all conditions that hold, the one with the strongest action counts. The action is kept until a
stronger action or an operator's order replaces it (:func:`latched`).

A strong action takes much control away from the agent. It is used only if a weaker action needs a
part of the agent that may have failed. For example, PX4's own landing does not avoid the other
vehicles, so it is used only if the agent's landing cannot be trusted.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import Enum, IntEnum


class Situation(Enum):
    """State of the flight, as coarsely as the failsafe table needs."""

    __hash__ = object.__hash__  # faster: Enum's own hash is a Python function

    GROUND = "on the ground, disarmed"
    ARMED = "armed on the ground"
    LIFTOFF = "lifting off"
    FLYING = "flying"
    LANDING = "landing by setpoint"
    PX4_LANDING = "landing by PX4"
    SILENT = "given up, no setpoints"


class Condition(Enum):
    """Everything that can be wrong, in groups.

    If two conditions have the same action, the first one is reported as the cause. The names are
    the codes of events. The values are shown in the telemetry and in docs/failsafe.md.
    """

    __hash__ = object.__hash__  # as for Situation

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
    POSITION_UNFIT = "own position contradicts own motion"
    FIX_COARSE = "satellite fix fell back, position coarse"
    FIX_FELL_BACK = "satellite fix fell back"
    BASE_FAULT = "base of the corrections not believed"
    CORRECTIONS_OLD = "corrections old"
    # autopilot
    FLOWN_BY_HAND = "flown by hand"
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
    TWIN = "another agent for this vehicle"  # a duplicate, see DuplicateAgents
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
    NEIGHBOUR_BLIND = "neighbour flies by dead reckoning"
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
    # air
    WIND_ABOVE = "wind above its limit"
    PUSHED_ABOUT = "pushed about"
    WIND_NEAR = "wind near its limit"
    DISTURBANCE_BOUND = "disturbance larger than it learns"


class Action(IntEnum):
    """Actions from the mildest to the strongest; the number is the rank."""

    GO_ON = 0  # at most reported
    REFUSE = 1  # no take-off while it lasts
    SLOW = 2  # the order continues at reduced speed
    HOLD = 3  # stop here; the order has failed
    LEVEL = 4  # while ticks give no usable setpoint: level attitude at hover thrust
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

# short names, so that the table below reads as a table
C = Condition
GO_ON = Action.GO_ON
REFUSE = Action.REFUSE
SLOW = Action.SLOW
HOLD = Action.HOLD
LEVEL = Action.LEVEL
LAND = Action.LAND
PX4_LAND = Action.PX4_LAND
DISARM = Action.DISARM
STOP = Action.STOP

# fmt: off
_ROWS: dict[Condition, tuple[Action, ...]] = {
    # situation:                GROUND   ARMED   LIFTOFF   FLYING    LANDING   PX4    SILENT
    #                                                                          LANDING

    # -- own motion
    # For some seconds, the agent's dead reckoning is better than PX4's landing, which avoids no
    # other vehicles. During this time the vehicle brakes and sinks (docs/flight.md). If the poses
    # return in time, its order continues.
    C.POSITION_STALE:          (REFUSE,  GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    C.POSITION_LOST:           (REFUSE,  DISARM, LAND,     LAND,     LAND,     GO_ON, GO_ON),
    C.POSITION_LOST_LONG:      (REFUSE,  DISARM, PX4_LAND, PX4_LAND, PX4_LAND, GO_ON, GO_ON),
    # On the ground, somebody may have carried the vehicle. In the air, samples after a jump are not
    # used. The vehicle brakes, with an estimate from attitude and thrust, until the estimate counts
    # as stale.
    C.POSITION_JUMPED:         (REFUSE,  DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    C.MOCAP_SWAPPED:           (REFUSE,  DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    C.MOCAP_FROZEN:            (REFUSE,  GO_ON,  LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    # The estimate compensates the age, but its error grows with the speed.
    C.MOCAP_LATE:              (REFUSE,  GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # From now on, PX4's position drifts. The vehicle descends by dead reckoning, away from the
    # heights of the others.
    C.SATELLITES_LOST:         (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # The error is larger than the margins that the others keep. The vehicle lands under the law
    # with its present position, before the error grows.
    C.POSITION_INACCURATE:     (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # Late positions make a vehicle circle. Counting them as half a second old stops the circling,
    # but how late they really are is not known.
    C.POSITION_UNFIT:          (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # The others receive the new standard deviation at once, and keep larger margins. If it is
    # larger than planned for the fleet, the vehicle stops, because its goal may now be elsewhere.
    C.FIX_COARSE:              (REFUSE,  DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    C.FIX_FELL_BACK:           (REFUSE,  DISARM, GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # PX4 no longer gets this base's corrections. The fix shows their absence.
    C.BASE_FAULT:              (REFUSE,  DISARM, GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    C.CORRECTIONS_OLD:         (GO_ON,   GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),

    # -- PX4
    # A pilot whose sticks PX4 hears is not overruled, not even during a landing.
    C.FLOWN_BY_HAND:           (GO_ON,   DISARM, STOP,     STOP,     STOP,     STOP,  GO_ON),
    # Somebody has taken the controls. If this ended a landing by PX4, the landing is not commanded
    # again.
    C.LEFT_OFFBOARD:           (GO_ON,   DISARM, STOP,     STOP,     STOP,     STOP,  GO_ON),
    C.PX4_FAILSAFE:            (GO_ON,   DISARM, STOP,     STOP,     STOP,     GO_ON, GO_ON),
    # The kill switch was used, so the agent does not arm again. At the end of a landing, PX4
    # disarms.
    C.DISARMED:                (GO_ON,   GO_ON,  STOP,     STOP,     GO_ON,    GO_ON, GO_ON),
    # PX4 has lost its mode, its unsaved parameters and its local origin.
    C.REBOOTED:                (REFUSE,  DISARM, STOP,     STOP,     STOP,     STOP,  GO_ON),
    C.AUTOPILOT_SILENT:        (REFUSE,  STOP,   STOP,     STOP,     STOP,     STOP,  GO_ON),
    # The agent cannot fly with such numbers. PX4's own failsafe must act, as for a silent PX4.
    C.AUTOPILOT_IMPOSSIBLE:    (REFUSE,  STOP,   STOP,     STOP,     STOP,     STOP,  GO_ON),
    # PX4 would execute the present setpoints later, all at once.
    C.AUTOPILOT_FROZEN:        (REFUSE,  STOP,   STOP,     STOP,     STOP,     STOP,  GO_ON),
    # PX4 has been flying its last setpoint. Its own failsafe has not acted, because PX4's clock
    # stood still.
    C.AUTOPILOT_BACK:          (GO_ON,   DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    # PX4's attitude still arrives, so PX4 follows setpoints. But its mode is no longer known.
    C.HEARTBEAT_LOST:          (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # One wrong datagram does not end a flight. After several, it is unclear which of two senders is
    # PX4.
    C.REPORTS_CONTRADICT:      (REFUSE,  DISARM, GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    C.REPORTS_CONTRADICT_LONG: (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # A landing under the law ends by its own signs of contact, and when PX4 reports that it is
    # disarmed.
    C.LANDED_UNKNOWN:          (REFUSE,  DISARM, GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    # A PX4 that reports the ground soon disarms, so the vehicle should be as low as possible by
    # then.
    C.LANDED_WRONG:            (GO_ON,   GO_ON,  GO_ON,    LAND,     GO_ON,    GO_ON, GO_ON),
    # Our setpoints do not reach the motors. PX4's own landing does not depend on them.
    C.ATTITUDE_NOT_FOLLOWED:   (GO_ON,   GO_ON,  PX4_LAND, PX4_LAND, PX4_LAND, GO_ON, GO_ON),
    C.THRUST_SATURATED:        (GO_ON,   GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    C.NOT_CLIMBING:            (GO_ON,   GO_ON,  GO_ON,    LAND,     GO_ON,    GO_ON, GO_ON),
    # A collision or a failed motor leaves a vehicle like this. Thrust does not help. PX4's failsafe
    # for lost setpoints disarms.
    C.FALLEN:                  (GO_ON,   GO_ON,  GO_ON,    STOP,     GO_ON,    GO_ON, GO_ON),

    # -- own process
    C.LOOP_LATE:               (GO_ON,   GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    C.LOOP_STALLED:            (GO_ON,   DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    # PX4 has started to land by now, and new setpoints would interrupt its landing.
    C.LOOP_STALLED_LONG:       (GO_ON,   DISARM, PX4_LAND, PX4_LAND, PX4_LAND, GO_ON, GO_ON),
    # Data that look old after a jump have rows of their own.
    C.CLOCK_JUMPED:            (REFUSE,  GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    C.NOT_FINITE:              (REFUSE,  GO_ON,  LAND,     LEVEL,    LEVEL,    GO_ON, GO_ON),
    C.NOT_FINITE_LONG:         (REFUSE,  DISARM, PX4_LAND, PX4_LAND, PX4_LAND, GO_ON, GO_ON),
    # Covey's law takes over at once. The next flight starts with the user's own law again.
    C.OWN_LAW_REFUSED:         (GO_ON,   GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    # No flight starts without a record. A flight that has started continues without one.
    C.DISK_FULL:               (REFUSE,  GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    # On the ground, neither agent takes off. An agent in the air continues, because the second one
    # sends nothing.
    C.TWIN:                    (REFUSE,  DISARM, LAND,     GO_ON,    GO_ON,    GO_ON, GO_ON),
    C.SHUTDOWN:                (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),

    # -- bus and ground
    C.BUS_LOST:                (REFUSE,  DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    C.BUS_LOST_LONG:           (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # Without a ground, no start is completed. In flight, a lost ground is not an emergency. The
    # vehicle finishes its order, and then holds.
    C.GROUND_LOST:             (GO_ON,   DISARM, LAND,     GO_ON,    GO_ON,    GO_ON, GO_ON),
    # The ground has not come back. So the vehicles land now, under the law, because PX4's failsafe
    # for an empty battery would land all of them at once, without avoidance.
    C.GROUND_LOST_LONG:        (GO_ON,   DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # A take-off has its own time limits. A landing that does not come down is left to PX4.
    C.ORDER_OVERDUE:           (GO_ON,   GO_ON,  GO_ON,    HOLD,     PX4_LAND, GO_ON, GO_ON),

    # -- other vehicles
    # The landing is under the law, because PX4's landing would not keep away from the other
    # vehicle.
    C.COLLISION_SUSPECTED:     (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # In flight the law already separates the vehicles as hard as it can, and a stop would only
    # interrupt this. While it takes off, a person may have walked up to it.
    C.SEPARATION_BREACHED:     (REFUSE,  DISARM, LAND,     SLOW,     GO_ON,    GO_ON, GO_ON),
    C.SEPARATION_PREDICTED:    (GO_ON,   GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # No goal is pursued without avoidance.
    C.LAW_INFEASIBLE:          (GO_ON,   GO_ON,  LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    # The neighbour's position is not known. A vehicle that holds is at least where the others
    # expect it.
    C.NEIGHBOUR_UNSEEN:        (REFUSE,  DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    # This vehicle alone does the avoiding, at the neighbour's position from the mocap.
    C.NEIGHBOUR_SILENT:        (REFUSE,  GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    # The neighbour is treated like a silent one.
    C.NEIGHBOUR_INVALID:       (REFUSE,  GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    # The neighbour brakes and sinks, and stops at once when it touches the ground. A vehicle that
    # follows it at full speed could not stop in time, and leaves it no room to brake.
    C.NEIGHBOUR_BLIND:         (REFUSE,  GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # This vehicle alone does the avoiding, and cannot predict the neighbour's next motion.
    C.NEIGHBOUR_UNCOOPERATIVE: (REFUSE,  GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # Here, too, this vehicle alone does the avoiding. It avoids the position from the neighbour or
    # the position from the mocap, whichever is nearer.
    C.NEIGHBOUR_IMPLAUSIBLE:   (REFUSE,  DISARM, GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    C.NEIGHBOUR_STALE:         (GO_ON,   GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # The neighbour's newest message gives its position, which is used at once.
    C.NEIGHBOUR_BACK:          (GO_ON,   GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    # The neighbour also refuses to take off. In flight, its avoidance rules are unknown, so this
    # vehicle alone does the avoiding.
    C.CONFIG_DIFFERS:          (REFUSE,  DISARM, GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),

    # -- energy and space
    C.BATTERY_WARNING:         (REFUSE,  GO_ON,  GO_ON,    GO_ON,    GO_ON,    GO_ON, GO_ON),
    C.BATTERY_LOW:             (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # If the vehicle waited for the landing level, the battery would be empty before it is down.
    C.BATTERY_FALLING:         (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # It is unknown how long the battery lasts, so the flight does not continue.
    C.BATTERY_UNKNOWN:         (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    C.FENCE_NEAR:              (GO_ON,   GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # The vehicle holds at a point inside the fence.
    C.FENCE_BREACH:            (REFUSE,  DISARM, LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),
    C.FENCE_BREACH_LONG:       (REFUSE,  DISARM, LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    C.CEILING:                 (GO_ON,   GO_ON,  LAND,     HOLD,     GO_ON,    GO_ON, GO_ON),

    # -- air
    # The vehicle lands while it can still choose where it goes. A hold would use up the remaining
    # tilt, and a further rise of the wind would carry the vehicle away.
    C.WIND_ABOVE:              (GO_ON,   GO_ON,  LAND,     LAND,     GO_ON,    GO_ON, GO_ON),
    # The margins that the others keep do not cover such gusts, and a holding vehicle would scatter
    # as much.
    C.PUSHED_ABOUT:            (GO_ON,   GO_ON,  GO_ON,    LAND,     GO_ON,    GO_ON, GO_ON),
    # Flying more slowly leaves more tilt against the wind.
    C.WIND_NEAR:               (GO_ON,   GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
    # The observer has reached its limit. The rest of the push moves the vehicle.
    C.DISTURBANCE_BOUND:       (GO_ON,   GO_ON,  GO_ON,    SLOW,     GO_ON,    GO_ON, GO_ON),
}
# fmt: on

TABLE: dict[tuple[Situation, Condition], Action] = {
    (situation, condition): action
    for condition, actions in _ROWS.items()
    for situation, action in zip(Situation, actions, strict=True)
}

_INDEX = {condition: index for index, condition in enumerate(Condition)}

# Action -> what remains of it at the next tick; all other actions stay. After LEVEL the order has
# failed, so the vehicle holds. REFUSE lasts only as long as its condition.
_NEXT_TICK = {Action.REFUSE: Action.GO_ON, Action.LEVEL: Action.HOLD}


def decide(
    situation: Situation, conditions: Collection[Condition]
) -> tuple[Action, Condition | None]:
    """Return the strongest action, and the condition that requires it.

    Args:
        situation: situation of the vehicle.
        conditions: all conditions that hold.
    Returns:
        The action and its condition. If several conditions require it, the first one in
        :class:`Condition`. Without conditions, GO_ON and None.
    """
    if not conditions:
        return Action.GO_ON, None

    strongest = Action.GO_ON
    cause: Condition | None = None
    for condition in in_order(conditions):
        action = TABLE[situation, condition]
        if cause is None or action > strongest:
            strongest = action
            cause = condition
    return strongest, cause


def needs_level(situation: Situation, conditions: Iterable[Condition]) -> bool:
    """Return whether the setpoint of this tick must be level, whatever action counts.

    Args:
        situation: situation of the vehicle.
        conditions: all conditions that hold.
    """
    return any(TABLE[situation, condition] is Action.LEVEL for condition in conditions)


def latched(before: Action, demanded: Action) -> Action:
    """Return the action of this tick, if no order has arrived since the last tick.

    It is never weaker than the last action, except after REFUSE and LEVEL.

    Args:
        before: action of the last tick.
        demanded: action that the present conditions require.
    """
    lasting = _NEXT_TICK.get(before, before)
    return max(lasting, demanded)


def in_order(conditions: Iterable[Condition]) -> list[Condition]:
    """Return conditions in the order of :class:`Condition`.

    Args:
        conditions: any.
    """
    return sorted(conditions, key=_INDEX.__getitem__)
