"""Processor time that fences to stay in add to one tick of one vehicle, as an agent computes it.

A field of twenty corners, flown in its middle and along its edge, against the same fleet without
it: the pipeline with the law, and the failsafes' look at where the vehicle is. The share is of the
20 ms that a tick has, and of the tick's own processor time.

python -m tests.bench.fence [--rounds 50] [--corners 20]
"""

from __future__ import annotations

import argparse
import math
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

from onboard.avoidance.params import still
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.config.flight_space import flight_space_of
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.estimation import kalman
from onboard.safety.geofence import fence_of
from onboard.types import Goal
from onboard.vectors import ZERO_3, Vec3
from tests.bench.tick import LEVEL

TICK_S = 0.02
_RADIUS_M = 60.0
_BESIDE_M = 0.3
_TICKS = 100  # of a mean; the shortest mean is told


def field(corners: int) -> FleetConfig:
    """Return the paper's fleet in a field of so many corners that has a bay; 0: without a field."""
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fleet"]["geofence_m"] = {"x": [-80.0, 80.0], "y": [-80.0, 80.0], "z": [0.0, 30.0]}
    if corners:
        angles = [2.0 * math.pi * corner / corners for corner in range(corners)]
        radii_m = [_RADIUS_M if corner != 3 else 0.6 * _RADIUS_M for corner in range(corners)]
        polygon = [
            [radius_m * math.cos(angle), radius_m * math.sin(angle)]
            for angle, radius_m in zip(angles, radii_m, strict=True)
        ]
        data["fences"] = [{"name": "field", "keep": "in", "polygon_enu_m": polygon}]
    return fleet_from_mapping(data)


class Case:
    """One fleet flown at one place, a hundred ticks at a time."""

    def __init__(self, fleet: FleetConfig, x_m: float) -> None:
        position = Vec3(x_m, 0.0, 1.0)
        filter_params = kalman.KalmanParams()
        own = kalman.initial(position, filter_params)
        own = kalman.drive(own, LEVEL, 0.5, 0.5, filter_params, TICK_S, False)
        own = kalman.correct(own, position, TICK_S, filter_params)

        self.shortest_s = math.inf  # of the means of a hundred ticks
        self._state = kalman.state(own, 0.0, 0.0, 0.0)
        self._goal = Goal(position, 0.0, 1)
        self._params = pipeline.pipeline_params(fleet, "mav0")
        self._still = still(fleet)
        self._areas = flight_space_of(fleet).areas
        self._fence = fence_of(fleet.fleet.geofence_m, fleet.vehicles["mav0"])

    def fly(self) -> None:
        """Fly a hundred ticks, and keep their mean if it is the shortest."""
        position = self._state.position_enu_m
        memory = pipeline.initial(self._params, position)
        begin_s = time.process_time()
        for _ in range(_TICKS):
            memory, _ = pipeline.step(
                memory,
                self._state,
                self._goal,
                (),
                self._still,
                ControlMode.FLYING,
                self._params,
                TICK_S,
            )
            if self._areas:
                self._fence.status_in(self._areas, position, ZERO_3)
            else:
                self._fence.status(position, ZERO_3)
        self.shortest_s = min(self.shortest_s, (time.process_time() - begin_s) / _TICKS)


def costs_s(corners: int, rounds: int) -> tuple[float, float, float]:
    """Return the time of a tick without a field, in the middle of one, and beside its edge.

    Args:
        corners: of the field.
        rounds: of a hundred ticks each; all three take turns, so that a busy machine is fair.
    """
    fenced = field(corners)
    cases = (Case(field(0), 0.0), Case(fenced, 0.0), Case(fenced, _BESIDE_M - _RADIUS_M))
    for _ in range(rounds):
        for case in cases:
            case.fly()
    without, middle, beside = cases
    return without.shortest_s, middle.shortest_s, beside.shortest_s


def main(argv: Sequence[str] | None = None) -> int:
    """Print the time of a tick without a field, in its middle and beside its edge."""
    parser = argparse.ArgumentParser(
        prog="make bench-fence",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--corners", type=int, default=20)
    options = parser.parse_args(argv)

    without_s, middle_s, beside_s = costs_s(options.corners, options.rounds)
    print(f"without: {1e3 * without_s:.3f} ms")
    for where, fenced_s in (("in the middle", middle_s), (f"{_BESIDE_M} m from it", beside_s)):
        more_s = fenced_s - without_s
        print(
            f"{options.corners} corners, {where}: {1e6 * more_s:+.1f} us, "
            f"{100.0 * more_s / TICK_S:.3f} % of a tick's 20 ms, "
            f"{100.0 * more_s / without_s:.1f} % of its processor time"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
