"""Findings about a mission before it flies: spacing, time for each leg, expectations. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator

from groundstation.missions.files import Mission, intent_of
from groundstation.missions.steps import FollowPathStep, FormationStep, LandStep, MoveStep, OrderStep, TakeoffStep
from groundstation.orders.grammar import default_formation
from groundstation.orders.plan import HeldFormation, plan_order
from groundstation.paths.checks import path_findings
from onboard.config.fleet import ConfigError, FleetConfig, Vec3
from onboard.control.path import Path, point_at
from onboard.control.trajectory import TrajectoryParams, shortest_duration_s
from onboard.feasibility.bounds import ACCURACIES
from onboard.feasibility.finding import Finding, at_least, at_most, worst, worst_first
from onboard.feasibility.fleet_checks import ErrorClass, error_class, fleet_findings, spot_findings

_OF_THE_MISSION = ("time", "expectation", "arrival", "ending")  # findings that are no promise of the law's
_CLIMB_M_S, _START_S, _SETTLE_S = 0.4, 3.0, 1.0
_ROOM_FOR_DETOURS = 1.7  # times the straight way's duration


def mission_findings(mission: Mission, errors: ErrorClass | None = None) -> tuple[Finding, ...]:
    """Findings about a mission's steps: spacing and room of each constellation, time for each leg, expectations.

    Of equal findings of several steps only the worst is listed. A Python mission's steps are not known before it flies.
    """
    groups: dict[str, list[Finding]] = {}
    for finding in _step_findings(mission, errors):
        groups.setdefault(finding.name.partition(",")[0], []).append(finding)
    expected = mission.expect.min_separation_m
    if expected is not None and mission.fleet.law.name != "off":
        promise_m = mission.fleet.fleet.safety_distance_m
        groups["expectation"] = [
            at_most(
                "expectation",
                expected,
                promise_m,
                "m",
                "The mission expects vehicles to stay {value} apart; fleet.safety_distance_m promises {bound}",
                "Lower expect.min_separation_m, or raise fleet.safety_distance_m.",
            )
        ]
    near_m = mission.expect.arrived_within_m
    if near_m is not None:
        accuracy = ACCURACIES[errors or error_class(mission.fleet)]
        groups["arrival"] = [
            at_least(
                "arrival",
                near_m,
                0.05 + 2.0 * accuracy.position_std_m,
                "m",
                f"The mission expects arrivals within {{value}}; with the accuracy of '{accuracy.name}' {{relation}} "
                "{bound} comes true nearly always",
                "Raise expect.arrived_within_m by {difference}, or fly on a better position.",
                refuse_below=0.0,
            )
        ]
    return worst_first(worst(group) for group in groups.values())


def refused_findings(mission: Mission, is_simulated: bool) -> list[Finding]:
    """Return why the law cannot fly a mission; empty when it can.

    Args:
        mission: loaded and checked.
        is_simulated: whether the flight is simulated: other laws than Covey's may then be flown.
    """
    fleet = mission.fleet
    if not fleet.enabled_names or (is_simulated and fleet.law.name != "covey"):
        return []
    return [
        finding
        for finding in (*mission_findings(mission), *fleet_findings(fleet))
        if finding.status == "refused" and finding.name.partition(",")[0] not in _OF_THE_MISSION
    ]


def refuse_unflyable(mission: Mission, is_simulated: bool) -> None:
    """Refuse a mission that the law cannot fly: vehicles too near to each other, a fleet that is too large.

    Findings about time do not refuse it. Other laws than Covey's may be flown in simulation.

    Args:
        mission: loaded and checked.
        is_simulated: whether the flight is simulated.

    Raises:
        ConfigError: the mission cannot be flown.
    """
    refused = refused_findings(mission, is_simulated)
    if refused:
        more = f" ({len(refused)} findings are against it)" if len(refused) > 1 else ""
        raise ConfigError(
            f"{mission.path}: the law says that this cannot be flown{more}. {refused[0].sentence} "
            f"'covey check {mission.path}' tells all."
        )


def _step_findings(mission: Mission, errors: ErrorClass | None) -> Iterator[Finding]:
    fleet = mission.fleet
    held = HeldFormation(default_formation(fleet))
    positions: dict[str, Vec3] = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
    flying: set[str] = set()
    for index, step in enumerate(mission.steps):
        if isinstance(step, FollowPathStep):
            paths = mission.paths_of(step)
            yield from path_findings(fleet, paths, f"step[{index}] ({step.do})")
            positions.update({name: _point(path, math.inf) for name, path in paths.items()})
            continue
        if not isinstance(step, TakeoffStep | MoveStep | FormationStep | LandStep):
            continue
        intent = intent_of(step, fleet)
        planned = plan_order(intent, fleet, None, held=held, author="check", now_ns=0)
        held = planned.held
        goals = {name: _goal(step, positions[name], order.position_enu_m) for name, order in planned.orders.items()}
        if not goals:
            continue
        where = f"step[{index}] ({step.do})"
        yield worst(_time(fleet, step, name, positions[name], goal, where) for name, goal in goals.items())
        positions.update(goals)
        if isinstance(step, LandStep):
            flying.difference_update(goals)
        else:
            flying.update(goals)
            yield from spot_findings(
                fleet, {name: positions[name] for name in positions if name in flying}, where, errors=errors
            )
    if flying and mission.expect.all_landed is not False:
        yield at_most(
            "ending",
            float(len(flying)),
            0.0,
            "",
            f"The mission ends with {', '.join(sorted(flying))} in the air, so it cannot pass",
            'Add a last [[step]] with do = "land", or say expect.all_landed = false.',
            refuse_above=math.inf,
        )


def _point(path: Path, time_s: float) -> Vec3:
    x, y, z = point_at(path, time_s).position_enu_m
    return (x, y, z)


def _goal(step: OrderStep, position: Vec3, ordered: Vec3 | None) -> Vec3:
    if isinstance(step, TakeoffStep):
        return (position[0], position[1], step.height_m)
    return (position[0], position[1], 0.0) if isinstance(step, LandStep) else ordered or position


def _time(fleet: FleetConfig, step: OrderStep, name: str, position: Vec3, goal: Vec3, where: str) -> Finding:
    vehicle = fleet.vehicles[name]
    if isinstance(step, TakeoffStep | LandStep):
        shortest_s = _START_S + abs(goal[2] - position[2]) / _CLIMB_M_S
    else:
        bounds = TrajectoryParams(vehicle.max_speed_m_s, vehicle.max_acceleration_m_s2)
        shortest_s = shortest_duration_s(math.dist(position, goal), bounds)
        shortest_s = _SETTLE_S + max(shortest_s, getattr(step, "duration_s", 0.0))
    return at_least(
        f"time, {where}",
        step.timeout_s,
        _ROOM_FOR_DETOURS * shortest_s,
        "s",
        f"{where[0].upper()}{where[1:]}: timeout_s is {{value}}; {name} needs {shortest_s:.1f} s alone, so "
        "{relation} {bound} leaves room for detours",
        "Raise its timeout_s by {difference}.",
        refuse_below=shortest_s,
    )
