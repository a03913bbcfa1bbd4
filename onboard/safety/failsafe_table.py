"""The failsafe table: what a vehicle does when something is wrong, decided for every pair before anything happens.

Pure data: (situation, condition) -> action. Of all conditions that hold the strongest action counts, and it is kept:
what a failsafe has begun ends only by a stronger one or by an operator's order (:func:`latched`).

The order of the actions. A higher rank leaves less of the flight to this agent: first it gives up pace, then the goal,
then the air, then the controls. That is safer whenever what the lower rank relies on is in doubt, and the table uses a
rank only where that is so. It is no scale of comfort: PX4's landing does not avoid the others, and silence means that
PX4's own failsafe lands, so both stand above the landing under the law, for cases in which that cannot be trusted.
LEVEL is a hold without eyes: while it lasts, setpoints are level; afterwards the vehicle holds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import Enum, IntEnum


class Situation(Enum):
    """What the vehicle is doing, as far as failsafes care."""

    __hash__ = object.__hash__  # Enum's own costs a call of Python for each look-up

    GROUND = "on the ground, disarmed"
    ARMED = "armed on the ground"
    LIFTOFF = "lifting off"
    FLYING = "flying"
    LANDING = "landing by setpoint"
    PX4_LANDING = "landing by PX4"
    SILENT = "given up, no setpoints"


class Condition(Enum):
    """What can be wrong, grouped by whom it concerns; of two that ask the same the first one speaks."""

    __hash__ = object.__hash__

    # the own motion
    POSITION_STALE = "own position stale"
    POSITION_LOST = "own position lost"
    POSITION_JUMPED = "own position jumped"
    MOCAP_SWAPPED = "mocap takes it for another vehicle"
    MOCAP_FROZEN = "mocap repeats itself"
    MOCAP_LATE = "mocap late"
    # the autopilot
    LEFT_OFFBOARD = "PX4 left OFFBOARD"
    PX4_FAILSAFE = "PX4 left OFFBOARD by its own failsafe"
    DISARMED = "PX4 disarmed in flight"
    REBOOTED = "PX4 rebooted"
    AUTOPILOT_SILENT = "PX4 silent"
    AUTOPILOT_FROZEN = "PX4 frozen"
    AUTOPILOT_BACK = "PX4 back after a standstill"
    HEARTBEAT_LOST = "PX4's heartbeat lost"
    ATTITUDE_NOT_FOLLOWED = "attitude does not follow"
    THRUST_SATURATED = "thrust saturated"
    NOT_CLIMBING = "not climbing with full thrust"
    FALLEN = "on the ground though it should fly"
    # the own process
    LOOP_LATE = "loop late"
    LOOP_STALLED = "loop stalled"
    LOOP_STALLED_LONG = "loop stalled for long"
    CLOCK_JUMPED = "a clock jumped"
    NOT_FINITE = "tick not finite"
    NOT_FINITE_LONG = "ticks not finite for long"
    DISK_FULL = "disk full"
    TWIN = "another agent for this vehicle"
    SHUTDOWN = "agent asked to stop"
    # bus and ground
    BUS_LOST = "bus lost"
    BUS_LOST_LONG = "bus lost for long"
    GROUND_LOST = "ground station lost"
    ORDER_OVERDUE = "order overdue"
    # the others
    COLLISION_SUSPECTED = "collision suspected"
    SEPARATION_BREACHED = "separation breached"
    SEPARATION_PREDICTED = "separation will be lost"
    LAW_INFEASIBLE = "avoidance infeasible"
    NEIGHBOUR_UNSEEN = "neighbour silent and not seen"
    NEIGHBOUR_SILENT = "neighbour silent"
    NEIGHBOUR_INVALID = "neighbour without position"
    NEIGHBOUR_UNCOOPERATIVE = "neighbour does not do what it says"
    NEIGHBOUR_STALE = "neighbour's messages late"
    NEIGHBOUR_BACK = "neighbour heard again"
    CONFIG_DIFFERS = "neighbour with another fleet file"
    # energy and space
    BATTERY_WARNING = "battery low"
    BATTERY_LOW = "battery at the landing level"
    BATTERY_FALLING = "battery falling fast"
    FENCE_NEAR = "geofence near"
    FENCE_BREACH = "geofence crossed"
    FENCE_BREACH_LONG = "geofence crossed for long"
    CEILING = "above the ceiling"


class Action(IntEnum):
    """What is done, from the mildest to the strongest; the number is the rank."""

    GO_ON = 0  # counted and reported where it is worth a word
    REFUSE = 1  # no take-off while it lasts
    SLOW = 2  # the order goes on at reduced speed
    HOLD = 3  # stop here; the order has failed
    LEVEL = 4  # hold without eyes: level attitude at hover thrust while it lasts
    LAND = 5  # land by setpoint, under the avoidance law
    PX4_LAND = 6  # command PX4's landing, then silence
    DISARM = 7  # only ever on the ground
    STOP = 8  # silence on the wire


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
        # a landing by setpoint needs a position as much as a flight does; at lift-off there is nothing to wait for
        _C.POSITION_STALE: (_A.REFUSE, _A.GO_ON, _A.PX4_LAND, _A.LEVEL, _A.LEVEL, _A.GO_ON, _A.GO_ON),
        _C.POSITION_LOST: (_A.REFUSE, _A.DISARM, _A.PX4_LAND, _A.PX4_LAND, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        # the estimate flies on attitude and thrust without these samples, good for the 0.2 s until it counts as stale:
        # braking under the law meanwhile beats flying on and beats level coasting
        _C.POSITION_JUMPED: (_A.REFUSE, _A.GO_ON, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.MOCAP_SWAPPED: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.MOCAP_FROZEN: (_A.REFUSE, _A.GO_ON, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # the estimate takes the age out, but every metre per second costs more distance
        _C.MOCAP_LATE: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # who took it flies it; also away from PX4's landing, which is not asked for again then
        _C.LEFT_OFFBOARD: (_A.GO_ON, _A.DISARM, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        _C.PX4_FAILSAFE: (_A.GO_ON, _A.DISARM, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON, _A.GO_ON),
        # the kill switch was used: never arm it again by oneself; on the way down that is how landings end
        _C.DISARMED: (_A.GO_ON, _A.GO_ON, _A.STOP, _A.STOP, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # it has forgotten modes, parameters that were not saved, and where its local origin was
        _C.REBOOTED: (_A.REFUSE, _A.DISARM, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        _C.AUTOPILOT_SILENT: (_A.REFUSE, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        # setpoints sent to it now would be obeyed late, all at once
        _C.AUTOPILOT_FROZEN: (_A.REFUSE, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        # it flew on its last command meanwhile, and its clock, which times its own failsafe, did not notice
        _C.AUTOPILOT_BACK: (_A.GO_ON, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # attitude still comes, so it still flies what it is told; but nobody says any more whether it is ours
        _C.HEARTBEAT_LOST: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # our setpoints do not reach the motors: its own landing takes another way
        _C.ATTITUDE_NOT_FOLLOWED: (_A.GO_ON, _A.GO_ON, _A.PX4_LAND, _A.PX4_LAND, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        _C.THRUST_SATURATED: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.NOT_CLIMBING: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # after a collision or a failed motor: more thrust helps nobody, PX4's loss failsafe disarms
        _C.FALLEN: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.STOP, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.LOOP_LATE: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.LOOP_STALLED: (_A.GO_ON, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # PX4 has begun to land meanwhile: setpoints that come back would take the vehicle from it
        _C.LOOP_STALLED_LONG: (_A.GO_ON, _A.DISARM, _A.PX4_LAND, _A.PX4_LAND, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        # what a jump does to ages has rows of its own; the jump itself changes nothing in flight
        _C.CLOCK_JUMPED: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.NOT_FINITE: (_A.REFUSE, _A.GO_ON, _A.LAND, _A.LEVEL, _A.LEVEL, _A.GO_ON, _A.GO_ON),
        _C.NOT_FINITE_LONG: (_A.REFUSE, _A.DISARM, _A.PX4_LAND, _A.PX4_LAND, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        # no flight begins unrecorded; none ends for it
        _C.DISK_FULL: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # on the ground neither flies; who is in the air goes on, since the newcomer stays away
        _C.TWIN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.SHUTDOWN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BUS_LOST: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BUS_LOST_LONG: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # no emergency: the order is finished, then the vehicle stays
        _C.GROUND_LOST: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # a start has time limits of its own; a landing that does not come down is handed to PX4
        _C.ORDER_OVERDUE: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.HOLD, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        # down, but under the law: PX4's landing would not push away from whom it touched
        _C.COLLISION_SUSPECTED: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # the law is already pushing apart with all it has: stopping or landing would only take that away
        _C.SEPARATION_BREACHED: (_A.REFUSE, _A.DISARM, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.SEPARATION_PREDICTED: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # no goal is worth being pursued without avoidance
        _C.LAW_INFEASIBLE: (_A.GO_ON, _A.GO_ON, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # nobody knows where it is: who stands still is at least where the others expect it
        _C.NEIGHBOUR_UNSEEN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # avoided where mocap sees it, with full responsibility on our side
        _C.NEIGHBOUR_SILENT: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # as a silent one
        _C.NEIGHBOUR_INVALID: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # with full responsibility on our side, too, but what it does next is a guess
        _C.NEIGHBOUR_UNCOOPERATIVE: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.NEIGHBOUR_STALE: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # trusted again at once: its newest message says where it is
        _C.NEIGHBOUR_BACK: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # it cannot take off with another file either; in flight it is avoided as it says it moves
        _C.CONFIG_DIFFERS: (_A.REFUSE, _A.DISARM, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BATTERY_WARNING: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BATTERY_LOW: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # it would be empty before it is down if it waited for the landing level
        _C.BATTERY_FALLING: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.FENCE_NEAR: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.SLOW, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # the point to hold lies inside
        _C.FENCE_BREACH: (_A.REFUSE, _A.DISARM, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.FENCE_BREACH_LONG: (_A.REFUSE, _A.DISARM, _A.LAND, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.CEILING: (_A.GO_ON, _A.GO_ON, _A.LAND, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
    }.items()
    for situation, action in zip(Situation, row, strict=True)
}

_PLACES = {condition: place for place, condition in enumerate(Condition)}


def decide(situation: Situation, conditions: Collection[Condition]) -> tuple[Action, Condition | None]:
    """The strongest action of all conditions that hold, and the condition that asks for it.

    Of equal actions the condition named first speaks. Without conditions: GO_ON and None.
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
    """Whether what leaves now must be level, whatever else is done."""
    return any(TABLE[situation, condition] is Action.LEVEL for condition in conditions)


_KEPT = {Action.REFUSE: Action.GO_ON, Action.LEVEL: Action.HOLD}


def latched(before: Action, asked: Action) -> Action:
    """What is done after ``before`` when ``asked`` comes, without an order in between: never less.

    A level flight leaves a hold behind it, since its order has failed. A refusal is kept for nobody: it only forbids.
    """
    return max(_KEPT.get(before, before), asked)


def in_order(conditions: Iterable[Condition]) -> list[Condition]:
    """Conditions in the order of the table."""
    return sorted(conditions, key=_PLACES.__getitem__)


def table_text() -> str:
    """The table as Markdown, for the documentation."""
    lines = [
        "| condition | " + " | ".join(situation.value for situation in Situation) + " |",
        "|---" * (len(Situation) + 1) + "|",
    ]
    for condition in Condition:
        cells = (TABLE[situation, condition].name.lower().replace("_", " ") for situation in Situation)
        lines.append(f"| {condition.value} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
