"""``covey incident DIR``: what went wrong in a flight, who knew what, and what would have helped.

Examples:
  covey incident flights/first
  covey incident flights/first --before 8
  covey incident flights/first --quick

A flight in lockstep is flown again unchanged, and then several times, each time with one
change; each takes some seconds. Other flights cannot be flown again: for them only the
account is given.

Exit status: 0; 2 when there is no record to open; 130 interrupted.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File, Seconds
from groundstation.flights.recorded_flight import RecordedFlight, open_recorded
from groundstation.incident.account import AFTER_S, account_of
from groundstation.incident.candidates import Candidate, candidates_of
from groundstation.incident.findings import Trial, distance_words, findings_of, sentences
from groundstation.incident.moment import find_moment
from groundstation.recording.reader import record_path
from groundstation.recording.record_list import written_verdict
from groundstation.recording.replay import open_flight
from groundstation.verdict.verdict import fall_sentences
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.exit_status import EXIT_OK
from onboard.plain_text import plain_line

_LONGEST_S = 600.0
_UNCHANGED = Candidate(kind="cause", what="unchanged", changes=())


def incident(
    flight: Annotated[Path, Parameter(name="DIR")],
    /,
    *,
    fleet: File | None = None,
    before: Seconds = 5.0,
    quick: bool = False,
) -> int:
    """Explain a flight: the seconds before it went wrong, and what would have kept the distance.

    Args:
        flight: flight folder
        fleet: fleet file, if there is none beside the record
        before: begin the account this many seconds before it went wrong
        quick: only what the record says; nothing is flown again
    """
    if not 0.0 < before <= _LONGEST_S:
        raise ConfigError(f"--before is {before:g}; it must lie above 0 and at most 600 s.")

    config, timeline = open_flight(flight, fleet)
    with contextlib.closing(timeline):
        moment = find_moment(flight, config, timeline)
        account = account_of(timeline, config, moment, before)
        begin_ns = timeline.begin_ns
        for note in timeline.notes:
            print(note)

    verdict = written_verdict(record_path(flight).parent)
    if isinstance(verdict.get("summary"), str):
        print(plain_line(verdict["summary"]))
    else:
        print("There is no verdict: no mission was flown, or it did not come to its end.")
    for fall in fall_sentences(verdict):
        print(plain_line(fall))
    print(f"At {_seconds(moment.stamp_ns, begin_ns)} s: {plain_line(moment.sentence)}")
    for fact in account.facts:
        print(f"  {plain_line(fact)}")

    print(f"\nThe {before:g} s before it, and {AFTER_S:g} s after:")
    for line in account.lines:
        print(f"{_seconds(line.stamp_ns, begin_ns)} s  {plain_line(line.sentence)}")
    if not account.lines:
        print("Nothing was ordered, and nobody said anything.")

    has_passed = verdict.get("passed") is True and moment.kind != "distance"
    if has_passed:
        print("\nThe flight passed, so it is not flown again with one thing changed.")
    elif not quick:
        _print_what_would_have_helped(flight, config)
    return EXIT_OK


def _seconds(stamp_ns: int, begin_ns: int) -> str:
    return f"{(stamp_ns - begin_ns) * 1e-9:7.2f}"


def _print_what_would_have_helped(folder: Path, config: FleetConfig) -> None:
    """Fly the flight again with each candidate, and print the results and the findings.

    A flight may have failed for a reason that no flight repeats, as a full disk or Ctrl-C. With it
    every candidate would pass. Therefore the flight is flown again unchanged first.
    """
    print()
    try:
        flown = open_recorded(folder)
    except ConfigError as error:
        print(f"It cannot be flown again with one thing changed. {error}")
        return

    promise_m = config.fleet.safety_distance_m
    print("Flying it again unchanged: ", end="", flush=True)
    unchanged = _trial(flown, _UNCHANGED)
    print(unchanged.failure or distance_words(unchanged), flush=True)
    if unchanged.failure:
        return
    if unchanged.passes(promise_m):
        print(
            "Unchanged it passes, so no change can show a cause. What failed was the record, or the"
            " flight was interrupted, or another version of Covey flew it."
        )
        return

    count = len(candidates_of(flown.origin))
    print(f"Flying it again with one thing changed, {count} times:", flush=True)
    trials = []
    for number, trial in enumerate(trials_of(flown), start=1):
        trials.append(trial)
        shown = trial.failure or distance_words(trial)
        print(f"  {number} of {count}: {trial.candidate.what}: {shown}", flush=True)

    print()
    findings = findings_of(trials, promise_m)
    for line in sentences(findings):
        print(plain_line(line))


def trials_of(flown: RecordedFlight) -> Iterator[Trial]:
    """Fly a recorded flight again, once for each candidate; yield each result."""
    for candidate in candidates_of(flown.origin):
        yield _trial(flown, candidate)


def _trial(flown: RecordedFlight, candidate: Candidate) -> Trial:
    """Fly a recorded flight again with a candidate's changes; return the result.

    Raises:
        KeyboardInterrupt: Ctrl-C has ended the flight.
    """
    # Imported here: an account does not need the simulation.
    from sitl.lockstep.reflight import fly_again

    try:
        reflown = fly_again(flown, changes=candidate.changes)
    except ConfigError as error:
        return Trial(
            candidate=candidate, min_separation_m=0.0, has_passed=False, failure=str(error)
        )
    if reflown.verdict.is_interrupted:  # the mission has landed the vehicles and returned
        raise KeyboardInterrupt
    return Trial(
        candidate=candidate,
        min_separation_m=reflown.min_separation_m,
        has_passed=reflown.verdict.passed,
    )
