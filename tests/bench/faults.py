"""The fault suite over its axes: what breaks, when, in which mission, height and wind, and pairs.

    make bench-faults ARGS="--keep faults.jsonl"                 # flies on where it was stopped
    make bench-faults ARGS="--keep faults.jsonl --seconds 600"   # stops after ten minutes
    make bench-faults ARGS="--keep faults.jsonl --write"         # docs/failsafe.md and its proofs
    make bench-faults ARGS="--pairs --keep pairs.jsonl"          # two faults, 0 to 2 s apart

Each round flies every fault once, at a moment, height, wind, fleet size and mission of its own,
all drawn from the number of the round; the wind is one that the fleet may fly in. So a bench that
is stopped early has flown all faults about equally often. `--write` hands the results to the
documents (with `--only`, of these faults): run
`.venv/bin/python -m tests.architecture.documents --write` afterwards.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from onboard.config.wind_limit import wind_limit_m_s
from sitl.lockstep.campaign.injections import INJECTIONS, Injection
from tests.sitl.lockstep.suite import CROSSING, MISSIONS, Case, Outcome, fly

FLOWN = Path(__file__).parents[1] / "sitl" / "lockstep" / "flown.json"

HEIGHTS_M = (1.0, 2.5, 10.0)
WINDS_M_S = (0.0, 3.0, 5.0)
COUNTS = (3, 3, 6)
CROSSING_SHARE = 0.6  # of the flights; the others fly one of the other missions
PAIRS = 40  # of faults, each flown with so many crossings
PAIR_CROSSINGS = ((3, 1.0), (3, 2.5), (6, 1.0))  # vehicles and height
LONGEST_GAP_S = 2.0
_TICK_S = 0.02
_LONGER_S_PER_M = 2.2  # that a climb and a descent take for each metre above one


def main(words: Sequence[str]) -> int:
    """Fly what is missing, then print the table; 1 when anything is judged wrong."""
    parser = argparse.ArgumentParser(
        prog="make bench-faults", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "--keep", type=Path, help="results, a line each; what it holds is not flown"
    )
    parser.add_argument("--rounds", type=int, default=12, help="flights of each fault (default 12)")
    parser.add_argument("--seconds", type=float, default=math.inf, help="begin none after so long")
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--calm", action="store_true", help="without wind")
    parser.add_argument("--pairs", action="store_true", help="pairs of faults")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--write", action="store_true", help="hand the results to the documents")
    options = parser.parse_args(words)

    todo = list(pairs() if options.pairs else rounds(options.rounds))
    todo = [case for case in todo if options.only in case.name]
    if options.calm:
        todo = [case for case in todo if not case.wind_m_s]

    kept = _read(options.keep)
    missing = [case for case in todo if _key(case) not in kept]
    for outcome in _flown(missing, jobs=options.jobs, seconds=options.seconds):
        kept[_key(outcome.case)] = _record(outcome)
        if options.keep is not None:
            with options.keep.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(kept[_key(outcome.case)]) + "\n")
        print(_words(outcome), flush=True)

    records = [kept[_key(case)] for case in todo if _key(case) in kept]
    print(f"\n{len(records)} of {len(todo)} flown, {sum(bool(r['wrong']) for r in records)} wrong")
    if options.write:
        results = summary(records)
        if options.only:  # of the other faults the results before stay
            results = json.loads(FLOWN.read_text(encoding="utf-8")) | results
        FLOWN.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return int(any(record["wrong"] for record in records))


def rounds(count: int) -> Iterator[Case]:
    """Yield every fault once a round, each time in another world."""
    for number in range(count):
        for place, injection in enumerate(INJECTIONS):
            rng = np.random.default_rng([number, place])
            name = _mission(rng, injection)
            mission = MISSIONS[name]
            vehicles = 3
            height_m = mission.height_m
            if name == CROSSING:
                vehicles = int(rng.choice(COUNTS))
                height_m = float(rng.choice(HEIGHTS_M))
            case = Case(
                injection=injection.name,
                tick=_moment(rng, name, height_m),
                count=vehicles,
                place=int(rng.integers(vehicles)),
                height_m=height_m,
                wind_m_s=float(rng.choice(WINDS_M_S)),
                mission=name,
            )
            yield replace(case, wind_m_s=min(case.wind_m_s, _largest_wind_m_s(case)))


def _largest_wind_m_s(case: Case) -> float:
    """Return the wind in which the fleet of a case may fly at most, rounded down."""
    fleet = MISSIONS[case.mission].mission(case).fleet
    limit_m_s = min(wind_limit_m_s(fleet, vehicle) for vehicle in fleet.vehicles.values())
    return math.floor(10.0 * limit_m_s) / 10.0


def _mission(rng: np.random.Generator, injection: Injection) -> str:
    """Return the name of a mission in which this can break; mostly a crossing."""
    names = [name for name, mission in MISSIONS.items() if mission.may_break(injection)]
    is_crossing = rng.random() < CROSSING_SHARE
    if CROSSING in names and is_crossing:
        return CROSSING
    return str(rng.choice([name for name in names if name != CROSSING]))


def pairs() -> Iterator[Case]:
    """Yield pairs of faults, each with several crossings."""
    injections = [one for one in INJECTIONS if MISSIONS[CROSSING].may_break(one)]
    for number in range(PAIRS):
        rng = np.random.default_rng([number, 99])
        first, second = rng.choice(len(injections), size=2, replace=False)
        for vehicles, height_m in PAIR_CROSSINGS:
            yield Case(
                injection=injections[first].name,
                tick=_moment(rng, CROSSING, height_m),
                count=vehicles,
                place=int(rng.integers(vehicles)),
                height_m=height_m,
                second=injections[second].name,
                second_place=int(rng.integers(vehicles)),
                gap_s=round(float(rng.uniform(0.0, LONGEST_GAP_S)), 2),
            )


def _moment(rng: np.random.Generator, mission: str, height_m: float) -> int:
    """Return a tick of the flight; a crossing that is higher takes longer."""
    flight_s = MISSIONS[mission].flight_s
    if mission == CROSSING:
        flight_s += _LONGER_S_PER_M * (height_m - 1.0)
    return int(rng.integers(round(flight_s / _TICK_S)))


def summary(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the results by fault, as the documents print them."""
    by_fault: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in records:
        by_fault[record["case"]["injection"]].append(record)

    results = {}
    for injection in INJECTIONS:
        of_fault = by_fault.get(injection.name)
        if not of_fault:
            continue
        seen: Counter[str] = Counter()
        for record in of_fault:
            seen.update(record["seen"])
        results[injection.name] = {
            "flights": len(of_fault),
            "wrong": sum(bool(record["wrong"]) for record in of_fault),
            "missions": sorted({record["case"]["mission"] for record in of_fault}),
            "counts": sorted({record["case"]["count"] for record in of_fault}),
            "heights_m": sorted({record["case"]["height_m"] for record in of_fault}),
            "winds_m_s": sorted({record["case"]["wind_m_s"] for record in of_fault}),
            "smallest_m": _smallest(of_fault, "free_m"),
            "smallest_silenced_m": _smallest(of_fault, "silenced_m"),
            "smallest_unflown_m": _smallest(of_fault, "unflown_m"),
            "seen": dict(sorted(seen.items())),
        }
    return results


