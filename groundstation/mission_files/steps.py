"""The steps of a mission file, its expectations, and its reaction to a failure: keys, defaults and
meanings.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from groundstation.formations.frame import FramePoint
from groundstation.orders.path_orders import OnLag
from groundstation.verdict.expectations import Expect
from onboard.config.fleet import Vec3

Names = str | list[str]


class _Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    do: str


class _OrderStep(_Step, frozen=True, kw_only=True):
    vehicles: Names = "all"  # "all", a name, "0-2", "a,b" or a list
    timeout_s: float = 40.0  # the step fails when it is not done within


class ArmStep(_OrderStep, frozen=True, kw_only=True):
    """Arm on the ground."""

    timeout_s: float = 15.0


class TakeoffStep(_OrderStep, frozen=True, kw_only=True):
    """Climb to a height above the fleet's origin."""

    height_m: float = 1.0  # above the fleet's origin


class _GoalStep(_OrderStep, frozen=True, kw_only=True):
    duration_s: float = 0.0  # slower than the limits allow; 0: as fast as they allow
    speed_m_s: float | None = None  # instead of a duration: the most of whoever has the longest way
    # heading to turn to, counterclockwise from east; by default as it is
    yaw_deg: float | None = None


class MoveStep(_GoalStep, frozen=True, kw_only=True):
    """One vehicle: its own goal. Several: the position of the formation that holds."""

    position_enu_m: Vec3  # east, north, up in the fleet frame


class GotoStep(_GoalStep, frozen=True, kw_only=True):
    """Each vehicle to its own goal, judged together: they may change places."""

    goals: dict[str, Vec3]  # vehicle -> east, north, up in the fleet frame


class FormationStep(_GoalStep, frozen=True, kw_only=True):
    """Take up a formation at a position."""

    name: str  # a table [formations.NAME] of the mission or of the fleet file
    position_enu_m: Vec3  # of the formation: its offsets come on top
    spacing_m: float | None = None  # stretches it until its two nearest slots are so far apart
    rotation_deg: float = 0.0  # turns it, counterclockwise
    # each its own slot; nearest: such that the longest flight is short
    assign: Literal["ids", "nearest"] = "ids"


class RotateStep(_OrderStep, frozen=True, kw_only=True):
    """Turn the formation that holds about its position, each vehicle straight to its new slot."""

    angle_deg: float  # counterclockwise, from how it is turned now
    duration_s: float = 0.0  # as for move


class YawStep(_OrderStep, frozen=True, kw_only=True):
    """Turn to a heading on the spot."""

    yaw_deg: float  # counterclockwise from east
    timeout_s: float = 15.0


class FlyFormationStep(_Step, frozen=True, kw_only=True):
    """A formation flies through points without stopping, turns, stretches and becomes another one
    on the way.
    """

    name: str  # of the formation at the begin, which all go to first
    position_enu_m: Vec3  # of the formation there, or of its leader
    to: tuple[FramePoint, ...]  # the points, see below
    rotation_deg: float = 0.0  # of the formation at the begin, counterclockwise
    spacing_m: float | None = None  # of its two nearest slots
    leader: str | None = None  # positions are this vehicle's, and the formation turns about it
    assign: Literal["ids", "nearest"] = "ids"  # as for formation
    on_lag: OnLag = "land"  # what a vehicle does that falls behind for too long
    timeout_s: float | None = None  # by default as long as the way takes, and a minute


class FollowPathStep(_Step, frozen=True, kw_only=True):
    """Each vehicle follows its own path, all from one instant on; they go to the begins of their
    paths first.
    """

    paths: dict[str, str]  # vehicle -> file of its path, relative to the mission's
    lights: dict[str, str] = {}  # vehicle -> file of its colours, shown and recorded
    on_lag: OnLag = "land"  # what a vehicle does that falls behind for too long
    timeout_s: float | None = None  # None: as long as the paths take, and a minute


class HoldStep(_OrderStep, frozen=True, kw_only=True):
    """Stop at the present spot."""

    timeout_s: float = 15.0


class HomeStep(_OrderStep, frozen=True, kw_only=True):
    """Back over the take-off spots of the fleet file, and land there."""

    height_m: float | None = None  # of the way back; by default each at its own
    duration_s: float = 0.0  # of the way back, as for move
    timeout_s: float = 90.0


class LandStep(_OrderStep, frozen=True, kw_only=True):
    """Land and disarm."""


class DisarmStep(_OrderStep, frozen=True, kw_only=True):
    """Disarm on the ground."""

    timeout_s: float = 15.0


class FaultStep(_Step, frozen=True, kw_only=True):
    """Inject a fault into the emulator; `covey sitl --faults` lists them. Simulated flights only."""

    vehicles: Names  # as above
    name: str  # of the fault: covey sitl --faults lists them
    parameters: dict[str, float | str] = {}  # of the fault
    after_s: float = 0.0  # until it begins
    duration_s: float = 0.0  # until it ends; 0: never


class Until(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A condition: all that is given must hold at once."""

    vehicles: Names | None = None  # whom battery, failure and event are about; by default anybody
    reached: dict[str, Vec3] = {}  # these vehicles are at these positions
    within_m: float = 0.15  # so near
    separation_above_m: float | None = None  # no two that fly are nearer
    separation_below_m: float | None = None  # two are nearer
    battery_below_pct: float | None = None  # one of the vehicles has less
    landed: Names | None = None  # these are down and disarmed
    flying: Names | None = None  # these are in the air
    fails: bool = False  # one of the vehicles has failed, lands unordered, or is silent in flight
    event: str | None = None  # an event with this code has come; "*": any warning or worse


class WaitStep(_Step, frozen=True, kw_only=True):
    """Let time pass, or wait until a condition holds."""

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
    """Do steps; as soon as a condition holds, leave the rest of them out and do others. Then the
    mission goes on.
    """

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


GoalStep = MoveStep | GotoStep | FormationStep
BLOCK_KEYS = "steps", "then", "branches"  # of steps that hold others
OrderStep = (
    ArmStep
    | TakeoffStep
    | GoalStep
    | RotateStep
    | YawStep
    | HoldStep
    | HomeStep
    | LandStep
    | DisarmStep
)
BlockStep = RepeatStep | ParallelStep | ReactStep
MissionStep = (
    OrderStep | FollowPathStep | FlyFormationStep | WaitStep | ExpectStep | FaultStep | BlockStep
)
STEPS: dict[str, type[MissionStep]] = {
    "arm": ArmStep,
    "takeoff": TakeoffStep,
    "move": MoveStep,
    "goto": GotoStep,
    "formation": FormationStep,
    "fly_formation": FlyFormationStep,
    "rotate": RotateStep,
    "yaw": YawStep,
    "follow_path": FollowPathStep,
    "hold": HoldStep,
    "wait": WaitStep,
    "repeat": RepeatStep,
    "parallel": ParallelStep,
    "react": ReactStep,
    "home": HomeStep,
    "land": LandStep,
    "disarm": DisarmStep,
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
}
