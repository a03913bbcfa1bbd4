"""A flying fleet of six is cut into 3 + 3 by its network, with real processes: flights, verdicts
and their table.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.bench.network.crossing import SIDES
from tests.bench.network.hub import Hub

PROMISE_M = 0.80  # of the fleet file
CROSSING_S = 6.0  # the cuts are spread over it
HALVES = ("mav0", "mav1", "mav2"), ("mav3", "mav4", "mav5")
_RUNS_S = 180.0
_MILD = "going on"


@dataclass(frozen=True, slots=True)
class Flight:
    """One flight, as its ground saw it.

    ends, returns: of the order of each vehicle across and back; "" for done, otherwise how it ended
    in words. told: by each vehicle's log: conditions, the vehicles that they are about, actions.
    """

    at_s: float
    nearest_m: float
    ends: Mapping[str, str]
    returns: Mapping[str, str]
    has_landed: bool
    told: Mapping[str, Sequence[tuple[str, str, str]]]

    def problems(self) -> list[str]:
        """Return sentences for what is not as promised."""
        found = []
        if not self.nearest_m >= PROMISE_M:
            found.append(
                f"the smallest distance was {self.nearest_m:.2f} m, promised {PROMISE_M:.2f} m"
            )
        found += [
            f"{name}: no end of its order was told"
            for half in HALVES
            for name in half
            if name not in self.ends
        ]
        for half, others in (HALVES, HALVES[::-1]):
            for name in half:
                silent = {
                    one
                    for what, about, _ in self.told[name]
                    if _is(what, "silent")
                    for one in about.split(", ")
                }
                heard = {
                    one
                    for what, about, _ in self.told[name]
                    if _is(what, "heard")
                    for one in about.split(", ")
                }
                found += [f"{name} did not miss {other}" for other in others if other not in silent]
                found += [
                    f"{name} did not hear {other} again" for other in others if other not in heard
                ]
                found += [
                    f"{name}: {what}: {action}"
                    for what, _, action in self.told[name]
                    if action != _MILD
                ]
        lost = [
            name
            for name in HALVES[1]
            if not any(_is(what, "ground") for what, *_ in self.told[name])
        ]
        found += [f"{name} did not miss the ground" for name in lost]
        found += [f"{name} did not arrive: {end}" for name, end in self.ends.items() if end]
        found += [f"{name} did not fly back: {end}" for name, end in self.returns.items() if end]
        return found if self.has_landed else [*found, "not all have landed"]


def _is(what: str, word: str) -> bool:
    words = {
        "silent": "neighbour silent",
        "heard": "neighbour heard again",
        "ground": "ground station lost",
    }
    return what.lower() == words[word]


def fly(at_s: float, lasts_s: float, folder: Path) -> Flight:
    """Fly once, cut after ``at_s`` of the crossing.

    Raises:
        OSError: this computer allows no network namespaces.
        RuntimeError: the flight ended early; the last lines say why.
    """
    words = [str(folder / "hub"), str(folder), str(at_s), str(lasts_s)]
    with Hub(folder / "hub", *SIDES) as hub:
        run = subprocess.run(
            [sys.executable, "-m", "tests.bench.network.crossing", *words],
            capture_output=True, text=True, timeout=_RUNS_S, check=False,
        )  # fmt: skip
    if hub.is_refused:
        raise OSError(
            "This computer allows no network namespaces with a tun device: run it as root."
        )
    if run.returncode != 0:
        raise RuntimeError("\n".join(run.stderr.splitlines()[-12:]))
    return Flight(at_s, **json.loads(run.stdout.splitlines()[-1]))


def fly_all(count: int, lasts_s: float, say: Callable[[str], None]) -> list[Flight]:
    """Fly several times, the cut at times spread over the crossing."""
    flights = []
    for number in range(count):
        with tempfile.TemporaryDirectory(prefix="covey-partition-") as scratch:
            flight = fly(CROSSING_S * (number + 0.5) / count, lasts_s, Path(scratch))
        flights.append(flight)
        say(
            f"flight {number + 1} of {count}: {flight.nearest_m:.2f} m; "
            f"{'; '.join(flight.problems()) or 'as promised'}"
        )
    return flights


def table(flights: Sequence[Flight]) -> str:
    """Return the rows of docs/network.md."""
    lines = [
        "| cut after | smallest distance | told in the half with the ground | in the other half "
        "| orders across "
        "| back, landed | not as promised |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in flights:
        told = [
            "; ".join(
                sorted(
                    {
                        f"{what.lower()}: {action}"
                        for name in half
                        for what, _, action in one.told[name]
                    }
                )
            )
            for half in HALVES
        ]
        done = sum(not end for end in one.ends.values())
        orders = f"{done} done, {len(one.ends) - done} ended in words"
        landed = "all" if one.has_landed else "not all"
        back = f"{sum(not end for end in one.returns.values())} of 6, {landed}"
        problems = "; ".join(one.problems()) or "-"
        lines.append(
            f"| {one.at_s:.1f} s | {one.nearest_m:.2f} m | {' | '.join(told)} | {orders} | "
            f"{back} | {problems} |"
        )
    return "\n".join(lines)
