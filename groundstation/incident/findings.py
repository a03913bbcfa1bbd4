"""Sorts flights by whether they passed, and writes the result in sentences.

Each flight repeats the recorded one with one change. It passes if it keeps the promise, which is
the safety distance of the fleet file, and if the expectations of the mission come true.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from groundstation.incident.candidates import Candidate, CandidateKind


class Trial(NamedTuple):
    """The outcome of a changed flight."""

    candidate: Candidate
    min_separation_m: float  # by ground truth; inf if there is no pair
    has_passed: bool  # whether all expectations of the mission came true
    failure: str = ""  # a sentence that says why it could not be flown; empty: it was flown

    def passes(self, promise_m: float) -> bool:
        """Return whether the promise was kept and the expectations of the mission came true."""
        return not self.failure and self.has_passed and self.min_separation_m >= promise_m


class Findings(NamedTuple):
    """The changed flights, sorted by their outcome."""

    causes: tuple[Trial, ...]  # trials of causes that pass
    defences: tuple[Trial, ...]  # trials of defences that pass
    others: tuple[Trial, ...]  # trials that do not pass


def findings_of(trials: Sequence[Trial], promise_m: float) -> Findings:
    """Sort trials by their outcome.

    The trials that pass are sorted by their smallest distance, the largest first.
    Distances are rounded to decimetres for this; among equals the likelier change comes first.

    Args:
        trials: trials of the candidates, the likeliest change first.
        promise_m: the safety distance.
    """
    passing = [trial for trial in trials if trial.passes(promise_m)]
    others = [trial for trial in trials if not trial.passes(promise_m)]

    return Findings(
        causes=tuple(_best_first(passing, "cause")),
        defences=tuple(_best_first(passing, "defence")),
        others=tuple(others),
    )


def _best_first(trials: Sequence[Trial], kind: CandidateKind) -> list[Trial]:
    of_kind = [trial for trial in trials if trial.candidate.kind == kind]
    return sorted(of_kind, key=lambda trial: -round(trial.min_separation_m, 1))


def sentences(findings: Findings) -> list[str]:
    """Return the findings in sentences, the most important first."""
    lines = []

    for number, trial in enumerate(findings.causes, start=1):
        what = trial.candidate.what
        lines.append(f"{number}. The flight would have passed {what}: {distance_words(trial)}.")
    if not findings.causes and _is_any_cause_flown(findings.others):
        lines.append(
            "No single thing of this flight is the cause: whichever was taken away, it did not"
            " pass."
        )
    elif not findings.causes:
        lines.append("No cause was named: nothing unusual of this flight could be taken away.")

    for trial in findings.defences:
        what = trial.candidate.what
        lines.append(f"It would have passed also by {what}: {distance_words(trial)}.")

    for trial in findings.others:
        if trial.failure:
            lines.append(f"Not flown {trial.candidate.what}: {trial.failure}")
        else:
            lines.append(f"It would not have helped {_other_way(trial)}: {distance_words(trial)}.")
    return lines


def distance_words(trial: Trial) -> str:
    """Return the smallest distance of a flight in words, and whether its mission came true."""
    if math.isinf(trial.min_separation_m):
        return "no two vehicles were in the air"
    words = f"smallest distance {trial.min_separation_m:.2f} m"
    if not trial.has_passed:
        words += ", but the mission did not come true"
    return words


def _is_any_cause_flown(trials: Sequence[Trial]) -> bool:
    return any(trial.candidate.kind == "cause" and not trial.failure for trial in trials)


def _other_way(trial: Trial) -> str:
    """Return a change in words that fit after "It would not have helped"."""
    what = trial.candidate.what
    if trial.candidate.kind == "defence":
        return f"to have {what}"
    return f"to fly {what}"
