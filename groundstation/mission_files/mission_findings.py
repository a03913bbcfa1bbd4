"""Findings about a mission before it flies: spacing, time limits, batteries, expectations. Pure.

``covey check`` shows them, and a flight refuses a mission with a finding that the law cannot fly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

from msgspec import structs

from groundstation.formations.slots import formation_slots
from groundstation.mission_files.expected_course import (
    CourseStep,
    expected_flight_s,
    first_points,
    shared_vehicles,
)
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.steps import (
    ExpectStep,
    FlyFormationStep,
    FollowPathStep,
    Until,
)
from groundstation.orders.intents import GoalIntent, Home, Intent, Land, Takeoff
from groundstation.orders.obstacle_crossings import crossing_findings
from groundstation.orders.reachable_goals import reach_refusal
from groundstation.paths.checks import highest_points, path_findings
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.config.flight_space import flight_space_of
from onboard.config.pair_separation import separation_m
from onboard.control.raised_ground import CLEARANCE_IN_MISSION
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.blind_descent import blind_descent_findings
from onboard.feasibility.finding import (
    Finding,
    at_least,
    at_most,
    warning_of,
    worst,
    worst_first,
)
from onboard.feasibility.fleet_checks import ErrorClass, error_class, fleet_findings, spot_findings
from onboard.flight.path_flight import CATCH_UP_LIMIT_S
from onboard.plain_text import capitalised
from onboard.safety.area_room import length_beyond_m
from onboard.safety.failsafe_table import Condition
from onboard.tuples import Xyz

_SPARE_PCT = 10.0  # charge at the end above the level at which a vehicle lands by itself
_DETOUR_FACTOR = 1.7  # recommended time limit divided by the duration of a straight flight
# Time that a step with paths needs in addition to its longest path: 3 s from the order to their
# start, and the time for which the others wait for one vehicle that falls behind.
_PATH_SPARE_S = 3.0 + CATCH_UP_LIMIT_S
# Distance from the goal within which nearly every arrival with motion capture is.
_ARRIVAL_M = 0.056
# Factor on what another accuracy adds to the standard deviation of an axis. The distance has three
# axes, and heights by satellites err more: of 72 arrivals in lockstep flights by satellites half
# were within 0.50 m, 95 % within 0.82 m, and all but one, with 0.91 m, within the bound.
_ARRIVAL_SIGMAS = 4.3
_SAME_CODE = 0.85  # likeness, from 0 to 1, of two codes of events of which one is misspelt


def mission_findings(mission: Mission, errors: ErrorClass | None = None) -> tuple[Finding, ...]:
    """Return the findings about a mission.

    If several steps have a finding of the same name, only the worst of them is listed. The steps of
    a Python mission are not known before it flies.

    Args:
        mission: mission file, loaded and checked.
        errors: accuracy of positions; None: the accuracy in the fleet file.
    """
    groups: dict[str, list[Finding]] = {}
    for finding in _step_findings(mission, errors):
        groups.setdefault(finding.name, []).append(finding)

    groups["expectation"] = list(_separation_expectation(mission))
    groups["endurance"] = list(_endurance(mission))
    groups["arrival"] = list(_arrival_expectation(mission, errors))
    groups["formation"] = list(_unused_formations(mission))

    return worst_first(worst(group) for group in groups.values() if group)


def refused_findings(mission: Mission, is_simulated: bool) -> list[Finding]:
    """Return the findings that say why the law cannot fly a mission; empty if it can.

    Args:
        mission: mission file, loaded and checked.
        is_simulated: whether the flight is simulated. Then another law than Covey's may fly any
            mission.
    """
    fleet = mission.fleet
    if not fleet.enabled_names:
        return []
    if is_simulated and fleet.law.built_in != "covey":
        return []

    return [
        finding
        for finding in (*mission_findings(mission), *fleet_findings(fleet))
        if finding.status == "refused" and not finding.never_refuses_flights
    ]


def refuse_unflyable(mission: Mission, is_simulated: bool) -> None:
    """Refuse a mission that the law cannot fly.

    Examples are vehicles that are too near to each other, and a fleet that is too large. Findings
    about time do not refuse a mission. In simulation, another law than Covey's may fly any mission.

    Args:
        mission: mission file, loaded and checked.
        is_simulated: whether the flight is simulated.

    Raises:
        ConfigError: the mission cannot be flown.
    """
    refused = refused_findings(mission, is_simulated)
    if not refused:
        return

    more = ""
    if len(refused) > 1:
        more = f" ({len(refused)} findings are against it)"
    raise ConfigError(
        f"{mission.path}: the law says that this cannot be flown{more}. {refused[0].sentence} "
        f"'covey check {mission.path}' tells all."
    )


def _step_findings(mission: Mission, errors: ErrorClass | None) -> Iterator[Finding]:
    """Yield findings about the steps, in their order, and about the end of the mission."""
    fleet = mission.fleet
    # the end of a mission expects what a step of this kind would
    end = ExpectStep(do="expect", all_landed=mission.expect.all_landed is not False)
    course_steps = list(structs.replace(mission, steps=(*mission.steps, end)).course())

    for course_step in course_steps:
        step = course_step.step
        where = f"{course_step.key} ({step.do})"  # such as "step[2] (goto)"

        if course_step.paths:
            yield from _path_step_findings(fleet, course_step, where, errors)
        if isinstance(step, FollowPathStep):
            yield from _pathless_finding(fleet, course_step, where)
        yield from _reaction_finding(course_step, where)
        if course_step.durations_alone_s and isinstance(step, Intent):
            yield from _order_findings(fleet, course_step, step, where, errors)
        if isinstance(step, ExpectStep) and step.all_landed:
            yield from _landed_finding(course_step, "" if step is end else where)

    yield from _branches_findings(course_steps)
    for key, condition in mission.conditions():
        yield from _event_finding(key, condition)


def _event_finding(key: str, condition: Until) -> Iterator[Finding]:
    """Yield the finding about an event whose code is nearly that of a row of the failsafe table.

    Parts of Covey, and scripts, send events with other codes; no list has them all.
    """
    import difflib  # takes time, and is needed by few missions

    code = condition.event
    codes = [row.name.lower().replace("_", "-") for row in Condition]
    if code is None or code in codes:
        return
    nearest = difflib.get_close_matches(code, codes, n=1, cutoff=_SAME_CODE)
    if not nearest:
        return

    sentence = (
        f"{capitalised(key)}: no row of the failsafe table sends an event '{code}'. If you mean "
        f"'{nearest[0]}', the condition never holds."
    )
    remedy = f'Write event = "{nearest[0]}".'
    yield warning_of("event", f"{sentence} {remedy}", remedy)


def _path_step_findings(
    fleet: FleetConfig, course_step: CourseStep, where: str, errors: ErrorClass | None
) -> Iterator[Finding]:
    """Yield findings about a step whose vehicles follow paths."""
    paths = course_step.paths
    yield from path_findings(fleet, paths, where, errors=errors)
    yield from _reach_findings(
        fleet, course_step, where, first_points(paths), "first point of the path"
    )
    yield from crossing_findings(fleet, paths, where)
    yield from _descent_from_paths(fleet, course_step, where)
    yield from _path_time_limit(course_step, where)


def _order_findings(
    fleet: FleetConfig,
    course_step: CourseStep,
    order: Intent,
    where: str,
    errors: ErrorClass | None,
) -> Iterator[Finding]:
    """Yield findings about a step whose order moves vehicles."""
    yield worst(
        _time_limit(order.timeout_s, name, alone_s, where)
        for name, alone_s in course_step.durations_alone_s.items()
    )
    if isinstance(order, GoalIntent) and order.speed_m_s is not None:
        yield _speed_finding(fleet, order.speed_m_s, course_step, where)
    yield from _reach_findings(fleet, course_step, where, course_step.goals, "goal")
    if fleet.fences:
        yield from _straight_line_findings(fleet, course_step, where)

    yield from _parked_findings(fleet, course_step, where)

    if not isinstance(order, Land | Home):
        positions = {**course_step.positions, **course_step.goals}
        # in the order of the fleet, so that the findings are the same each time
        flying_at = {
            name: at_m for name, at_m in positions.items() if name in course_step.flying_after
        }
        yield from spot_findings(fleet, flying_at, where, errors=errors)


def _parked_findings(fleet: FleetConfig, course_step: CourseStep, where: str) -> Iterator[Finding]:
    """Yield the finding about goals at vehicles on the ground: an agent refuses such a goal.

    A flight begins nevertheless, since a vehicle that the mission has not flown may be absent.
    """
    if isinstance(course_step.step, Takeoff | Land):
        return

    height_share = fleet.fleet.height_share
    distances = {
        (name, other): separation_m(course_step.positions[other], goal_enu_m, height_share)
        for name, goal_enu_m in course_step.goals.items()
        for other in course_step.on_ground
        if other != name
    }
    if not distances:
        return

    name, other = min(distances, key=lambda pair: (distances[pair], pair))
    yield at_least(
        name="parked",
        where=where,
        value=distances[name, other],
        bound=fleet.fleet.safety_distance_m,
        unit="m",
        sentence=f"{capitalised(where)}: the goal of {name} is <value> from {other}, which stands "
        "on the ground there; a vehicle refuses a goal that is not <relation> <bound> away",
        remedy=f"Choose a goal further away, or move {other} before.",
        never_refuses_flights=True,
    )


def _landed_finding(course_step: CourseStep, where: str) -> Iterator[Finding]:
    """Yield the finding about vehicles that are not down where all are expected to be.

    Args:
        course_step: the step that expects it, or the end of the mission.
        where: words for the step; empty for the end.
    """
    flying = course_step.flying - course_step.doubtful
    parts = []
    if flying:
        parts.append(f"{', '.join(sorted(flying))} in the air")
    if course_step.unsure:
        react_key = next(iter(course_step.unsure.values()))
        parts.append(
            f"{', '.join(sorted(course_step.unsure))} in the air, depending on whether the "
            f"reaction of {react_key} has come"
        )
    if course_step.armed:
        parts.append(f"{', '.join(sorted(course_step.armed))} armed")
    if not parts:
        return

    begin = "The mission ends"
    remedy = 'Add a last [[step]] with do = "land", or say expect.all_landed = false.'
    if where:
        begin = f"{capitalised(where)}: it expects that all have landed, and is reached"
        remedy = 'Put a step do = "land" before it, or leave its all_landed out.'

    verb = "cannot"
    if not flying:  # PX4 disarms a vehicle that does not take off
        verb = "may not"
    yield _advice(
        name="ending",
        where=where,
        vehicle_count=len(flying) + len(course_step.unsure) + len(course_step.armed),
        sentence=f"{begin} with {' and '.join(parts)}, so it {verb} pass",
        remedy=remedy,
    )


def _descent_from_paths(
    fleet: FleetConfig, course_step: CourseStep, where: str
) -> Iterator[Finding]:
    """Yield the finding about a descent without poses from the highest points of paths.

    Vehicles that hover beside the paths are judged at their positions.
    """
    highest = highest_points(fleet, course_step.paths)
    spots = {}
    for name in fleet.enabled_names:
        if name in highest:
            spots[name] = highest[name]
        elif name in course_step.flying:
            spots[name] = course_step.positions[name]
    yield from blind_descent_findings(fleet, spots, where, are_on_paths=True)


def _path_time_limit(course_step: CourseStep, where: str) -> Iterator[Finding]:
    """Yield the finding about the time that a step with paths gives to the longest of them."""
    step = course_step.step
    if not isinstance(step, FollowPathStep | FlyFormationStep) or step.timeout_s is None:
        return

    paths = course_step.paths
    longest = max(paths, key=lambda name: paths[name].duration_s)
    duration_s = paths[longest].duration_s
    yield at_least(
        name="time",
        where=where,
        value=step.timeout_s,
        bound=duration_s + _PATH_SPARE_S,
        unit="s",
        sentence=f"{capitalised(where)}: timeout_s is <value>; {longest}'s path takes "
        f"{duration_s:.1f} s, so <relation> <bound> leaves room for the start and for a vehicle "
        "that falls behind",
        remedy="Raise its timeout_s by <difference>.",
        never_refuses_flights=True,
        refuse_below=duration_s,
    )


def _advice(*, name: str, where: str, vehicle_count: int, sentence: str, remedy: str) -> Finding:
    """Return a finding about some vehicles that does not refuse the mission."""
    return at_most(
        name=name,
        where=where,
        value=float(vehicle_count),
        bound=0.0,
        unit="",
        sentence=sentence,
        remedy=remedy,
        refuse_above=math.inf,
    )


def _pathless_finding(fleet: FleetConfig, course_step: CourseStep, where: str) -> Iterator[Finding]:
    """Yield the finding about vehicles that fly while others follow paths, without one."""
    if course_step.branches or not course_step.is_known:
        return  # vehicles without a path may fly in another branch

    pathless = [
        name
        for name in fleet.enabled_names
        if name in course_step.flying and name not in course_step.paths
    ]
    if not pathless:
        return
    yield _advice(
        name="no path",
        where=where,
        vehicle_count=len(pathless),
        sentence=f"{capitalised(where)}: {', '.join(pathless)} will hover on the spot, in the "
        "air and without a path",
        remedy="Name a file for each of them in paths, or let them land before.",
    )


def _reaction_finding(course_step: CourseStep, where: str) -> Iterator[Finding]:
    """Yield the finding about vehicles that refuse a step if a reaction has come, or if none has.

    The steps of the reaction itself are judged when the file is read: see step_checks.py.
    """
    begins = "in air"
    if isinstance(course_step.step, Intent):
        begins = course_step.step.begins
    if begins == "anywhere":
        return

    unsure = {
        name: react_key
        for name, react_key in course_step.unsure.items()
        if name in course_step.ordered and not course_step.key.startswith(f"{react_key}.then")
    }
    if not unsure:
        return

    react_key = next(iter(unsure.values()))
    wrong_place = "on the ground" if begins == "in air" else "in the air"
    yield _advice(
        name="reaction",
        where=where,
        vehicle_count=len(unsure),
        sentence=f"{capitalised(where)}: {', '.join(unsure)} may be {wrong_place}, and would "
        f"refuse it: that depends on whether the reaction of {react_key} has come",
        remedy=f"Let the steps of {react_key} and its then both end in the air, or both on the "
        "ground.",
    )


def _branches_findings(course_steps: Iterable[CourseStep]) -> Iterator[Finding]:
    """Yield findings about vehicles that several branches of a parallel step order."""
    for shared in shared_vehicles(course_steps):
        where = f"{shared.block} (parallel)"
        yield _advice(
            name="branches",
            where=where,
            vehicle_count=len(shared.vehicles),
            sentence=f"{capitalised(where)}: several branches order {', '.join(shared.vehicles)}; "
            "an order that comes while the vehicle carries out one of another branch ends that "
            "one, and the mission",
            remedy="Order each vehicle in one branch only, or before or after the parallel.",
        )


def _speed_finding(
    fleet: FleetConfig, speed_m_s: float, course_step: CourseStep, where: str
) -> Finding:
    """Return the finding about a step's speed, which may be more than a vehicle flies."""
    slowest = min(course_step.goals, key=lambda name: fleet.vehicles[name].max_speed_m_s)
    return at_most(
        name="speed",
        where=where,
        value=speed_m_s,
        bound=fleet.vehicles[slowest].max_speed_m_s,
        unit="m/s",
        sentence=f"{capitalised(where)}: it asks for <value>, {slowest} flies at most "
        "<bound>, and takes longer",
        remedy="Lower speed_m_s, or leave it out: then all fly as fast as they may.",
        refuse_above=math.inf,
    )