def _smallest(records: Sequence[dict[str, Any]], name: str) -> float | None:
    values = [record[name] for record in records if record[name] is not None]
    return min(values, default=None)


def _flown(cases: Sequence[Case], *, jobs: int, seconds: float) -> Iterator[Outcome]:
    """Fly cases, as many at once as there are jobs; begin none after some time."""
    begin_s = time.monotonic()
    if jobs == 1:
        for case in cases:
            if time.monotonic() - begin_s > seconds:
                return
            yield fly(case)
        return

    with ProcessPoolExecutor(jobs) as pool:
        for first in range(0, len(cases), jobs):
            if time.monotonic() - begin_s > seconds:
                return
            yield from pool.map(fly, cases[first : first + jobs])


def _read(path: Path | None) -> dict[str, dict[str, Any]]:
    """Return the results that a file holds."""
    if path is None or not path.exists():
        return {}
    records = [json.loads(text) for text in path.read_text(encoding="utf-8").splitlines()]
    return {_key(Case(**record["case"])): record for record in records}


def _key(case: Case) -> str:
    return json.dumps(asdict(case), sort_keys=True)


def _record(outcome: Outcome) -> dict[str, Any]:
    return {
        "case": asdict(outcome.case),
        "wrong": outcome.wrong,
        "seen": sorted(outcome.seen),
        "free_m": _finite(outcome.min_separation_m),
        "silenced_m": _finite(outcome.min_silenced_m),
        "unflown_m": _finite(outcome.min_unflown_m),
    }


def _finite(distance_m: float) -> float | None:
    return round(distance_m, 3) if math.isfinite(distance_m) else None


def _words(outcome: Outcome) -> str:
    verdict = "; ".join(outcome.wrong) or "as it should"
    distances = (outcome.min_separation_m, outcome.min_silenced_m, outcome.min_unflown_m)
    nearest = ", ".join(f"{value:.2f}" for value in distances if math.isfinite(value))
    return f"{outcome.case.name} ({nearest} m): {verdict}"
