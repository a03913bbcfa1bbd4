"""``covey check``: is a fleet or mission file right, and can it be flown as configured? Before
anything starts.

Examples:
  covey check configs/fleets/paper.toml
  covey check mission.toml --fleet fleet.toml --errors gps --json

Exit status: 0 all can be flown (warnings may remain); 1 a finding refuses the flight; 2 a file is
wrong. docs/check.md explains each finding.
"""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, fields
from json import dumps
from typing import Annotated, Any

from cyclopts import Parameter

from groundstation.commands.parameters import File
from groundstation.formations.slots import formation_slots
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission_findings import mission_findings
from groundstation.missions.runner import load_function
from onboard.config.endpoints import is_loopback
from onboard.config.example_files import existing_file
from onboard.config.fleet import ConfigError, FleetConfig, RadioConfig, load_fleet, read_toml
from onboard.estimation.accuracies import ACCURACIES
from onboard.exit_status import EXIT_FAILED, EXIT_OK, EXIT_WRONG_INPUT
from onboard.feasibility.airtime import airtime_finding
from onboard.feasibility.finding import Finding, worst_first
from onboard.feasibility.fleet_checks import (
    ErrorClass,
    error_class,
    fleet_findings,
    spacing_finding,
)
from onboard.neighbours.subscription import most_near
from onboard.safety.limits import POSITION_LOST_S

_ROUTER_GAP_S = 1.0  # measured with QUIC, docs/network.md


def check(
    *files: Annotated[str, Parameter(name="FLEET|MISSION", required=True)],
    fleet: File | None = None,
    json: bool = False,
    errors: Annotated[ErrorClass | None, Parameter(choices=ErrorClass)] = None,
) -> int:
    """Say what is wrong with fleet or mission files, and whether they can be flown as configured.

    Args:
        files: fleet or mission files
        fleet: check missions against this fleet
        json: a list with one object for each finding
        errors: accuracy of the position (default: as the fleet file declares it)
    """
    status, rows = EXIT_OK, list[dict[str, Any]]()
    for path in files:
        try:
            headline, config, findings = examine(path, fleet, errors)
        except ConfigError as error:
            status = EXIT_WRONG_INPUT
            if json:
                nothing = dict.fromkeys(field.name for field in fields(Finding))
                rows.append(
                    {
                        "file": path,
                        **nothing,
                        "name": "file",
                        "status": "wrong",
                        "sentence": str(error),
                    }
                )
            print(f"covey: {error}", file=sys.stderr)
            continue
        if any(finding.status == "refused" for finding in findings):
            status = max(status, EXIT_FAILED)
        if json:
            rows += [{"file": path, **asdict(finding)} for finding in findings]
        else:
            print(_page(headline, config, findings, errors))
    if json:
        print(dumps(rows, indent=2))
    return status


def examine(
    path: str, fleet_path: str | None = None, errors: ErrorClass | None = None
) -> tuple[str, FleetConfig, tuple[Finding, ...]]:
    """Return what a file is in a sentence, its fleet, and all findings, the worst first.

    Raises:
        ConfigError: the file is wrong.
    """
    path = existing_file(path, "fleet or mission file")
    if path.endswith(".py") or "step" in read_toml(path, "fleet or mission file")[0]:
        mission = load_mission(path, fleet_path)
        fleet = mission.fleet
        if mission.is_python:
            load_function(mission)
        what = "Python" if mission.is_python else f"{len(mission.steps)} steps"
        headline = (
            f"{path}: a valid mission, {what}, for fleet '{fleet.fleet.name}' ({fleet.path})."
        )
        of_fleet = (*fleet_findings(fleet, errors=errors), *_bus_findings(fleet))
        return headline, fleet, worst_first([*mission_findings(mission, errors), *of_fleet])
    fleet = load_fleet(path)
    names = ", ".join(fleet.enabled_names)
    headline = f"{path}: a valid fleet, {len(fleet.enabled_names)} vehicles ({names}), law '{fleet.law.name}'."
    findings = (*fleet_findings(fleet, errors=errors), *_bus_findings(fleet))
    if len(fleet.enabled_names) > 1:
        spots = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
        accuracy = ACCURACIES[errors or error_class(fleet)]
        above = spacing_finding(fleet, spots, "a take-off of all", accuracy)
        findings = findings if above.status == "ok" else (*findings, above)
        for name in fleet.shapes:
            slots = formation_slots(fleet, name)
            if len(slots) > 1:
                findings = (
                    *findings,
                    spacing_finding(fleet, slots, f"formation '{name}'", accuracy),
                )
    return headline, fleet, worst_first(findings)