def _reach_findings(
    fleet: FleetConfig,
    course_step: CourseStep,
    where: str,
    goals: Mapping[str, Xyz],
    noun: str,
) -> Iterator[Finding]:
    """Yield the finding about goals to which obstacles, fences or raised ground leave no route.

    The goals of paths are their first points; the noun names a goal in the sentence.
    """
    clearance_share: float | None = CLEARANCE_IN_MISSION
    if isinstance(course_step.step, Land | Home):  # it ends on the ground
        clearance_share = None

    without_route = {}
    for name, goal in goals.items():
        begin = course_step.positions.get(name)
        if begin is None:  # a path of a vehicle that was disabled after the loading
            continue
        words = reach_refusal(fleet, name, begin, goal, clearance_share)
        if words:
            without_route[name] = words
    if not without_route:
        return

    name, words = next(iter(without_route.items()))
    yield at_most(
        name="reach",
        where=where,
        value=float(len(without_route)),
        bound=0.0,
        unit="",
        sentence=f"{capitalised(where)}: the {noun} of {name} {words}",
        remedy="Or move what stands in the way.",
    )


def _straight_line_findings(
    fleet: FleetConfig, course_step: CourseStep, where: str
) -> Iterator[Finding]:
    """Yield the finding about the straight line to a goal that lies farthest beyond fences."""
    areas = flight_space_of(fleet).areas
    beyond_m = {
        name: length_beyond_m(areas, course_step.positions[name], goal)
        for name, goal in course_step.goals.items()
    }
    if not beyond_m:
        return

    farthest = max(beyond_m, key=lambda name: beyond_m[name])
    yield at_most(
        name="ways",
        where=where,
        value=beyond_m[farthest],
        bound=0.0,
        unit="m",
        sentence=f"{capitalised(where)}: <value> of the straight line from {farthest} to its goal "
        "lie beyond a fence or in its buffer; the vehicle is led around, which takes longer",
        remedy="Put a goal between, so that both straight lines are free.",
        refuse_above=math.inf,
    )


