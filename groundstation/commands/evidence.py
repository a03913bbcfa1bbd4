"""``covey evidence FLEET MISSION``: what a fleet shows when something fails, for an authority.

Examples:
  covey evidence paper.toml paper --wind 5 --out evidence --quick
  covey evidence myfleet.toml myshow.toml --wind 8 --out evidence
  covey evidence myfleet.toml myshow.toml --wind 8 --out evidence2 --beside evidence

The mission is flown in simulated time, once with every fault in each round. --out
gets evidence.html, evidence.json, geography.geojson, volumes.png and flights.jsonl.
After Ctrl-C the same command continues where it was.

It is evidence from simulation, and says what it does not show. Exit status: 0 nothing
speaks against the fleet; 1 something does; 2 wrong input; 130 interrupted.
"""

from __future__ import annotations

import math
import os
import shlex
import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import FleetFile, Folder
from groundstation.evidence.evidence_page import PAGE_NAME, pair_words, result_words
from groundstation.evidence.evidence_summary import Evidence, read_evidence, summarized
from groundstation.evidence.folder import OtherMachine, write_folder
from groundstation.evidence.kept_flights import KEPT_NAME, KeptFlights, read_flights
from groundstation.evidence.matrix import MatrixRow
from groundstation.evidence.provenance import provenance
from groundstation.mission_files.loading import load_mission
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_OK
from sitl.lockstep.campaign.evidence_campaign import (
    Campaign,
    fly_campaign,
    planned_places,
    refuse_strong_wind,
    refuse_unknown_fault,
)

_WHOLE_ROUNDS = 4
_QUICK_ROUNDS = 1
_MAX_ROUNDS = 900
_MAX_JOBS = 64


def evidence(
    fleet: FleetFile,
    mission: Annotated[str, Parameter(name="MISSION")],
    /,
    *,
    wind: Annotated[float, Parameter(metavar="M_S")],
    out: Folder,
    quick: bool = False,
    rounds: Annotated[int | None, Parameter(metavar="N")] = None,
    only: Annotated[str, Parameter(metavar="TEXT")] = "",
    jobs: Annotated[int | None, Parameter(metavar="N")] = None,
    beside: Folder | None = None,
) -> int:
    """Fly a mission with every fault, and write what the flights show.

    Args:
        fleet: fleet file
        mission: mission file, TOML or Python
        wind: mean wind, from a different direction in each flight, with gusts of 15 %
        out: folder of the evidence; flights that it holds are not flown again
        quick: one round: every fault once, which takes minutes
        rounds: number of rounds (default 4)
        only: fly only faults whose name contains this; the others count as not shown
        jobs: number of processes (default: one for each core)
        beside: evidence of another machine, whose figures are compared
    """
    rounds = _rounds(quick, rounds)
    jobs = _jobs(jobs)
    refuse_unknown_fault(only)
    config = load_fleet(fleet)
    flown_mission = load_mission(mission, config)
    config = flown_mission.fleet
    refuse_strong_wind(config, wind)
    if beside is not None and beside.resolve() == out.resolve():
        raise ConfigError(
            f"--beside is {beside}, the folder of this evidence itself. Give the folder of"
            " another machine's."
        )

    campaign = Campaign(
        fleet_path=str(fleet),
        mission_path=str(mission),
        wind_m_s=wind,
        rounds=rounds,
        only=only,
    )
    made_by = provenance(Path(config.path), Path(flown_mission.path), flown_mission)
    same_campaign = {
        "fleet": made_by.config_hash,
        "files": ",".join(made_by.files.values()),
        "wind": f"{wind:g}",
    }
    origin = {**same_campaign, "Covey": made_by.source}
    other = None
    if beside is not None:
        other = _other_machine(beside, same_campaign)
    try:
        out.mkdir(parents=True, exist_ok=True)
        kept = KeptFlights(out / KEPT_NAME, origin)
        if kept.flown:
            print(f"{len(kept.flown)} flights of {out} are kept.", flush=True)
        flights = fly_campaign(campaign, kept, jobs=jobs, say=_Progress().say)
        summary = summarized(
            flights,
            fleet=config,
            mission=flown_mission.name,
            planned=planned_places(flown_mission),
            wind_m_s=wind,
            rounds=rounds,
            command=_command(campaign, out),
            made_by=made_by,
        )
        agreements = write_folder(out, summary, fleet=config, flights=flights, other=other)
    except OSError as error:
        raise ConfigError(f"{out} cannot be written: {error}.") from None

    _print_summary(summary, out)
    is_right = not summary.is_wrong
    for agreement in agreements:
        if not agreement.is_within:
            is_right = False
            print(
                f"Beside the other machine: {agreement.figure}: here {agreement.here}, there"
                f" {agreement.there}: {agreement.result}."
            )
    return EXIT_OK if is_right else EXIT_FAILED


