"""Findings of ``covey check`` about the GNSS corrections of a fleet file.

Files that the fleet file names must exist, and the password must be in its file, which only its
owner may read. The source is not contacted; ``covey corrections
--check`` does that, and tells which messages it sends and where its base is.
"""

from __future__ import annotations

import os

from onboard.config.config_error import ConfigError
from onboard.config.corrections import CorrectionsConfig, beside
from onboard.config.fleet import FleetConfig
from onboard.corrections.relay.sources import password_of
from onboard.feasibility.finding import Finding, Status

_DEMANDS = {
    "any": "Vehicles take off with any fix",
    "rtk_float": "Nobody takes off with less than an RTK float fix",
    "rtk_fixed": "Nobody takes off without an RTK fixed fix",
}


def corrections_findings(fleet: FleetConfig) -> list[Finding]:
    """Return the findings about the source of the corrections; none for a fleet without them."""
    corrections = fleet.corrections
    if corrections is None:
        return []

    takers = [name for name in fleet.enabled_names if fleet.takes_corrections(fleet.vehicles[name])]
    if not takers:
        remedy = (
            "Remove [corrections], or set mocap_required = false where satellites are flown by."
        )
        return [_finding("warning", f"No vehicle takes the corrections. {remedy}", remedy)]

    findings = [
        _finding("warning", sentence, remedy)
        for sentence, remedy in _wrong_files(fleet, corrections)
    ]
    remedy = f"What it sends, and where its base is: covey corrections --fleet {fleet.path} --check"
    sentence = (
        f"RTK corrections come from {_source_words(corrections)}. {_DEMANDS[corrections.fix]}. "
        f"{remedy}"
    )
    findings.append(_finding("note", sentence, remedy))
    return findings


def _wrong_files(fleet: FleetConfig, corrections: CorrectionsConfig) -> list[tuple[str, str]]:
    """Return sentence and remedy for each file of [corrections] that covey corrections refuses."""
    named = {"corrections.password_file": corrections.password_file}
    if corrections.source == "file":
        named["corrections.address"] = corrections.address

    wrong = []
    for key, path in named.items():
        if path and not os.path.isfile(beside(fleet.path, path)):
            remedy = f"Put it there, beside {fleet.path}, or correct '{key}'."
            wrong.append((f"'{key}' names {path}, which is not there. {remedy}", remedy))
    if wrong:
        return wrong

    try:
        password_of(corrections, fleet.path, environment={})
    except ConfigError as error:
        remedy = "Mend the file that 'corrections.password_file' names."
        wrong.append((f"covey corrections refuses the password: {error}", remedy))
    return wrong


def _source_words(corrections: CorrectionsConfig) -> str:
    """Return the source in a few words."""
    if corrections.source == "ntrip":
        return f"the caster {corrections.address}, mountpoint {corrections.mountpoint}"
    if corrections.source == "serial":
        return f"a base on {corrections.address}, {corrections.baud} baud"
    if corrections.source == "tcp":
        return f"the server {corrections.address}"
    if corrections.source == "file":
        return f"the recording {corrections.address}, which is for demonstrations"
    return "a base that is made up, of which real receivers take nothing"


def _finding(status: Status, sentence: str, remedy: str) -> Finding:
    """Return a finding that measures nothing: value and bound are 0."""
    return Finding(
        name="corrections",
        status=status,
        value=0.0,
        bound=0.0,
        unit="",
        relation="at most",
        sentence=sentence,
        remedy=remedy,
    )