def _time_limit(timeout_s: float, name: str, alone_s: float, where: str) -> Finding:
    """Return the finding about the time that a step gives to one vehicle."""
    return at_least(
        name="time",
        where=where,
        value=timeout_s,
        bound=_DETOUR_FACTOR * alone_s,
        unit="s",
        sentence=f"{capitalised(where)}: timeout_s is <value>; {name} needs {alone_s:.1f} s "
        "alone, so <relation> <bound> leaves room for detours",
        remedy="Raise its timeout_s by <difference>.",
        never_refuses_flights=True,
        refuse_below=alone_s,
    )


def _separation_expectation(mission: Mission) -> Iterator[Finding]:
    """Yield the finding about a separation that the mission expects of the law."""
    expected_m = mission.expect.min_separation_m
    if expected_m is None or mission.fleet.law.built_in == "off":
        return

    yield at_most(
        name="expectation",
        value=expected_m,
        bound=mission.fleet.fleet.safety_distance_m,
        unit="m",
        sentence="The mission expects vehicles to stay <value> apart; fleet.safety_distance_m "
        "promises <bound>",
        remedy="Lower expect.min_separation_m, or raise fleet.safety_distance_m.",
        never_refuses_flights=True,
    )


def _arrival_expectation(mission: Mission, errors: ErrorClass | None) -> Iterator[Finding]:
    """Yield the finding that compares the expected arrivals with the accuracy of positions."""
    within_m = mission.expect.arrived_within_m
    if within_m is None:
        return

    accuracy = ACCURACIES[errors or error_class(mission.fleet)]
    added_std_m = accuracy.position_std_m - ACCURACIES["mocap"].position_std_m
    yield at_least(
        name="arrival",
        value=within_m,
        bound=_ARRIVAL_M + _ARRIVAL_SIGMAS * added_std_m,
        unit="m",
        sentence=f"The mission expects arrivals within <value>; with the accuracy of "
        f"'{accuracy.name}', expect <relation> <bound>: nearly every arrival is within that",
        remedy="Raise expect.arrived_within_m by <difference>, or fly on a better position.",
        never_refuses_flights=True,
        refuse_below=0.0,
    )


