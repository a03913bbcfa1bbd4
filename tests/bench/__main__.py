"""``make bench-NAME ARGS="..."``, which is ``python -m tests.bench NAME ...``: run one benchmark of
this clone.
"""

from __future__ import annotations

import importlib
import sys

from onboard.config.fleet import ConfigError

# name -> module with main(words) -> exit status, description
BENCHMARKS = {
    "lockstep": (
        "tests.bench.lockstep",
        "how much faster than time flights in lockstep are, and where the time goes",
    ),
    "demo": ("tests.bench.demo", "fly the demo several times and write a table"),
    "console": ("tests.bench.console", "what the console costs and how quickly it answers"),
    "sitl": ("tests.bench.sitl", "what the emulated PX4s cost"),
    "responses": ("tests.bench.responses", "the emulator beside PX4: steps, closed loop, errors"),
    "silence": (
        "tests.bench.silence.bench",
        "how soon the link to PX4 is silent after an agent hangs",
    ),
    "agents": ("tests.bench.agents", "period, processor and memory of agents in flight"),
    "soak": ("tests.bench.soak", "memory, orders and late ticks of a long flight"),
    "tick": ("tests.bench.tick", "processor time of one control tick with 0 to 12 neighbours"),
    "moves": (
        "tests.bench.tick_moves",
        "calls of one flying tick, and how often it goes from one module to another",
    ),
    "gallery": ("tests.bench.gallery", "fly and draw the missions of the gallery"),
    "mutants": (
        "tests.bench.mutants",
        "small mistakes in the rooms that decide about safety, and whether a test notices",
    ),
    "accidents": (
        "tests.bench.accidents",
        "four accidents that happened, flown with their defences and without",
    ),
    "network": (
        "tests.bench.network.bench",
        "states over a bad link, a fleet cut in two in flight, agents with keys",
    ),
    "radio": ("tests.bench.radio", "fleets that change places over the model of one radio channel"),
    "law": (
        "tests.bench.peers.bench",
        "the law beside other methods, and without each of its ideas",
    ),
    "open": (
        "tests.bench.open_benchmark",
        "the leaderboard of the open benchmark, from what --suite open has kept",
    ),
    "worst-case": ("tests.bench.worst_case", "search the settings in which vehicles come nearest"),
    "wind": ("tests.bench.wind", "winds, gusts, fleets and seeds: what comes of a mission in each"),
    "digest": (
        "tests.bench.digest",
        "digests of 600 repeatable flights: whether a change has changed one",
    ),
    "blind": (
        "tests.bench.blind",
        "fleets that lose their poses at any moment, in lockstep",
    ),
    "faults": (
        "tests.bench.faults",
        "the fault suite over missions, heights, wind and fleet sizes, and pairs of faults",
    ),
    "page": (
        "tests.bench.live_page",
        "serve the live page of circling vehicles, for its picture",
    ),
    "incidents": (
        "tests.bench.incidents",
        "ten planted incidents, and whether covey incident names their cause first",
    ),
    "receivers": (
        "tests.bench.receivers",
        "receivers of satellites as they are and late: what is noticed, and how near it gets",
    ),
    "law-map": (
        "tests.bench.law_map",
        "the page, the picture and the summary of a map that was flown",
    ),
}


def main(words: list[str]) -> int:
    """Run the benchmark that the first word names; the exit status."""
    if not words or words[0] not in BENCHMARKS:
        width = max(map(len, BENCHMARKS))
        print('usage: make bench-NAME [ARGS="..."]; make bench-NAME ARGS=--help says more.')
        print("\n".join(f"  {name:<{width}}  {text}" for name, (_, text) in BENCHMARKS.items()))
        return 0 if words[:1] == ["--help"] else 2
    try:
        return int(importlib.import_module(BENCHMARKS[words[0]][0]).main(words[1:]))
    except ConfigError as error:
        print(f"bench-{words[0]}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
