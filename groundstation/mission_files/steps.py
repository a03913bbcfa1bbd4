"""The steps of a mission file and its reaction to a failure: keys, defaults and meanings.

A step that gives an order is an intent of `groundstation/orders/intents.py`: a new verb is a step
without a line here. This module adds the steps that no operator types: those that follow paths,
wait, hold other steps, judge, and break something.

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

    position_enu_m: Xyz  # of the formation: its offsets come on top


class _Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    do: str


class FlyFormationStep(_Step, frozen=True, kw_only=True):
    """A formation flies through points without a stop; it turns, stretches, changes on the way."""

    name: str  # of the formation at the begin, which all go to first
    position_enu_m: Xyz  # of the formation there, or of its leader
    to: tuple[FramePoint, ...]  # the points, see below
    rotation_deg: float = 0.0  # of the formation at the begin, counterclockwise
    spacing_m: float | None = None  # of its two nearest slots
    leader: str | None = None  # positions are this vehicle's, and the formation turns about it
    assign: Literal["ids", "nearest"] = "ids"  # as for formation
    at: str = ""  # start at this time of the world's clock: "21:30:00"; by default at once
    on_lag: OnLag = "land"  # what a vehicle does that falls behind for too long
    timeout_s: float | None = None  # by default as long as the way takes, and a minute


class FollowPathStep(_Step, frozen=True, kw_only=True):
    """Each vehicle goes to the begin of its path; then all follow theirs from one instant on."""

    paths: dict[str, str]  # vehicle -> file of its path, relative to the mission's
    lights: dict[str, str] = {}  # vehicle -> file of its colours, shown and recorded
    at: str = ""  # start at this time of the world's clock: "21:30:00"; by default at once
    on_lag: OnLag = "land"  # what a vehicle does that falls behind for too long
    timeout_s: float | None = None  # by default as long as the paths take, and a minute


class FaultStep(_Step, frozen=True, kw_only=True):
    """Inject a fault into the emulator, in simulated flights (`covey sitl --faults` lists them)."""

    vehicles: Names  # as above
    name: str  # of the fault: covey sitl --faults lists them
    parameters: dict[str, float | str] = {}  # of the fault
    after_s: float = 0.0  # until it begins
    duration_s: float = 0.0  # until it ends; 0: never


class Until(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A condition: all that is given must hold at once."""

    vehicles: Names | None = None  # that battery, failure and event are about; by default any
    reached: dict[str, Xyz] = {}  # these vehicles are at these positions
    within_m: float = 0.15  # so near
    separation_above_m: float | None = None  # no two that fly are nearer
    separation_below_m: float | None = None  # two are nearer
    battery_below_pct: float | None = None  # one of the vehicles has less
    landed: Names | None = None  # these are down and disarmed
    flying: Names | None = None  # these are in the air
    fails: bool = False  # one of the vehicles has failed, lands unordered, or is silent in flight
    event: str | None = None  # an event with this code has come; "*": any warning or worse


class WaitStep(_Step, frozen=True, kw_only=True):
    """Let time pass, or wait until a condition holds or for a time of the world's clock."""

    at: str = ""  # wait first until this time of the world's clock: "21:30:00"
    duration_s: float = 0.0  # of vehicle time
    until: Until | None = None  # the keys below
    timeout_s: float = 60.0  # the step fails when the condition does not hold within


class RepeatStep(_Step, frozen=True, kw_only=True):
    """Do steps several times."""

    times: int  # how often
    steps: tuple[Any, ...]  # [[step.steps]]


class ParallelStep(_Step, frozen=True, kw_only=True):
    """Do lists of steps side by side; it is done when all are, and fails when one does."""

    branches: tuple[Any, ...]  # lists of steps: [[{do = "move", ...}, {...}], [{do = "hold", ...}]]


class ReactStep(_Step, frozen=True, kw_only=True):
    """Do steps; once a condition holds, do others instead of the rest; then the mission goes on."""

    when: Until  # the condition, the keys below
    steps: tuple[Any, ...]  # [[step.steps]]
    then: tuple[Any, ...]  # steps once it holds: [[step.then]]


class ExpectStep(Expect, frozen=True, kw_only=True):
    """Judge now; the mission goes on only if all expectations are met."""

    do: str


class OnFailure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reaction to a step that fails."""

    # what all vehicles do when a step fails: land, hold, or go home. "go_on": only those that
    # failed land, by themselves or with the mission's end; the others go on as long as there is one
    do: Literal["land", "hold", "home", "go_on"] = "land"


BLOCK_KEYS = ("steps", "then", "branches")  # of steps that hold others
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
}


def file_keys(kind: type[MissionStep]) -> tuple[str, ...]:
    """Return the keys that a step of a file may have, besides `do`."""
    planned_fields = getattr(kind, "planned_fields", ())
    return tuple(
        name for name in kind.__struct_fields__ if name != "do" and name not in planned_fields
    )
