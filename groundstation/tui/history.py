"""What the console remembers of a flight: trails and the closest distance over time, bounded. Pure."""

from __future__ import annotations

import math
from collections import deque

from groundstation.fleet import FleetState, Separation

TRAIL_LENGTH = 900
CHART_LENGTH = 3000
_TRAIL_STEP_M = 0.03
_FAR_M = 1e6


class History:
    """Trails per vehicle (x, y in metres ENU) and (time in s, closest distance in m) while anybody flies."""

    def __init__(self) -> None:
        self.trails: dict[str, deque[tuple[float, float]]] = {}
        self.distances: deque[tuple[float, float]] = deque(maxlen=CHART_LENGTH)
        self.now: Separation | None = None
        self.first_flight_s: float | None = None

    def add(self, state: FleetState, now_ns: int) -> None:
        """Take in the fleet as it is now."""
        for name, view in state.vehicles.items():
            spot = view.position_enu_m(now_ns)
            if spot is None or not all(abs(axis) < _FAR_M for axis in spot):  # false for what is no number, too
                continue
            trail = self.trails.setdefault(name, deque(maxlen=TRAIL_LENGTH))
            if not trail or math.dist(trail[-1], spot[:2]) > _TRAIL_STEP_M:
                trail.append((spot[0], spot[1]))
        self.now = state.closest(now_ns)
        if state.airborne_names and self.first_flight_s is None:
            self.first_flight_s = now_ns * 1e-9
        if state.airborne_names and self.now is not None and math.isfinite(self.now.distance_m):
            self.distances.append((now_ns * 1e-9, self.now.distance_m))
