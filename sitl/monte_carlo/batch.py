"""Flights in chunks over several processes; neither the chunks nor the processes change a digit of
the results.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from sitl.monte_carlo import results, scenarios
from sitl.monte_carlo.flight import fly
from sitl.monte_carlo.settings import Setup

CHUNK_VEHICLES = 768  # wide enough to outweigh the interpreter, small enough for the caches
_CHUNK_LINKS = 60_000


def campaign(
    names: Sequence[str],
    seeds: Sequence[int],
    setup: Setup,
    *,
    jobs: int = 1,
    trace_folder: Path | None = None,
) -> Iterator[list[results.Record]]:
    """Records of all scenarios and seeds in their order, chunk by chunk as they are ready.

    Args:
        trace_folder: where to write a trace of each flight.
    """
    chunks = [
        (name, part, setup, trace_folder)
        for name in names
        for part in _parts(seeds, scenarios.vehicle_count(name), jobs)
    ]
    if jobs == 1 or len(chunks) == 1:
        yield from map(_fly_chunk, chunks)
        return
    with ProcessPoolExecutor(
        min(jobs, len(chunks)), mp_context=multiprocessing.get_context("spawn")
    ) as pool:
        try:
            yield from pool.map(_fly_chunk, chunks)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _parts(seeds: Sequence[int], count: int, jobs: int) -> list[Sequence[int]]:
    size = max(
        1, min(CHUNK_VEHICLES // count, _CHUNK_LINKS // (count * count), -(-len(seeds) // jobs))
    )
    return [seeds[k : k + size] for k in range(0, len(seeds), size)]


def _fly_chunk(chunk: tuple[str, Sequence[int], Setup, Path | None]) -> list[results.Record]:
    name, seeds, setup, folder = chunk
    plans = [scenarios.plan(name, seed, scale=setup.scale) for seed in seeds]
    flown = fly(plans, setup, has_trace=folder is not None)
    if folder is not None:
        for flight in flown:
            results.write_trace(folder, flight, setup)
    return [results.record(flight, setup) for flight in flown]
