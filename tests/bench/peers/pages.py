"""The pages that ``make bench-law`` writes: how it was measured, the table, the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.bench.peers.contestants import PEERS, Contestant
from tests.bench.peers.report import Outcome, Summary, share, summary, table

_FAMILIES = {"form": "FORM3", "swap": "SWAP", "rand": "RAND"}
_COLUMNS = (
    "Success: everybody at the goal and slow before 5.5 times the straight-line time. Below 0.80 "
    "m: flights in which "
    "the true distance of any pair was ever smaller, with the exact 95 % interval (a collision "
    "is below the body's "
    "diameter of 0.50 m). Ratio: time until the last one has arrived over the straight-line "
    "time, mean of the flights "
    "that succeeded. Slew: rms change of the commanded acceleration. Microseconds: one call of "
    "the law, interpreted as "
    "on a drone, without the pipeline around it, beside other programs; only their ratios mean "
    "something."
)


@dataclass(frozen=True, slots=True)
class Run:
    """Settings of a run, as the page names them."""

    command: str
    seeds: tuple[int, int]
    scenarios: Sequence[str]
    errors: str

    def sentence(self) -> str:
        """Sentence with the command that repeats the run."""
        return (
            f"Written by `{self.command}`: seeds {self.seeds[0]} to {self.seeds[1] - 1} of "
            f"{', '.join(self.scenarios)}; estimate errors `{self.errors}`."
        )


MEASURED = "law-measured.md"  # the page of docs/ that the figures of these benches are printed into


def insert(page: Path, name: str, text: str) -> None:
    """Replace the text between ``<!-- bench: name -->`` and ``<!-- end -->``, if it is there."""
    if not page.is_file():
        return

    begin = f"<!-- bench: {name} -->"
    end = "<!-- end -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    if found:
        after = rest.partition(end)[2]
        page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def write_section(page: Path, name: str, text: str) -> None:
    """Write a section of a page; a page or a section that is not there yet is begun."""
    begin = f"<!-- bench: {name} -->"
    words = page.read_text(encoding="utf-8") if page.is_file() else ""
    if begin not in words:
        page.write_text(f"{words}{begin}\n<!-- end -->\n", encoding="utf-8")
    insert(page, name, text)


def comparison(
    run: Run, rows: Mapping[str, Summary], outcomes: Mapping[str, Sequence[Outcome]]
) -> str:
    """Covey beside the peers."""
    families = [
        name for name in _FAMILIES if any(scenario.startswith(name) for scenario in run.scenarios)
    ]
    head = " | ".join(_FAMILIES[name] for name in families)
    lines = [f"| method | {head} |", "|---" * (len(families) + 1) + "|"]
    for title, flights in outcomes.items():
        parts = []
        for family in families:
            own = summary([flight for flight in flights if flight.scenario.startswith(family)])
            parts.append(
                f"{100.0 * own.successes / own.flights:.0f} % · {own.violations} · {own.ratio:.2f}"
            )
        lines.append(f"| {title} | {' | '.join(parts)} |")
    values = [
        f"| {contestant.title} | "
        f"{', '.join(f'{name} {value:g}' for name, value in contestant.values.items())} |"
        for contestant in PEERS.values()
        if contestant.values
    ]
    return "\n".join(
        [
            "## Covey's law beside other methods",
            "",
            run.sentence(),
            "",
            "Every method flies the same vehicles (type `sih`) with the same perturbation, "
            "baseline, design distance, "
            "tilt and thrust limits, and the same states predicted over the lag; only what turns "
            "the wanted "
            "acceleration into the commanded one differs (`tests/bench/peers`). The paper's ring "
            "is flown as printed, "
            "on plain states, and each vehicle avoids one other. Peers that have no rule against "
            "standing face to face "
            "get one: to the right.",
            "",
            table(rows),
            "",
            _COLUMNS,
            "",
            "![Bars: success, violations, time, slew and cost of each "
            "method](figures/law_bench.png)",
            "",
            "![A dot for every flight: smallest distance against time](figures/law_flights.png)",
            "",
            "![Paths of eight vehicles that change places, by each method](figures/law_paths.png)",
            "",
            "### By scenario",
            "",
            "Success · flights below 0.80 m · ratio.",
            "",
            *lines,
            "",
            "### Values",
            "",
            "Each peer was tuned over six combinations of its own two values "
            "([how](#how-the-peers-were-tuned)), best by violations, then success, then ratio; "
            "the robust certificates with messages that are 200 ms old (form3, swap4x, swap8x, "
            "seeds 0 to 2).",
            "",
            "| method | values |",
            "|---|---|",
            *values,
            "",
        ]
    )


def by_delay(run: Run, delays_s: Sequence[float], rows: Mapping[str, Sequence[Summary]]) -> str:
    """Every method at every delay; ``rows``: title -> one summary for each delay."""
    lines = [f"| method | {' | '.join(f'{1e3 * delay_s:.0f} ms' for delay_s in delays_s)} |"]
    lines.append("|---" * (len(delays_s) + 1) + "|")
    for title, figures in rows.items():
        cells = [
            f"{100.0 * one.successes / one.flights:.0f} % · {share(one.violations, one.flights)} "
            f"· {one.collisions} · "
            f"{one.ratio:.2f}"
            for one in figures
        ]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    count = max(s.flights for figures in rows.values() for s in figures)
    return "\n".join(
        [
            "## Late messages: Covey's law beside other methods",
            "",
            f"{run.sentence()} {count} flights of each method at each delay.",
            "",
            "Age of every message when it arrives. In each cell: success · flights below 0.80 m, "
            "with the exact 95 % "
            "interval · collisions · ratio of those that succeeded, as in the first table. All "
            "methods "
            "know how old a message is, predict its sender over that time in the same way, and "
            "keep the margin that "
            "`covey check` demands for it.",
            "",
            *lines,
            "",
            "![Flights below 0.80 m and time by delay, a line for each "
            "method](figures/law_delay.png)",
            "",
        ]
    )


def ablation(run: Run, rows: Mapping[str, Summary], contestants: Mapping[str, Contestant]) -> str:
    """Covey without each of its ideas."""
    return "\n".join(
        [
            "## What each idea of the law is worth",
            "",
            run.sentence() + " Vehicles of type `sih` and "
            "`ardrone`, the paper's weak one, in turn. One thing is changed at a time; the rest "
            "stays as it is flown.",
            "",
            worth(rows, contestants),
            "",
            "![Bars: success, violations, time, slew of each variant](figures/law_ablation.png)",
            "",
            "All columns:",
            "",
            table(rows, "law", has_cost=False),
            "",
            _COLUMNS,
            "",
        ]
    )


def worth(rows: Mapping[str, Summary], contestants: Mapping[str, Contestant]) -> str:
    """Short table of the ablation, with what to set for each."""
    (first, base), *rest = rows.items()
    lines = [
        "| | below 0.80 m (95 %) | worst m | ratio | success | what to set |",
        "|---|---|---|---|---|---|",
    ]
    sets = {contestant.title: contestant.sets for contestant in contestants.values()}
    for title, s in [(f"**{first}**, as it is", base), *rest]:
        words = " ".join(f"`--set {item}`" for item in sets.get(title, ()))
        lines.append(
            f"| {title} | {share(s.violations, s.flights)} | {s.worst_m:.3f} | {s.ratio:.2f} "
            f"| {100.0 * s.successes / s.flights:.0f} % | {words} |"
        )
    return "\n".join(lines)


def tuning(run: Run, rows: Mapping[str, Summary], best: Mapping[str, str]) -> str:
    """Every combination of every peer."""
    return "\n".join(
        [
            "## How the peers were tuned",
            "",
            run.sentence()
            + " Six combinations of two values for each method; the best has the fewest "
            "violations, then "
            "the most successes, then the smallest ratio.",
            "",
            *[f"* {title}: {values}" for title, values in best.items()],
            "",
            table(rows, has_cost=False),
            "",
        ]
    )