def _unused_formations(mission: Mission) -> Iterator[Finding]:
    """Yield findings about the mission's own formations that cannot be made.

    No step uses one of them: such a mission is wrong.
    """
    for name in mission.shapes:
        try:
            formation_slots(mission.fleet, name)
        except ConfigError as error:
            remedy = "Correct it, or remove the formation."
            sentence = f"A formation of the mission cannot be made: {error}"
            yield warning_of("formation", f"{sentence} {remedy}", remedy)


def _endurance(mission: Mission) -> Iterator[Finding]:
    """Yield the finding about each battery's charge at the end, if its hover time is known."""
    fleet = mission.fleet
    course = list(mission.course())

    for name in fleet.enabled_names:
        hover_s = fleet.vehicles[name].hover_time_s
        if hover_s is None:
            continue
        needed_s = expected_flight_s(course, name)
        if not needed_s:
            continue
        yield at_least(
            name="endurance",
            value=100.0 * (1.0 - needed_s / hover_s),
            bound=fleet.fleet.battery_land_pct + _SPARE_PCT,
            unit="%",
            sentence=f"{name} flies for about {needed_s:.0f} s, after which its battery of "
            f"{hover_s:.0f} s has <value> left; it needs <relation> <bound>, the level at "
            "which it lands by itself and some to spare",
            remedy="Make the mission shorter, or split it.",
            refuse_below=fleet.fleet.battery_land_pct,
        )