def _bus_findings(fleet: FleetConfig) -> list[Finding]:
    """Return what the radio has to carry, and warnings: poses over routers, no keys where other
    computers reach it.
    """
    reached = [name for name in fleet.enabled_names if not is_loopback(fleet.vehicles[name].host)]
    findings = []
    if len(fleet.enabled_names) > 1 and (fleet.radio is not None or reached):
        starts = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
        near = max(
            most_near(fleet, spots)
            for spots in (starts, *fleet.formations.values())
            if len(spots) > 1
        )
        findings.append(airtime_finding(fleet, fleet.radio or RadioConfig(), near))
    blind = [
        name
        for name in fleet.enabled_names
        if fleet.vehicles[name].mocap_required and not fleet.mocap.direct
    ]
    if fleet.fleet.routers and blind:
        findings.append(_router_finding(len(blind)))
    if fleet.has_keys or not reached:
        return findings
    remedy = f"Lock the bus: covey secure {fleet.path} (docs/keys.md)."
    sentence = (
        f"The bus has no keys, and {_number(len(reached), 'vehicle')} can be reached from other computers: whoever "
        f"reaches one of them orders, kills, and reads everything. {remedy}"
    )
    return [
        *findings,
        Finding(
            "keys of the bus", "warning", len(reached), 0.0, "vehicles", "at most", sentence, remedy
        ),
    ]


def _router_finding(count: int) -> Finding:
    remedy = "Let each vehicle read the motion capture itself ([mocap] direct = true), or fly without routers."
    sentence = (
        f"The poses of {_number(count, 'vehicle')} come over routers. When one dies, nothing comes for up to "
        f"{_ROUTER_GAP_S:g} s, and who has no poses for {POSITION_LOST_S:g} s lands. {remedy}"
    )
    return Finding(
        "poses over routers",
        "warning",
        _ROUTER_GAP_S,
        POSITION_LOST_S,
        "s",
        "at most",
        sentence,
        remedy,
    )


def _page(
    headline: str, fleet: FleetConfig, findings: Sequence[Finding], errors: ErrorClass | None
) -> str:
    """The findings as a list for people, the worst first, and the verdict."""
    width = max(60, min(shutil.get_terminal_size((120, 24)).columns, 120))
    name_width = max((len(finding.name) for finding in findings), default=0)
    indent = " " * (9 + name_width + 2)
    lines = [headline]
    for finding in findings:
        mark = {"refused": "REFUSED", "warning": "warning", "ok": "ok"}[finding.status]
        first = f"{mark:<8} {finding.name:<{name_width}}  "
        lines += textwrap.wrap(
            finding.sentence, width, initial_indent=first, subsequent_indent=indent
        )
    counts = {
        status: sum(finding.status == status for finding in findings)
        for status in ("refused", "warning")
    }
    accuracy = f"with the accuracy of '{errors or error_class(fleet)}'"
    if counts["refused"]:
        verdict = (
            f"Do not fly this, {accuracy}: {_number(counts['refused'], 'finding')} against it."
        )
    elif counts["warning"]:
        verdict = f"This can be flown, {accuracy}, with {_number(counts['warning'], 'warning')}."
    else:
        verdict = f"This can be flown, {accuracy}."
    return "\n".join([*lines, verdict])


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
