"""The failsafe table: what a vehicle does when something is wrong, decided for every pair before anything happens.

Pure data: (situation, condition) -> action. The agent acts on the strongest action of all conditions that hold.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum, IntEnum


class Situation(Enum):
    """What the vehicle is doing, as far as failsafes care."""

    GROUND = "on the ground, disarmed"
    ARMED = "armed on the ground"
    FLYING = "flying"
    LANDING = "landing by setpoint"
    PX4_LANDING = "landing by PX4"
    SILENT = "given up, no setpoints"


class Condition(Enum):
    """What can be wrong."""

    POSITION_STALE = "own position stale"
    POSITION_LOST = "own position lost"
    LEFT_OFFBOARD = "PX4 left OFFBOARD"
    AUTOPILOT_SILENT = "PX4 silent"
    LOOP_LATE = "loop late"
    LOOP_STALLED = "loop stalled"
    LOOP_STALLED_LONG = "loop stalled for long"
    BUS_LOST = "bus lost"
    BUS_LOST_LONG = "bus lost for long"
    GROUND_LOST = "ground station lost"
    BATTERY_WARNING = "battery low"
    BATTERY_LOW = "battery at the landing level"
    FENCE_BREACH = "geofence crossed"
    FENCE_BREACH_LONG = "geofence crossed for long"
    NOT_FINITE = "tick not finite"
    NOT_FINITE_LONG = "ticks not finite for long"
    SEPARATION_BREACHED = "separation breached"
    NEIGHBOUR_SILENT = "neighbour silent"
    FALLEN = "on the ground though it should fly"
    SHUTDOWN = "agent asked to stop"


class Action(IntEnum):
    """What is done, from the mildest to the strongest; the number is the rank."""

    GO_ON = 0  # counted and reported where it is worth a word
    REFUSE = 1  # no take-off while it lasts
    HOLD = 2  # stop here
    LAND = 3  # land by setpoint, under the avoidance law
    LEVEL = 4  # level attitude at hover thrust
    PX4_LAND = 5  # command PX4's landing, then silence
    DISARM = 6  # only ever on the ground
    STOP = 7  # silence on the wire


WORDS: dict[Action, str] = {
    Action.GO_ON: "going on",
    Action.REFUSE: "no take-off",
    Action.HOLD: "holding",
    Action.LAND: "landing",
    Action.LEVEL: "level at hover thrust",
    Action.PX4_LAND: "PX4 lands",
    Action.DISARM: "disarming",
    Action.STOP: "no more setpoints are sent",
}

_C, _A = Condition, Action

TABLE: dict[tuple[Situation, Condition], Action] = {
    (situation, condition): action
    for condition, row in {
        # condition: GROUND, ARMED, FLYING, LANDING, PX4_LANDING, SILENT
        _C.POSITION_STALE: (_A.REFUSE, _A.GO_ON, _A.LEVEL, _A.LEVEL, _A.GO_ON, _A.GO_ON),
        _C.POSITION_LOST: (_A.REFUSE, _A.DISARM, _A.PX4_LAND, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        _C.LEFT_OFFBOARD: (_A.GO_ON, _A.DISARM, _A.STOP, _A.STOP, _A.GO_ON, _A.GO_ON),
        _C.AUTOPILOT_SILENT: (_A.REFUSE, _A.STOP, _A.STOP, _A.STOP, _A.STOP, _A.GO_ON),
        _C.LOOP_LATE: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.LOOP_STALLED: (_A.GO_ON, _A.DISARM, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # PX4 has begun to land meanwhile: setpoints that come back would take the vehicle from it
        _C.LOOP_STALLED_LONG: (_A.GO_ON, _A.DISARM, _A.PX4_LAND, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        _C.BUS_LOST: (_A.REFUSE, _A.DISARM, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BUS_LOST_LONG: (_A.REFUSE, _A.DISARM, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.GROUND_LOST: (_A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BATTERY_WARNING: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.BATTERY_LOW: (_A.REFUSE, _A.DISARM, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.FENCE_BREACH: (_A.REFUSE, _A.DISARM, _A.HOLD, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.FENCE_BREACH_LONG: (_A.REFUSE, _A.DISARM, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.NOT_FINITE: (_A.REFUSE, _A.GO_ON, _A.LEVEL, _A.LEVEL, _A.GO_ON, _A.GO_ON),
        _C.NOT_FINITE_LONG: (_A.REFUSE, _A.DISARM, _A.PX4_LAND, _A.PX4_LAND, _A.GO_ON, _A.GO_ON),
        # the law is already pushing apart with all it has: stopping or landing would only take that away
        _C.SEPARATION_BREACHED: (_A.REFUSE, _A.DISARM, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # avoided at its last extrapolated position with full responsibility on our side
        _C.NEIGHBOUR_SILENT: (_A.REFUSE, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        # after a collision or a failed motor: more thrust helps nobody, PX4's loss failsafe disarms
        _C.FALLEN: (_A.GO_ON, _A.GO_ON, _A.STOP, _A.GO_ON, _A.GO_ON, _A.GO_ON),
        _C.SHUTDOWN: (_A.REFUSE, _A.DISARM, _A.LAND, _A.GO_ON, _A.GO_ON, _A.GO_ON),
    }.items()
    for situation, action in zip(Situation, row, strict=True)
}

_PLACES = {condition: place for place, condition in enumerate(Condition)}


def decide(situation: Situation, conditions: Iterable[Condition]) -> tuple[Action, Condition | None]:
    """The strongest action of all conditions that hold, and the condition that asks for it.

    Of equal actions the condition named first in the table speaks. Without conditions: GO_ON and None.
    """
    best: tuple[Action, Condition | None] = (Action.GO_ON, None)
    for condition in in_order(conditions):
        action = TABLE[situation, condition]
        if best[1] is None or action > best[0]:
            best = action, condition
    return best


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
