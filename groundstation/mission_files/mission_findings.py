"""Findings about a mission before it flies: spacing, time for each leg, expectations. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator

from groundstation.mission_files.loading import Mission
from groundstation.mission_files.steps import HomeStep, LandStep, OrderStep
from groundstation.paths.checks import path_findings
from onboard.config.fleet import ConfigError
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.finding import Finding, at_least, at_most, worst, worst_first
from onboard.feasibility.fleet_checks import ErrorClass, error_class, fleet_findings, spot_findings

# findings that are no promise of the law's
_OF_THE_MISSION = ("time", "expectation", "arrival", "ending")
_SPARE_PCT = 10.0
_ROOM_FOR_DETOURS = 1.7  # times the straight way's duration


def mission_findings(mission: Mission, errors: ErrorClass | None = None) -> tuple[Finding, ...]:
    """Findings about a mission's steps: spacing and room of each constellation, time for each leg,
    expectations.

    Of equal findings of several steps only the worst is listed. A Python mission's steps are not
    known before it flies.
    """
    groups: dict[str, list[Finding]] = {}
    for finding in _step_findings(mission, errors):
        groups.setdefault(finding.name.partition(",")[0], []).append(finding)
    expected = mission.expect.min_separation_m
    if expected is not None and mission.fleet.law.built_in != "off":
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
    groups["endurance"] = list(_endurance(mission))
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
    return worst_first(worst(group) for group in groups.values() if group)


def refused_findings(mission: Mission, is_simulated: bool) -> list[Finding]:
    """Return why the law cannot fly a mission; empty when it can.

    Args:
        mission: loaded and checked.
        is_simulated: whether the flight is simulated: other laws than Covey's may then be flown.
    """
    fleet = mission.fleet
    if not fleet.enabled_names or (is_simulated and fleet.law.built_in != "covey"):
        return []
    return [
        finding
        for finding in (*mission_findings(mission), *fleet_findings(fleet))
        if finding.status == "refused" and finding.name.partition(",")[0] not in _OF_THE_MISSION
    ]


def refuse_unflyable(mission: Mission, is_simulated: bool) -> None:
    """Refuse a mission that the law cannot fly: vehicles too near to each other, a fleet that is
    too large.

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
    flying: set[str] = set()
    for stage in mission.course():
        step, where = stage.step, f"{stage.key} ({stage.step.do})"
        if stage.paths:
            yield from path_findings(fleet, stage.paths, where)
        if not stage.alone_s or not isinstance(step, OrderStep):
            continue
        yield worst(
            _time(step.timeout_s, name, alone_s, where) for name, alone_s in stage.alone_s.items()
        )
        flying = set(stage.flying)
        if isinstance(step, LandStep | HomeStep):
            flying.difference_update(stage.goals)
        else:
            flying.update(stage.goals)
            positions = {**stage.positions, **stage.goals}
            yield from spot_findings(
                fleet, {name: positions[name] for name in flying}, where, errors=errors
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


def _endurance(mission: Mission) -> Iterator[Finding]:
    """Judge what is left in each battery at the end, where the fleet file says how long one lasts."""
    fleet = mission.fleet
    lasting = {name: fleet.vehicles[name].hover_time_s for name in fleet.enabled_names}
    needed_s = sum(stage.times * stage.expected_s for stage in mission.course())
    for name, hover_s in lasting.items():
        if hover_s is not None and needed_s:
            yield at_least(
                "endurance",
                100.0 * (1.0 - needed_s / hover_s),
                fleet.fleet.battery_land_pct + _SPARE_PCT,
                "%",
                f"The mission takes about {needed_s:.0f} s, after which {name}'s battery of {hover_s:.0f} s has "
                "{value} left; {relation} {bound} is the level at which it lands by itself, and some to spare",
                "Make the mission shorter, or split it.",
                refuse_below=fleet.fleet.battery_land_pct,
            )


def _time(timeout_s: float, name: str, alone_s: float, where: str) -> Finding:
    return at_least(
        f"time, {where}",
        timeout_s,
        _ROOM_FOR_DETOURS * alone_s,
        "s",
        f"{where[0].upper()}{where[1:]}: timeout_s is {{value}}; {name} needs {alone_s:.1f} s alone, so "
        "{relation} {bound} leaves room for detours",
        "Raise its timeout_s by {difference}.",
        refuse_below=alone_s,
    )
