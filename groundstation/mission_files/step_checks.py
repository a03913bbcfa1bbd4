"""Checks the steps of a mission with its fleet, so that no mission starts that must fail later.

Every order is checked as if it were given at its place in the expected course. After a fault it is
not known which vehicles fly, so the later steps are checked against the fleet file only. After a
react, an order is refused only if its vehicles can carry it out neither with the reaction nor
without it. Nor is one refused to vehicles that another branch takes off or lands, or that have
landed by a condition of the mission.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence

from groundstation.fleet.slot_owners import by_slot_owner
from groundstation.mission_files.expected_course import (
    CourseStep,
    refuse_disabled,
    shared_vehicles,
)
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.steps import (
    FaultStep,
    FlyFormationStep,
    FollowPathStep,
    Until,
)
from groundstation.orders.intents import Intent
from onboard.config.fleet import ConfigError, FleetConfig


def check_steps(mission: Mission) -> None:
    """Refuse a mission with a step that its fleet cannot do.

    Raises:
        ConfigError: a step is not possible, for instance because of an unknown vehicle, a goal
            outside the fence, or a take-off of a vehicle that flies.
    """
    course_steps = []
    for course_step in mission.course():
        _check_course_step(course_step, mission)
        course_steps.append(course_step)

    for shared in shared_vehicles(course_steps):
        if shared.at_once:
            raise ConfigError(
                f"{mission.path}: '{shared.block}' (parallel): several branches begin with an order"
                f" to {', '.join(shared.at_once)}. One of these orders ends the other, and the "
                "mission. Write them one after the other in one branch."
            )

    for key, condition in mission.conditions():
        _check_until(condition, mission.fleet, f"{mission.path}: '{key}'")


def _check_course_step(course_step: CourseStep, mission: Mission) -> None:
    fleet = mission.fleet
    step = course_step.step
    path = mission.path
    key = course_step.key

    may_fly: Collection[str] = fleet.enabled_names
    if course_step.is_known:
        may_fly = course_step.may_fly_before

    if isinstance(step, FaultStep):
        _check_fault(step, fleet, path, key)
    elif isinstance(step, FollowPathStep):
        mission.lights_of(step)  # raises ConfigError for a file that cannot be read
        _check_lights(step, f"{path}: '{key}.lights'")
        _check_paths((*step.paths, *step.lights), fleet, may_fly, f"{path}: '{key}.paths'")
    elif isinstance(step, FlyFormationStep):
        _check_paths(tuple(course_step.paths), fleet, may_fly, f"{path}: '{key}.name'")

    if course_step.planned is None:
        return
    reason = next(iter(course_step.planned.refusals.values()), "")
    if not reason and course_step.is_known:
        reason = _flying_problem(course_step, course_step.planned.intent.names)
    if reason:
        raise ConfigError(f"{path}: '{key}' ({step.do}): {reason}")


def _flying_problem(course_step: CourseStep, names: Sequence[str]) -> str:
    """Return a sentence if vehicles are in the air or on the ground when they must not be."""
    step = course_step.step
    if not isinstance(step, Intent):
        return ""

    on_ground = ", ".join(name for name in names if name not in course_step.may_fly_before)
    if step.begins == "in air" and on_ground:
        return (
            f'{on_ground} would be on the ground at this step. Put a step do = "takeoff" before it.'
        )

    must_fly = course_step.flying - course_step.doubtful
    in_air = ", ".join(name for name in names if name in must_fly)
    if step.begins == "on ground" and in_air:
        return (
            f"{in_air} would fly already at this step. "
            'Put a step do = "land" before it, or remove it.'
        )
    return ""


def _check_paths(
    names: Sequence[str], fleet: FleetConfig, flying: Collection[str], written_key: str
) -> None:
    """Refuse paths of vehicles that do not fly; mission_findings.py checks the paths themselves."""
    wrong = [name for name in names if name not in fleet.enabled_names or name not in flying]
    if wrong or not names:
        raise ConfigError(
            f"{written_key} must name vehicles that fly at this step, each with a file; "
            f"it has {', '.join(wrong) or 'none'}."
        )


def _check_lights(step: FollowPathStep, written_key: str) -> None:
    """Refuse lights of vehicles without a path, whose time the lights follow."""
    wrong = [name for name in step.lights if name not in step.paths]
    if wrong:
        raise ConfigError(
            f"{written_key} has {', '.join(wrong)}, without a path in 'paths'. Lights go by the "
            "time on the path: name a path as well, or leave the lights out."
        )


def _check_until(until: Until, fleet: FleetConfig, written_key: str) -> None:
    """Refuse a condition about vehicles that do not fly, and one that no number can meet."""
    try:
        for vehicles in (until.vehicles, until.landed, until.flying):
            refuse_disabled(fleet.select(vehicles), fleet)
        refuse_disabled(by_slot_owner(until.reached.items(), fleet, "position"), fleet)
    except ConfigError as error:
        raise ConfigError(f"{written_key}: {error}") from None

    # a number that is not given counts as 0, which is finite
    numbers = {
        "within_m": (until.within_m,),
        "separation_above_m": (until.separation_above_m or 0.0,),
        "separation_below_m": (until.separation_below_m or 0.0,),
        "battery_below_pct": (until.battery_below_pct or 0.0,),
        "reached": tuple(itertools.chain.from_iterable(until.reached.values())),
    }
    for name, values in numbers.items():
        if not all(math.isfinite(value) for value in values):
            raise ConfigError(f"{written_key}: '{name}' is not a finite number. Correct the value.")


def _check_fault(step: FaultStep, fleet: FleetConfig, path: str, key: str) -> None:
    """Refuse a fault with misplaced keys or unknown vehicles.

    The emulator checks its name and parameters before the mission's first step.
    """
    misplaced = set(step.parameters) & set(FaultStep.__struct_fields__)
    if misplaced:
        raise ConfigError(
            f"{path}: '{key}.parameters' has '{min(misplaced)}', which is a key of the step. Move"
            " it up."
        )

    try:
        fleet.select(step.vehicles)
    except ConfigError as error:
        raise ConfigError(f"{path}: '{key}.vehicles': {error}") from None
