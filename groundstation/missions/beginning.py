"""Checks whether a mission can begin now, with the fleet in its present state. Pure.

A mission that begins with a take-off is refused while its vehicles fly. A mission is also refused
when it cannot reach a step before the wall-clock time at which that step starts. Both
are refused before the mission gives its first order.
"""

from __future__ import annotations

import datetime
from collections.abc import Collection, Iterator, Mapping, Sequence

from msgspec import structs

from groundstation.fleet.slot_owners import unused_slot_owners
from groundstation.fleet.state import FleetState
from groundstation.mission_files.expected_course import CourseStep, expected_duration_s, resolved
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.steps import (
    FlyFormationStep,
    FollowPathStep,
    MissionStep,
    ParallelStep,
    ReactStep,
    RepeatStep,
)
from groundstation.mission_files.wall_time import WallTime, time_words, wall_time
from groundstation.orders.intents import Intent
from onboard.config.fleet import ConfigError, FleetConfig


def begin_refusal(mission: Mission, state: FleetState) -> str:
    """Return why a mission cannot begin now; empty when it can.

    Only the first order of each vehicle is judged. The steps of a Python mission are not known
    before it flies.

    Args:
        mission: mission file, loaded and checked.
        state: the fleet as known now.
    """
    have_order: set[str] = set()  # vehicles whose first order has been judged
    for step in _in_order(mission.steps):
        if not isinstance(step, Intent):
            continue
        names = [name for name in resolved(step, mission.fleet).names if name not in have_order]
        have_order.update(names)

        flying = [name for name in names if state.vehicles[name].is_airborne]
        if step.begins == "on ground" and flying:
            fly = "flies" if len(flying) == 1 else "fly"
            return (
                f"{mission.path} was not begun: its first order to {', '.join(flying)}, {step.do}, "
                f"begins on the ground, and {', '.join(flying)} {fly}. Land first, or start a "
                "mission that begins in the air."
            )
    return ""


def without_unused_slots(mission: Mission, state: FleetState) -> Mission:
    """Return the mission with the fleet that takes part in it now.

    The slots of a vehicle are unused while it is out of service and no spare replaces it. Then
    "all" leaves it out, and the checks of the mission ignore it. A vehicle that a step names itself
    stays.

    Args:
        mission: mission file, loaded and checked.
        state: the fleet as known now.
    """
    fleet = _without(mission.fleet, unused_slot_owners(state))
    named: set[str] = set()
    for step in _in_order(mission.steps):
        if isinstance(step, FollowPathStep):
            named.update(step.paths)
        elif isinstance(step, Intent):
            named.update(resolved(step, fleet).names)

    fleet = _without(mission.fleet, unused_slot_owners(state) - named)
    if not fleet.enabled_names:
        return mission
    return structs.replace(mission, fleet=fleet)


def _without(fleet: FleetConfig, disabled: Collection[str]) -> FleetConfig:
    """Return the fleet file with these vehicles disabled."""
    vehicles = dict(fleet.vehicles)
    for name in disabled:
        vehicles[name] = structs.replace(vehicles[name], enabled=False)
    return structs.replace(fleet, vehicles=vehicles)


def step_times(mission: Mission, now: datetime.datetime) -> dict[str, WallTime]:
    """Return the wall-clock times in a mission; the keys are the times as written.

    Args:
        mission: mission file, loaded and checked.
        now: the wall clock, with its time zone.

    Raises:
        ConfigError: a time is in the past, or too far ahead.
    """
    times = {}
    for step in _in_order(mission.steps):
        written = getattr(step, "at", "")
        if not written:
            continue
        try:
            times[written] = wall_time(written, now)
        except ConfigError as error:
            raise ConfigError(f"{mission.path}: {step.do} at {written}: {error}") from None
    return times


def time_refusal(mission: Mission, times: Mapping[str, WallTime], begin_ns: int) -> str:
    """Return why a mission reaches a timed step too late; empty when it reaches all in time.

    Steps that are flown side by side are not judged.

    Args:
        mission: mission file, loaded and checked.
        times: result of :func:`step_times`.
        begin_ns: start of the mission, by the wall clock [ns].
    """
    timed_until_s = 0.0  # time from the mission's start to the end of the latest timed step
    since: list[CourseStep] = []  # steps after that one
    for course_step in mission.course():
        step = course_step.step

        # Vehicles first fly to the first points of their paths. The step's wall-clock time is
        # the start of the paths themselves.
        paths_s = 0.0
        if isinstance(step, FollowPathStep | FlyFormationStep):
            paths_s = max((path.duration_s for path in course_step.paths.values()), default=0.0)

        written = getattr(step, "at", "")
        is_side_by_side = bool(course_step.branches)
        if written and not is_side_by_side:
            start_s = (times[written].wall_ns - begin_ns) * 1e-9
            reached_s = timed_until_s + expected_duration_s(since)
            earliest_start_s = reached_s + course_step.expected_s - paths_s
            if start_s < earliest_start_s:
                return (
                    f"{mission.path} was not begun: '{course_step.key}' ({step.do}) is to start at "
                    f"{times[written].words}, {time_words(max(0.0, start_s))} after the mission "
                    f"begins, and what comes before it takes about {time_words(earliest_start_s)}. "
                    "Give it a later time, or begin earlier."
                )
            timed_until_s = start_s + paths_s
            since = []
        else:
            since.append(course_step)
    return ""


def _in_order(steps: Sequence[MissionStep]) -> Iterator[MissionStep]:
    """Yield all steps and the steps inside them, in the order in which they may be flown."""
    for step in steps:
        yield step
        if isinstance(step, ParallelStep):
            for branch in step.branches:
                yield from _in_order(branch)
        elif isinstance(step, RepeatStep | ReactStep):
            yield from _in_order(step.steps)
