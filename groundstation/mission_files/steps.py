"""The steps of a mission file and its reaction to a failure: keys, defaults and meanings.

A step that gives an order is an intent of `groundstation/orders/intents.py`, so a new verb becomes
a step without changing this module. This module adds the steps that no operator types: they follow
paths, wait, contain other steps, check expectations, or inject faults.

docs/mission-file.md is printed from these classes and from the comments beside their fields.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from groundstation.formations.frame import FramePoint
from groundstation.orders.intents import INTENTS, Formation, Intent, Names
from groundstation.orders.path_orders import OnLag
from groundstation.verdict.expectations import Expect
from onboard.tuples import Xyz


class FormationStep(Formation, frozen=True, kw_only=True):
    """Take up a formation at a position."""

    position_enu_m: Xyz  # position of the formation, to which each vehicle's offset is added


class _Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A step that is not an order; `do` is its kind."""

    do: str


class FlyFormationStep(_Step, frozen=True, kw_only=True):
    """A formation flies through points without a stop; it turns, stretches, changes on the way."""

    name: str  # formation at the start, which the vehicles take up first
    position_enu_m: Xyz  # position of this formation, or of its leader
    to: tuple[FramePoint, ...]  # the points, see below
    rotation_deg: float = 0.0  # rotation of the formation at the start, counterclockwise
    spacing_m: float | None = None  # distance of its two nearest slots
    # vehicle whose position is the formation's, and about which it turns
    leader: str | None = None
    assign: Literal["ids", "nearest"] = "ids"  # as for formation
    at: str = ""  # wall-clock time at which it starts: "21:30:00"; by default at once
    on_lag: OnLag = "land"  # reaction of a vehicle that falls behind for too long
    timeout_s: float | None = None  # by default twice the duration of the way plus a minute


class FollowPathStep(_Step, frozen=True, kw_only=True):
    """Each vehicle flies to the start of its path; then all follow their paths from one instant on.

    A mission names one file of a path for each vehicle.
    """

    paths: dict[str, str]  # vehicle -> file of its path, relative to the mission file
    lights: dict[str, str] = {}  # vehicle -> file of its colours, which are shown and recorded
    at: str = ""  # wall-clock time at which they start: "21:30:00"; by default at once
    on_lag: OnLag = "land"  # reaction of a vehicle that falls behind for too long
    timeout_s: float | None = None  # by default twice the duration of the paths plus a minute


class FaultStep(_Step, frozen=True, kw_only=True):
    """Inject a fault into the emulator, in simulated flights (`covey sitl --faults` lists them)."""

    vehicles: Names  # vehicles that get the fault
    name: str  # name of the fault: covey sitl --faults lists them
    parameters: dict[str, float | str] = {}  # parameters of the fault
    after_s: float = 0.0  # time until it begins
    duration_s: float = 0.0  # duration of the fault; 0: it does not end


class Until(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A condition; all keys that are given must hold at once."""

    # vehicles that battery_below_pct, fails and event are about; by default any
    vehicles: Names | None = None
    reached: dict[str, Xyz] = {}  # these vehicles are at these positions
    within_m: float = 0.15  # distance from the positions that counts as reached
    separation_above_m: float | None = None  # no two flying vehicles are nearer than this
    separation_below_m: float | None = None  # two vehicles are nearer than this
    battery_below_pct: float | None = None  # one of the vehicles has less charge than this
    landed: Names | None = None  # these vehicles are down and disarmed; "all": all that take part
    flying: Names | None = None  # these vehicles are in the air; "all": all that take part
    fails: bool = False  # one of the vehicles has failed, lands unordered, or is silent in flight
    # an event with this code has come, as in events.txt of a record; "*": any warning or worse
    event: str | None = None


class WaitStep(_Step, frozen=True, kw_only=True):
    """Let time pass, or wait until a condition holds or for a wall-clock time."""

    at: str = ""  # wall-clock time until which it waits first: "21:30:00"
    duration_s: float = 0.0  # time to wait, in vehicle time
    until: Until | None = None  # condition, with the keys below
    timeout_s: float = 60.0  # the step fails if it does not hold in this time; pauses do not count


class RepeatStep(_Step, frozen=True, kw_only=True):
    """Do steps several times."""

    times: int  # number of times
    steps: tuple[Any, ...]  # [[step.steps]]


class ParallelStep(_Step, frozen=True, kw_only=True):
    """Do lists of steps side by side; the step is done when all are, and fails when one fails."""

    branches: tuple[Any, ...]  # lists of steps: [[{do = "move", ...}, {...}], [{do = "hold", ...}]]


class ReactStep(_Step, frozen=True, kw_only=True):
    """Do steps; when a condition holds, do others instead of the rest; then the mission goes on."""

    when: Until  # condition, with the keys below
    steps: tuple[Any, ...]  # [[step.steps]]
    then: tuple[Any, ...]  # steps when the condition holds: [[step.then]]


class ExpectStep(Expect, frozen=True, kw_only=True):
    """Check expectations about the flight so far; the mission goes on only if all are met."""

    do: str


class OnFailure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reaction to a step that fails."""

    # what all vehicles do when a step fails: land, hold, or go home. "go_on": only the failed ones
    # land, by themselves or at the mission's end; the others go on while at least one is left
    do: Literal["land", "hold", "home", "go_on"] = "land"


BLOCK_KEYS = ("steps", "then", "branches")  # keys that contain other steps
BlockStep = RepeatStep | ParallelStep | ReactStep
MissionStep = (
    Intent | FollowPathStep | FlyFormationStep | WaitStep | ExpectStep | FaultStep | BlockStep
)

ORDER_STEPS: dict[str, type[MissionStep]] = {
    verb: intent for verb, intent in INTENTS.items() if intent.is_mission_step
}
STEPS: dict[str, type[MissionStep]] = {
    **ORDER_STEPS,
    "formation": FormationStep,
    "fly_formation": FlyFormationStep,
    "follow_path": FollowPathStep,
    "wait": WaitStep,
    "repeat": RepeatStep,
    "parallel": ParallelStep,
    "react": ReactStep,
    "expect": ExpectStep,
    "fault": FaultStep,
}

STEP_BOUNDS = {
    "timeout_s": (0.1, 3600.0),
    "duration_s": (0.0, 3600.0),
    "after_s": (0.0, 3600.0),
    "speed_m_s": (0.01, 50.0),
    "spacing_m": (0.05, 1000.0),
    "rotation_deg": (-3600.0, 3600.0),
    "angle_deg": (-3600.0, 3600.0),
    "yaw_deg": (-360.0, 360.0),
    "times": (1, 100),
    "by": (0, 1000),
    "every_s": (0.0, 600.0),
    # of conditions
    "within_m": (0.01, 100.0),
    "separation_above_m": (0.01, 1000.0),
    "separation_below_m": (0.01, 1000.0),
    "battery_below_pct": (0.1, 100.0),
}


def file_keys(kind: type[MissionStep]) -> tuple[str, ...]:
    """Return the keys that a step in a file may have, besides `do`."""
    planned_fields = getattr(kind, "planned_fields", ())
    return tuple(
        name for name in kind.__struct_fields__ if name != "do" and name not in planned_fields
    )
