"""Whether a change of the code has changed a flight: digests of many repeatable flights, and what
differs.

    make bench-digest ARGS="--out before.json"          # in the older tree
    make bench-digest ARGS="--compare before.json"      # in the newer one; exit status 1 when any
    flight differs

Three kinds of flights are flown, all in simulated time and all with fixed seeds:

* every mission of the gallery, through ``covey demo gallery``;
* a cross-section of the fault suite, every fourth kind of fault at a moment of its own;
* a campaign of 500 flights, through ``covey simulate --json``.

Flights in lockstep are digested from their records, topic by topic: truth (positions), tick (every
value of the pipeline, among them the setpoint), telemetry (states of the flight), event (what held,
and when) and order. The verdict of a mission is a topic of its own. Sentences are digested apart
from all else, as "words": they may be written better.

Only public formats are read, so that the same script judges trees whose insides have other names.
Numbers that name a version of the source, and not a behaviour, are left out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

ROOT = Path(__file__).parents[2]

TOPICS = ("truth", "tick", "telemetry", "event", "order")
NAMES_OF_VERSIONS = frozenset(
    [
        "boot_id",
        "config_hash",
        "fleet_hash",
        "law_hash",
        "law_version",
        "version",
        "versions",
        "record",
    ]
)
NAMES_OF_WORDS = frozenset(
    {"sentence", "sentences", "reason", "reasons", "not_ready", "summary", "text"}
)

GALLERY = "gallery"
FAULTS = "faults"
CAMPAIGN = "campaign"
KINDS = (GALLERY, FAULTS, CAMPAIGN)

# 500 flights: mixed sizes, errors of the motion capture, whoever does not cooperate, heights,
# obstacles
SCENARIOS = {
    ("form3", "swap4", "swap8", "rand8", "lost4", "rand16"): (1000, 1070),
    ("swap16", "forest8"): (1000, 1040),
}

Digests = dict[str, dict[str, str]]  # flight -> topic -> digest


def main(words: Sequence[str]) -> int:
    """Fly, then write the digests or compare them; 1 when a flight differs from the file."""
    parser = argparse.ArgumentParser(
        prog="make bench-digest", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--out", type=Path, help="write the digests to this file")
    parser.add_argument("--compare", type=Path, help="a file of another tree, written with --out")
    parser.add_argument("--only", choices=KINDS, help="one of the three kinds of flights")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    options = parser.parse_args(words)

    kinds = [options.only] if options.only else list(KINDS)
    digests: Digests = {}
    for flight, found in flown(kinds, jobs=options.jobs):
        digests[flight] = found
        print(f"{flight}: {digest_of(found.values())[:16]}", flush=True)
    print(
        f"{len(digests)} digests, all together "
        f"{digest_of(json.dumps(digests, sort_keys=True))[:16]}"
    )

    if options.out is not None:
        options.out.write_text(json.dumps(digests, indent=1, sort_keys=True), encoding="utf-8")
    if options.compare is None:
        return 0
    before = json.loads(options.compare.read_text(encoding="utf-8"))
    differences = list(compared(before, digests))
    for line in differences:
        print(line)
    print(f"{len(differences)} of {len(digests)} differ")
    return int(bool(differences))


def flown(kinds: Sequence[str], *, jobs: int) -> Iterator[tuple[str, dict[str, str]]]:
    """Fly all flights of these kinds; yield the name and the digests of each."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        if GALLERY in kinds:
            yield from pool.map(digest_of_gallery, gallery_names())
        if FAULTS in kinds:
            yield from pool.map(digest_of_fault, fault_cases())
    if CAMPAIGN in kinds:
        for scenarios, (first, end) in SCENARIOS.items():
            yield from digests_of_campaign(scenarios, first, end, jobs=jobs)


def compared(before: Digests, after: Digests) -> Iterator[str]:
    """Yield a line for each flight that is not the same in both."""
    for flight, digests in after.items():
        old = before.get(flight)
        if old is None:
            yield f"{flight}: not flown before"
        elif old != digests:
            differing = sorted(
                topic for topic in {*old, *digests} if old.get(topic) != digests.get(topic)
            )
            yield f"{flight}: differs in {', '.join(differing)}"


