"""The flights of a campaign, split into chunks that several processes fly.

The sizes of the chunks and the number of processes do not change a digit of the results.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from pathlib import Path

from sitl.monte_carlo import flight_plans, results, worlds
from sitl.monte_carlo.batch_flight import fly
from sitl.monte_carlo.campaign_settings import Setup
from sitl.worker_pool import worker_pool

# most vehicles in a chunk: enough to make interpreter overhead negligible, and few enough for the
# processor's caches
CHUNK_VEHICLES = 768
_CHUNK_LINKS = 60_000  # most radio links (vehicles squared) in a chunk


def campaign(
    subjects: Sequence[flight_plans.Subject],
    seeds: Sequence[int],
    setup: Setup,
    *,
    jobs: int = 1,
    physics: str = worlds.DEFAULT,
    trace_folder: Path | None = None,
) -> Iterator[list[results.FlightRecord]]:
    """Yield the records of all subjects and seeds in their order, each chunk when it is ready.

    Args:
        subjects: scenarios by name, or scenes.
        seeds: the seeds, each of which flies every subject.
        setup: the settings of all flights.
        jobs: number of processes.
        physics: name of the physics, of :data:`sitl.monte_carlo.worlds.WORLDS`.
        trace_folder: folder for a trace of each flight; None writes none.

    Raises:
        ConfigError: a process has ended before its time.
    """
    chunks = []
    for subject in subjects:
        for part in _parts(seeds, flight_plans.vehicle_count(subject), jobs):
            chunks.append((subject, part, setup, physics, trace_folder))

    if jobs == 1 or len(chunks) == 1:
        yield from map(_fly_chunk, chunks)
        return

    with worker_pool(min(jobs, len(chunks))) as pool:
        yield from pool.map(_fly_chunk, chunks)


def _parts(seeds: Sequence[int], count: int, jobs: int) -> list[Sequence[int]]:
    """Return the seeds split into chunks, for flights of ``count`` vehicles."""
    per_job = math.ceil(len(seeds) / jobs)
    by_vehicles = CHUNK_VEHICLES // count
    by_links = _CHUNK_LINKS // (count * count)
    size = max(1, min(by_vehicles, by_links, per_job))
    return [seeds[first : first + size] for first in range(0, len(seeds), size)]


def _fly_chunk(
    chunk: tuple[flight_plans.Subject, Sequence[int], Setup, str, Path | None],
) -> list[results.FlightRecord]:
    subject, seeds, setup, physics, trace_folder = chunk
    plans = [flight_plans.plan(subject, seed, scale=setup.scale) for seed in seeds]
    with redirect_stdout(sys.stderr):  # where an own law may print
        flown = fly(plans, setup, physics=physics, has_trace=trace_folder is not None)
    if trace_folder is not None:
        for flight in flown:
            results.write_trace(trace_folder, flight, setup)
    return [results.record(flight, setup) for flight in flown]
