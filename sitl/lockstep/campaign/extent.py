"""The true extent of a flight: where its vehicles were in the air, how high, and how fast."""

from __future__ import annotations

import functools
import math

from groundstation.evidence.volumes import Point, convex_hull
from sitl.lockstep.flight import Lockstep

_SAMPLE_S = 0.1  # time between two samples


class Extent:
    """The positions, heights and speeds of a flight's vehicles; of no flight before ``watch``."""

    def __init__(self) -> None:
        self._outline: tuple[Point, ...] = ()  # convex hull of the positions so far
        self.highest_m = 0.0
        self.fastest_m_s = 0.0  # horizontal
        self.first_airborne_s = math.inf
        self.last_airborne_s = 0.0

    def watch(self, flight: Lockstep) -> None:
        """Sample the truth of a flight ten times a second, from now on."""
        self._sample(flight)

    @property
    def took_off(self) -> bool:
        """Whether any vehicle was in the air."""
        return math.isfinite(self.first_airborne_s)

    @property
    def hull_m(self) -> tuple[Point, ...]:
        """The convex hull of all positions in the air, rounded to centimetres."""
        return tuple((round(east, 2), round(north, 2)) for east, north in self._outline)

    def _sample(self, flight: Lockstep) -> None:
        """Add the present positions and speeds of flying vehicles, and plan the next sample."""
        simulation = flight.simulation
        world = simulation.emulator.world
        positions, velocities, _ = world.truth_enu()
        on_ground = world.vehicles.states.on_ground.tolist()

        positions_m = []
        rows = zip(positions.tolist(), velocities.tolist(), on_ground, strict=True)
        for (east_m, north_m, up_m), (east_m_s, north_m_s, _), is_on_ground in rows:
            if is_on_ground:
                continue
            positions_m.append((east_m, north_m))
            self.highest_m = max(self.highest_m, up_m)
            self.fastest_m_s = max(self.fastest_m_s, math.hypot(east_m_s, north_m_s))

        if positions_m:
            now_s = simulation.time_s
            self.first_airborne_s = min(self.first_airborne_s, now_s)
            self.last_airborne_s = now_s
            self._outline = convex_hull([*self._outline, *positions_m])
        simulation.at(simulation.time_s + _SAMPLE_S, functools.partial(self._sample, flight))
