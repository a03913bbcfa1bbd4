"""Processor time of one tick of one vehicle: mocap sample to attitude setpoint, as an agent
computes it.

python -m tests.bench.tick [--ticks 2000]
"""

from __future__ import annotations

import argparse
import math
import random
import statistics
import time
from collections.abc import Sequence

from onboard.config.fleet import load_fleet
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.estimation import kalman
from onboard.types import Goal, Neighbour
from onboard.vectors import ZERO_3, Vec3

LEVEL = (1.0, 0.0, 0.0, 0.0)
START = Vec3(0.0, 0.0, 1.0)


def neighbours(count: int, seed: int = 2) -> list[Neighbour]:
    """Vehicles at random within 0.9 to 3 m, slowly moving."""
    rng = random.Random(seed)
    out = []
    for index in range(count):
        angle = rng.uniform(-math.pi, math.pi)
        distance = rng.uniform(0.9, 3.0)
        p = Vec3(distance * math.cos(angle), distance * math.sin(angle), 1.0)
        v = Vec3(rng.gauss(0.0, 0.3), rng.gauss(0.0, 0.3), 0.0)
        u = Vec3(rng.gauss(0.0, 0.5), rng.gauss(0.0, 0.5), 0.0)
        out.append(
            Neighbour(
                position_enu_m=p,
                velocity_enu_m_s=v,
                acceleration_enu_m_s2=ZERO_3,
                predicted_position_enu_m=p,
                predicted_velocity_enu_m_s=v,
                commanded_acceleration_enu_m_s2=u,
                intent_enu_m_s=v,
                age_s=0.04,
                lead_time_s=0.15,
                position_std_m=0.003,
                velocity_std_m_s=0.02,
                crowd_count=1.0,
                is_cooperative=True,
                is_paper_obstacle=False,
                table_index=index,
                radius_m=0.0,
            )
        )
    return out


def tick_times_s(count: int, ticks: int) -> list[float]:
    """Processor time of each tick with ``count`` neighbours, sorted."""
    params = pipeline.pipeline_params(load_fleet("configs/fleets/paper.toml"), "mav0")
    filter_params = kalman.KalmanParams()
    around = neighbours(count)
    own = kalman.initial(START, filter_params)
    memory = pipeline.initial(params, START)
    goal = Goal(Vec3(3.0, 0.0, 1.0), 0.0, 1)
    times_s = []
    for _ in range(ticks):
        begin_s = time.process_time()
        own = kalman.drive(own, LEVEL, 0.5, 0.5, filter_params, 0.02, False)
        own = kalman.correct(own, START, 0.02, filter_params)
        state = kalman.state(own, 0.0, 0.0, 0.0)
        memory, _ = pipeline.step(memory, state, goal, around, (), ControlMode.FLYING, params, 0.02)
        times_s.append(time.process_time() - begin_s)
    return sorted(times_s)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the shortest and the median tick with 0, 2, 6 and 12 neighbours."""
    parser = argparse.ArgumentParser(
        prog="make bench-tick",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--ticks", type=int, default=2000)
    options = parser.parse_args(argv)
    for count in (0, 2, 6, 12):
        times_s = tick_times_s(count, options.ticks)
        shortest_ms = 1e3 * times_s[0]
        median_ms = 1e3 * statistics.median(times_s)
        print(f"{count:2d} neighbours: shortest {shortest_ms:.3f} ms, median {median_ms:.3f} ms")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
