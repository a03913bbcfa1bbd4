"""Examines a fleet or mission file: returns what it is, and all findings about flying it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

from groundstation.formations.slots import formation_slots
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import mission_findings
from groundstation.missions.python_check import check_python
from groundstation.network.bus_findings import bus_findings
from groundstation.network.corrections_findings import corrections_findings
from onboard.config.example_files import existing_file
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet, read_toml
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.finding import Finding, worst_first
from onboard.feasibility.fleet_checks import (
    OWN_LAW,
    ErrorClass,
    error_class,
    fleet_findings,
    spacing_finding,
)


class ExaminedFile(NamedTuple):
    """One file without errors, and the findings about whether it can be flown."""

    headline: str  # what it is, in a sentence
    fleet: FleetConfig  # the fleet, or the fleet that flies the mission
    findings: tuple[Finding, ...]  # the worst first
    mission: Mission | None = None  # None: a fleet file


def examine(
    path: str,
    fleet_path: str | None = None,
    errors: ErrorClass | None = None,
    *,
    runs_law: bool = False,
) -> ExaminedFile:
    """Examine a fleet or mission file.

    Args:
        path: path of the file, or name of an example.
        fleet_path: fleet file instead of the mission's.
        errors: accuracy of the position; None: as the fleet file declares.
        runs_law: whether a user's own law is imported, which runs its code.

    Raises:
        ConfigError: the file is wrong, or the imported law is.
    """
    path = existing_file(path, "fleet or mission file")
    if path.endswith(".json"):
        raise ConfigError(
            f"{path} is no fleet or mission file. If it is a scene, fly it: covey simulate {path}."
        )

    is_mission = path.endswith(".py")
    if not is_mission:
        values, *_ = read_toml(path, "fleet or mission file")
        names_fleet = isinstance(values.get("fleet"), str)  # in a fleet file it is a table
        is_mission = "step" in values or names_fleet
    if is_mission:
        examined = _examine_mission(path, fleet_path, errors)
    else:
        examined = _examine_fleet(path, errors)

    if examined.fleet.own_law is None:
        return examined
    if runs_law:
        examined.fleet.import_law()  # so that an error in it is found now
        sentence = "It was imported here, because --run-law was given: it can be called as a law."
    else:
        sentence = "None of its code was run here; --run-law imports it, with your rights."
    return examined._replace(findings=_with_words_about_law(examined.findings, sentence))


def _with_words_about_law(findings: Iterable[Finding], sentence: str) -> tuple[Finding, ...]:
    """Return the findings, with one more sentence in the finding about a user's own law."""
    result = []
    for finding in findings:
        if finding.name == OWN_LAW:
            result.append(replace(finding, sentence=f"{finding.sentence} {sentence}"))
        else:
            result.append(finding)
    return tuple(result)


def _examine_mission(path: str, fleet_path: str | None, errors: ErrorClass | None) -> ExaminedFile:
    mission = load_mission(path, fleet_path)
    fleet = mission.fleet
    content = f"{len(mission.steps)} steps"
    if mission.is_python:
        check_python(mission)  # so that an error in it is found now
        content = "Python"

    findings = [
        *mission_findings(mission, errors),
        *fleet_findings(fleet, errors=errors),
        *bus_findings(fleet),
    ]
    headline = f"{path}: a valid mission, {content}, for fleet '{fleet.fleet.name}' ({fleet.path})."
    return ExaminedFile(headline, fleet, worst_first(findings), mission)


def _examine_fleet(path: str, errors: ErrorClass | None) -> ExaminedFile:
    fleet = load_fleet(path)
    findings = [
        *fleet_findings(fleet, errors=errors),
        *bus_findings(fleet),
        *corrections_findings(fleet),
    ]
    if len(fleet.enabled_names) > 1:
        findings += _spacing_findings(fleet, errors)

    names = ", ".join(fleet.enabled_names)
    count = len(fleet.enabled_names)
    headline = f"{path}: a valid fleet, {count} vehicles ({names}), law '{fleet.law.name}'."
    return ExaminedFile(headline, fleet, worst_first(findings))


def _spacing_findings(fleet: FleetConfig, errors: ErrorClass | None) -> list[Finding]:
    """Return findings about whether all can hover above their starts, and in each shape."""
    accuracy = ACCURACIES[errors or error_class(fleet)]
    findings = []

    starts = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
    take_off = spacing_finding(fleet, starts, "a take-off of all", accuracy)
    if take_off.status != "ok":
        findings.append(take_off)

    for name in fleet.shapes:
        slots = formation_slots(fleet, name)
        if len(slots) > 1:
            findings.append(spacing_finding(fleet, slots, f"formation '{name}'", accuracy))
    return findings