# -- the three kinds of flights --------------------------------------------------------------------


def gallery_names() -> list[str]:
    """Return the names of the gallery's missions."""
    pictures = (ROOT / "docs/figures").glob("gallery-*.png")  # one of each mission
    return sorted(path.stem.removeprefix("gallery-") for path in pictures)


def digest_of_gallery(name: str) -> tuple[str, dict[str, str]]:
    """Fly one mission of the gallery; its name and digests."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "record"
        covey("gallery", name, "--record", str(folder))
        return f"{GALLERY} {name}", digests_of_record(folder)


def fault_cases() -> list[Any]:
    """Return every fourth kind of fault, each at a moment of its own."""
    from tests.sitl.lockstep.suite import cases

    return cases(every=850, counts=(3,), stagger=173)[::4]


def digest_of_fault(case: Any) -> tuple[str, dict[str, str]]:
    """Fly one case of the fault suite; its name and digests, with the judge's word as a topic."""
    from tests.sitl.lockstep.suite import fly

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        outcome = fly(case, folder=folder)
        digests = digests_of_record(folder)
    judged = [outcome.wrong, sorted(outcome.seen.items()), repr(outcome.min_separation_m)]
    return f"{FAULTS} {case.name}", {**digests, "judged": digest_of(json.dumps(judged))}


def digests_of_campaign(
    scenarios: Sequence[str], first: int, end: int, *, jobs: int
) -> Iterator[tuple[str, dict[str, str]]]:
    """Fly every scenario with every seed; yield the name and digest of each flight."""
    output = covey(
        "simulate", *scenarios, "--seeds", f"{first}:{end}", "--jobs", str(jobs), "--json"
    )
    for line in output.splitlines():
        record = json.loads(line)
        yield f"{CAMPAIGN} {record['scenario']} {record['seed']}", {"record": digest_of(line)}


def covey(*words: str) -> str:
    """Run a command of this tree; its standard output. A flight that fails its expectations is a
    flight, too.
    """
    done = subprocess.run(
        [sys.executable, "-m", "groundstation", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1):
        raise RuntimeError(f"covey {' '.join(words)} ended with {done.returncode}: {done.stderr}")
    return done.stdout


# -- digests ---------------------------------------------------------------------------------------


def digests_of_record(folder: Path) -> dict[str, str]:
    """Return topic -> digest of a flight's record; the folder is that of the flight or one above
    it.
    """
    hashes = {topic: hashlib.sha256() for topic in (*TOPICS, "words")}

    for path in sorted(folder.rglob("flight.mcap")):
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                topic = next((part for part in channel.topic.split("/") if part in TOPICS), None)
                if topic is None:
                    continue
                words: list[Any] = []
                value = json.dumps(without_words(json.loads(message.data), words), sort_keys=True)
                hashes[topic].update(f"{message.log_time} {channel.topic} {value}\n".encode())
                hashes["words"].update(json.dumps(words).encode())

    digests = {topic: one.hexdigest() for topic, one in hashes.items()}

    verdicts = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("verdict.json"))
    ]
    digests["verdict"] = digest_of(json.dumps(without_words(verdicts, []), sort_keys=True))
    return digests


def without_words(value: Any, words: list[Any]) -> Any:
    """Return JSON without versions of the source and without sentences; the sentences are added to
    a list.
    """
    if isinstance(value, list):
        return [without_words(part, words) for part in value]
    if not isinstance(value, dict):
        return value

    kept = {}
    for key, part in value.items():
        if key in NAMES_OF_WORDS:
            words.append(part)
        elif key not in NAMES_OF_VERSIONS:
            kept[key] = without_words(part, words)
    return kept


def digest_of(parts: str | Iterable[str]) -> str:
    """Return the digest of a text, or of several, one after the other."""
    digest = hashlib.sha256()
    for part in [parts] if isinstance(parts, str) else parts:
        digest.update(part.encode())
    return digest.hexdigest()
