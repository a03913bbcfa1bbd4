"""PX4's arming checks as a table: conditions, and the sentence when a condition is not met."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.px4.battery import ChargeState
from sitl.px4.modes import ModeCondition

BOOT_S = 4.4  # time from the start of a PX4 until it can be armed


@dataclass(frozen=True, slots=True)
class Readiness:
    """Inputs of the checks."""

    since_boot_s: float  # time since the start of the autopilot
    needs: ModeCondition  # conditions of the mode in which to arm
    missing: ModeCondition  # conditions that are not met now
    battery: ChargeState  # charge of the battery
    needs_ground: bool  # whether a ground station has to be connected
    has_ground: bool  # whether a ground station is connected
    has_attitude: bool  # whether the attitude is controlled
    faults: tuple[str, ...]  # further reasons, as sentences


@dataclass(frozen=True, slots=True)
class ArmingCheck:
    """One row of the table: a sentence, and whether the check fails."""

    sentence: str
    fails: Callable[[Readiness], bool]


ARMING_CHECKS: tuple[ArmingCheck, ...] = (
    ArmingCheck("system is still starting", lambda r: r.since_boot_s < BOOT_S),
    ArmingCheck("no offboard setpoints", lambda r: ModeCondition.SETPOINTS in r.missing),
    ArmingCheck("no local position", lambda r: ModeCondition.LOCAL_POSITION in r.missing),
    ArmingCheck(
        "no global position for this mode", lambda r: ModeCondition.GLOBAL_POSITION in r.missing
    ),
    ArmingCheck("no manual control input", lambda r: ModeCondition.STICKS in r.missing),
    ArmingCheck("no mission", lambda r: ModeCondition.MISSION in r.missing),
    ArmingCheck("this mode cannot be armed in", lambda r: ModeCondition.ARMING in r.needs),
    ArmingCheck("battery too low", lambda r: r.battery.value >= ChargeState.CRITICAL.value),
    ArmingCheck("the attitude control has failed", lambda r: not r.has_attitude),
    ArmingCheck(
        "no connection to the ground station", lambda r: r.needs_ground and not r.has_ground
    ),
)


def obstacles(readiness: Readiness) -> list[str]:
    """Return the reasons against arming now; empty when there are none."""
    sentences = [check.sentence for check in ARMING_CHECKS if check.fails(readiness)]
    return sentences + list(readiness.faults)