def _rounds(quick: bool, rounds: int | None) -> int:
    if quick and rounds is not None:
        raise ConfigError("--quick is one round. Give --quick or --rounds.")
    if quick:
        return _QUICK_ROUNDS
    if rounds is None:
        return _WHOLE_ROUNDS
    if not 1 <= rounds <= _MAX_ROUNDS:
        raise ConfigError(f"--rounds is {rounds}; it must lie between 1 and {_MAX_ROUNDS}.")
    return rounds


def _jobs(jobs: int | None) -> int:
    if jobs is None:
        return os.cpu_count() or 1
    if not 1 <= jobs <= _MAX_JOBS:
        raise ConfigError(f"--jobs is {jobs}; it must lie between 1 and {_MAX_JOBS}.")
    return jobs


def _other_machine(folder: Path, same_campaign: dict[str, str]) -> OtherMachine:
    """Return the evidence of another machine, which must be of this campaign."""
    evidence_there = read_evidence(folder)
    flights = read_flights(folder / KEPT_NAME, same_campaign)
    if len(flights) < evidence_there.flights:
        raise ConfigError(
            f"{folder / KEPT_NAME} holds {len(flights)} of the {evidence_there.flights} flights of"
            " its evidence. Copy the whole folder of the other machine."
        )
    return OtherMachine(evidence=evidence_there, flights=flights)


def _command(campaign: Campaign, out: Path) -> str:
    """Return the command as a shell takes it."""
    words = ["covey", "evidence", campaign.fleet_path, campaign.mission_path]
    words += ["--wind", f"{campaign.wind_m_s:g}", "--rounds", str(campaign.rounds)]
    words += ["--out", str(out)]
    if campaign.only:
        words += ["--only", campaign.only]
    return shlex.join(words)


class _Progress:
    """Prints lines of progress, with the remaining time estimated from the flights so far."""

    def __init__(self) -> None:
        self._begin_s = time.monotonic()
        self._kept_count: int | None = None  # flights of an earlier run; None before the first line

    def say(self, line: str) -> None:
        """Print a line that begins with ``DONE of TOTAL``."""
        done_word, _, after_done = line.partition(" of ")
        done = int(done_word)
        total = int(after_done.partition(" ")[0])
        if self._kept_count is None:
            self._kept_count = done - 1  # the first line is about the first flight of this run

        elapsed_s = time.monotonic() - self._begin_s
        mean_flight_s = elapsed_s / (done - self._kept_count)
        left_s = mean_flight_s * (total - done)
        print(f"{line}  [{_minutes(left_s)} to go]", flush=True)


def _minutes(seconds: float) -> str:
    if seconds < 60.0:
        return "less than a minute"
    return f"{math.ceil(seconds / 60.0)} min"


def _print_summary(summary: Evidence, out: Path) -> None:
    print()
    for row in summary.matrix:
        print(_row_line(row))
    shapes = summary.volumes
    print(
        f"\nContingency volume: {shapes.excursion_m:.1f} m around the flight geography, up to"
        f" {shapes.contingency_above_ground_m:.1f} m."
        f" Ground risk buffer: {shapes.fall_reach_m:.1f} m."
    )
    print(
        f"{summary.flights} flights, {summary.wrong_flights} wrong. Digest {summary.digest[:16]}."
    )
    print(f"{out / PAGE_NAME}: open it in a browser; it says what it does not show.")


def _row_line(row: MatrixRow) -> str:
    figures = f"no flights{pair_words(row)}"
    if row.flights:
        figures = f"{row.wrong_flights} of {row.flights} wrong, below {row.upper_bound:.1%}"
    return f"  {result_words(row)}: {row.question}  ({figures})"
