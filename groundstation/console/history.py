"""Memory of a flight, bounded: trails, closest pairs, batteries, timing. Pure."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.pair_separation import separations_m

TRAIL_LENGTH, _LEAST_TRAIL, _ALL_TRAILS = 600, 80, 12_000  # points of one, and of all together
CHART_LENGTH = 3000
PAIRS = 40
FAR_M = 1e6
_TRAIL_STEP_M = 0.03
_PACE_NS = 150_000_000
_SLOW_S = 1.0  # between samples of what changes slowly
_BATTERY_SAMPLES = 180
_TREND_S = 20.0  # a trend of less than this is a guess
_REFILLED_FRAC = 0.03


@dataclass(frozen=True, slots=True)
class ClosePair:
    """Two vehicles and their separation."""

    first: str
    second: str
    distance_m: float
    approach_s: float  # until they are closest at their present velocities; inf when they part
    approach_m: float  # their distance then
    is_flying: bool  # at least one of them


@dataclass(frozen=True, slots=True)
class Drain:
    """Trend of a battery."""

    per_min_frac: float  # of its charge; negative while it falls
    left_min: float  # minutes until the vehicle has to land


class History:
    """Takes in the fleet eight times a second; distances every other time.

    Args:
        land_frac: charge of a battery at which its vehicle has to land.
    """

    def __init__(self, land_frac: float = 0.2) -> None:
        # name -> (n, 2): last x, y [m] ENU, in no order, first nan
        self.trails: dict[str, NDArray[np.float64]] = {}
        self.pairs: list[ClosePair] = []  # the closest now, those with a vehicle in the air first
        # [s], [m] of the closest flying pair
        self.distances: deque[tuple[float, float]] = deque(maxlen=CHART_LENGTH)
        self.periods_ms: deque[float] = deque(maxlen=600)  # of the slowest control loop
        self.ages_ms: deque[float] = deque(maxlen=600)  # of the oldest message between agents
        self.slowest = self.oldest = ""  # vehicles that these last values are of
        self.drains: dict[str, Drain] = {}
        self.first_flight_s: float | None = None
        self._land_frac = land_frac
        # points of a trail so far, and the last one
        self._ends: dict[str, tuple[int, float, float]] = {}
        # boot, and charges with their times
        self._charges: dict[str, tuple[int, deque[tuple[float, float]]]] = {}
        self._sampled_s = -math.inf
        self._added_ns, self._compared_ns = -1, -_PACE_NS

    @property
    def now(self) -> ClosePair | None:
        """Return the closest pair now."""
        return self.pairs[0] if self.pairs else None

    def clear(self) -> None:
        """Forget everything: a replay was turned back."""
        vars(self).update(vars(History(self._land_frac)))

    def add(self, state: FleetState, now_ns: int) -> None:
        """Take in the fleet as it is now; the same moment again changes nothing."""
        if now_ns == self._added_ns:
            return
        self._added_ns = now_ns
        now_s = now_ns * 1e-9
        positions = {name: view.position_enu_m(now_ns) for name, view in state.vehicles.items()}
        known = {
            name: xyz
            for name, xyz in positions.items()
            if xyz and all(abs(axis) < FAR_M for axis in xyz)
        }
        for gone in self.trails.keys() - state.vehicles.keys():
            del self.trails[gone], self._ends[gone]
        length = max(_LEAST_TRAIL, min(TRAIL_LENGTH, _ALL_TRAILS // max(1, len(positions))))
        for name, position in known.items():
            self._lengthen(name, position[0], position[1], length)
        if abs(now_ns - self._compared_ns) < _PACE_NS:
            return
        self._compared_ns = now_ns
        self.pairs = closest_pairs(
            [(state.vehicles[name], position) for name, position in known.items()],
            height_share=state.height_share,
        )
        if state.airborne_names:
            self.first_flight_s = now_s if self.first_flight_s is None else self.first_flight_s
            if self.pairs and self.pairs[0].is_flying:
                self.distances.append((now_s, self.pairs[0].distance_m))
        if now_s - self._sampled_s >= _SLOW_S or now_s < self._sampled_s:
            self._sampled_s = now_s
            self._sample(state, now_ns)

    def _lengthen(self, name: str, x_m: float, y_m: float, length: int) -> None:
        count, last_x_m, last_y_m = self._ends.get(name, (0, math.inf, math.inf))
        if math.hypot(x_m - last_x_m, y_m - last_y_m) <= _TRAIL_STEP_M:
            return
        if name not in self.trails:
            self.trails[name] = np.full((length, 2), np.nan)
        self.trails[name][count % len(self.trails[name])] = x_m, y_m
        self._ends[name] = count + 1, x_m, y_m

    def _sample(self, state: FleetState, now_ns: int) -> None:
        period_ms, age_ms = math.nan, math.nan
        for name, view in state.vehicles.items():
            last = view.telemetry
            if last is None or not view.is_fresh(now_ns):
                continue
            if math.isfinite(last.loop_period_p99_ms) and not last.loop_period_p99_ms <= period_ms:
                period_ms, self.slowest = last.loop_period_p99_ms, name
            if math.isfinite(last.neighbour_age_s) and not last.neighbour_age_s * 1e3 <= age_ms:
                age_ms, self.oldest = last.neighbour_age_s * 1e3, name
            if math.isfinite(last.battery_frac) and last.battery_frac >= 0.0:
                self._add_charge(name, last.boot_id, now_ns * 1e-9, last.battery_frac)
        self.periods_ms.append(period_ms)
        self.ages_ms.append(age_ms)

    def _add_charge(self, name: str, boot_id: int, now_s: float, charge_frac: float) -> None:
        boot, samples = self._charges.get(name, (boot_id, deque(maxlen=_BATTERY_SAMPLES)))
        if boot != boot_id or (samples and charge_frac > samples[-1][1] + _REFILLED_FRAC):
            samples = deque(maxlen=_BATTERY_SAMPLES)  # the agent or the battery was changed
        samples.append((now_s, charge_frac))
        self._charges[name] = boot_id, samples
        self.drains.pop(name, None)
        if samples[-1][0] - samples[0][0] < _TREND_S:
            return
        times_s, charges = np.array(samples).T
        times_s = times_s - times_s.mean()
        per_min = 60.0 * float(times_s @ (charges - charges.mean()) / (times_s @ times_s))
        left_min = (
            max(0.0, charge_frac - self._land_frac) / -per_min if per_min < -1e-4 else math.inf
        )
        self.drains[name] = Drain(per_min, left_min)


def closest_pairs(
    known: list[tuple[VehicleView, tuple[float, float, float]]],
    most: int = PAIRS,
    *,
    height_share: float = 0.0,
) -> list[ClosePair]:
    """Return the closest pairs of vehicles, pairs with one in the air before all others.

    Args:
        known: views and positions [m], ENU.
        most: number of pairs.
        height_share: what a metre of height counts in a separation.
    """
    if len(known) < 2:
        return []
    points = np.array([position for _, position in known])
    speeds = np.array(
        [
            view.telemetry.velocity_enu_m_s if view.telemetry else (0.0, 0.0, 0.0)
            for view, _ in known
        ]
    )
    flies = np.array([view.is_airborne for view, _ in known])
    one, two = _pairs_of(len(known))
    gap = points[two] - points[one]
    distance = separations_m(gap, height_share)
    any_flies = flies[one] | flies[two]
    rank = np.where(any_flies, distance, distance + FAR_M * 4)
    least = np.argpartition(rank, most)[:most] if len(rank) > most else np.arange(len(rank))
    pairs = []
    for index in least[np.argsort(rank[least], kind="stable")].tolist():
        drift = speeds[two[index]] - speeds[one[index]]
        speed_2 = float(drift[:2] @ drift[:2])
        approach_s = (
            -float(gap[index, :2] @ drift[:2]) / speed_2 if 1e-4 < speed_2 < FAR_M else -1.0
        )
        is_closing = approach_s > 0.0
        ahead = gap[index] + (approach_s * drift if is_closing else 0.0)
        pairs.append(
            ClosePair(
                known[one[index]][0].name,
                known[two[index]][0].name,
                float(distance[index]),
                approach_s if is_closing else math.inf,
                float(separations_m(ahead, height_share)),
                bool(any_flies[index]),
            )
        )
    return pairs


@lru_cache(4)
def _pairs_of(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and the second index of every pair of ``count`` vehicles."""
    return np.triu_indices(count, 1)
