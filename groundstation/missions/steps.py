"""The steps of a mission file, its expectations, and its reaction to a failure: keys, defaults and meanings."""

from __future__ import annotations

from typing import Literal

import msgspec

from groundstation.orders.path_orders import OnLag
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


class MoveStep(_OrderStep, frozen=True, kw_only=True):
    """One vehicle: its own goal. Several: the position of the formation that holds."""

    position_enu_m: Vec3  # east, north, up in the fleet frame
    duration_s: float = 0.0  # slower than the limits allow; 0: as fast as they allow


class FormationStep(_OrderStep, frozen=True, kw_only=True):
    """Take up a formation at a position."""

    name: str  # a table [formations.NAME] of the fleet file
    position_enu_m: Vec3  # of the formation: its offsets come on top
    duration_s: float = 0.0  # as for move


class FollowPathStep(_Step, frozen=True, kw_only=True):
    """Each vehicle follows its own path, all from one instant on; they go to the begins of their paths first."""

    paths: dict[str, str]  # vehicle -> file of its path, relative to the mission's
    lights: dict[str, str] = {}  # vehicle -> file of its colours, shown and recorded
    on_lag: OnLag = "land"  # what a vehicle does that falls behind for too long
    timeout_s: float | None = None  # None: as long as the paths take, and a minute


class HoldStep(_OrderStep, frozen=True, kw_only=True):
    """Stop at the present spot."""

    timeout_s: float = 15.0


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


class WaitStep(_Step, frozen=True, kw_only=True):
    """Let time pass."""

    duration_s: float  # of vehicle time


class Expect(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Expectations. As a step: about the flight so far. As ``[expect]``: about the whole mission."""

    min_separation_m: float | None = None  # no two centres came nearer
    arrived_within_m: float | None = None  # each vehicle was so near to its goal when its order was done
    all_landed: bool | None = None  # everybody is down and disarmed; false: it is right that they are not


class ExpectStep(Expect, frozen=True, kw_only=True):
    """Judge now; the mission goes on only if all expectations are met."""

    do: str


class OnFailure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reaction to a step that fails: all vehicles land, or all hold."""

    do: Literal["land", "hold"] = "land"  # what all vehicles do when a step fails


OrderStep = ArmStep | TakeoffStep | MoveStep | FormationStep | HoldStep | LandStep | DisarmStep
Step = OrderStep | FollowPathStep | WaitStep | ExpectStep | FaultStep
STEPS: dict[str, type[Step]] = {
    "arm": ArmStep,
    "takeoff": TakeoffStep,
    "move": MoveStep,
    "formation": FormationStep,
    "follow_path": FollowPathStep,
    "hold": HoldStep,
    "wait": WaitStep,
    "land": LandStep,
    "disarm": DisarmStep,
    "expect": ExpectStep,
    "fault": FaultStep,
}


STEP_BOUNDS = {"timeout_s": (0.1, 3600.0), "duration_s": (0.0, 3600.0), "after_s": (0.0, 3600.0)}
EXPECT_MOST_M = {"min_separation_m": 100.0, "arrived_within_m": 10.0}
