"""The console's memory of a flight: trails, closest pairs, batteries, timing. Pure.

Its size is bounded. The app passes the fleet's state to :meth:`History.add` at every refresh, and
the panels draw what the history holds.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.pair_separation import separations_m

TRAIL_LENGTH = 600  # most points of one vehicle's trail
_MIN_TRAIL = 80  # the trail of a vehicle in a large fleet
_ALL_TRAILS = 12_000  # points of all trails together; each trail still gets at least its minimum
_TRAIL_STEP_M = 0.03  # smallest distance between two points of a trail

CHART_LENGTH = 3000  # number of smallest distances that are kept
_TIMING_LENGTH = 600  # number of periods and of ages that are kept
PAIRS = 40  # number of closest pairs that are kept
FAR_M = 1e6  # a coordinate beyond this is not plausible
# Squares of the relative speeds below which two vehicles count as still, and beyond which the speed
# is not plausible.
_STILL_M2_S2 = 0.05**2  # two hovering vehicles move more slowly relative to each other
_LARGEST_M2_S2 = 1e6

_PACE_NS = 150_000_000  # time between two comparisons of all pairs
_SLOW_S = 1.0  # time between two samples of values that change slowly
_BATTERY_SAMPLES = 180
_TREND_S = 20.0  # shortest time from which a trend is computed
_REFILLED_FRAC = 0.03  # a charge that rises by more is the charge of another battery
_FALLING_PER_MIN = -1e-4  # trend of a charge below which the battery counts as falling


@dataclass(frozen=True, slots=True)
class ClosePair:
    """Two vehicles and their separation."""

    first: str
    second: str
    distance_m: float
    # time until they are closest at their velocities; inf if they move apart, NaN if they hover
    approach_s: float
    approach_m: float  # their distance at that time
    is_flying: bool  # whether at least one of them flies


class _Drained(NamedTuple):
    """What drains a battery; a trend counts only while it stays the same."""

    boot_id: int  # of the vehicle's agent
    is_airborne: bool


@dataclass(frozen=True, slots=True)
class Drain:
    """Trend of a battery."""

    per_min_frac: float  # change of its charge per minute; negative while it falls
    left_min: float  # minutes until the vehicle has to land


class History:
    """Takes in the fleet's state eight times a second, and compares distances every other time.

    Args:
        land_frac: charge of a battery at which its vehicle has to land.
    """

    def __init__(self, land_frac: float = 0.2) -> None:
        self._land_frac = land_frac
        self.clear()

    def clear(self) -> None:
        """Forget everything, as at the start and after a replay has jumped back."""
        # name -> last positions x, y [m] ENU (n, 2), in no order; unused rows are NaN
        self.trails: dict[str, NDArray[np.float64]] = {}
        self.pairs: list[ClosePair] = []  # the closest pairs now; those in the air come first
        # time [s] and distance [m] of the closest flying pair
        self.distances: deque[tuple[float, float]] = deque(maxlen=CHART_LENGTH)
        self.periods_ms: deque[float] = deque(maxlen=_TIMING_LENGTH)  # period of the slowest loop
        self.ages_ms: deque[float] = deque(maxlen=_TIMING_LENGTH)  # age of the oldest message
        self.slowest = ""  # vehicle with the newest of these periods
        self.oldest = ""  # vehicle with the newest of these ages
        self.drains: dict[str, Drain] = {}

        # times [s] at which the present flight, or else the last one, began and ended
        self._flight_begin_s: float | None = None
        self._flight_end_s: float | None = None

        # name -> number of points of its trail so far, and x, y [m] of the last point
        self._ends: dict[str, tuple[int, float, float]] = {}
        # name -> what drains its battery, and times [s] with charges
        self._charges: dict[str, tuple[_Drained, deque[tuple[float, float]]]] = {}
        self._sampled_s = -math.inf
        self._added_ns = -1
        self._compared_ns = -_PACE_NS

    @property
    def closest_now(self) -> ClosePair | None:
        """The closest pair now; None if no pair is known."""
        return self.pairs[0] if self.pairs else None

    def flight_s(self, now_ns: int) -> float | None:
        """Return the duration of the present flight, or of the last one.

        A flight begins when the first vehicle is in the air, and ends when the last one is down.

        Args:
            now_ns: time, as for :meth:`add`.

        Returns:
            Duration [s]; None if no vehicle has flown.
        """
        if self._flight_begin_s is None:
            return None
        end_s = now_ns * 1e-9 if self._flight_end_s is None else self._flight_end_s
        return max(0.0, end_s - self._flight_begin_s)

    def add(self, state: FleetState, now_ns: int) -> None:
        """Take in the present state of the fleet; a second call at the same time has no effect."""
        if now_ns == self._added_ns:
            return
        self._added_ns = now_ns

        known: dict[str, tuple[float, float, float]] = {}
        for name, view in state.vehicles.items():
            position = view.position_enu_m(now_ns)
            if position and all(abs(axis) < FAR_M for axis in position):
                known[name] = position

        self._lengthen_trails(state, known)
        if abs(now_ns - self._compared_ns) >= _PACE_NS:
            self._compared_ns = now_ns
            self._compare(state, known, now_ns * 1e-9)
            self._sample_if_due(state, now_ns)

    def _lengthen_trails(
        self, state: FleetState, known: dict[str, tuple[float, float, float]]
    ) -> None:
        for name in self.trails.keys() - state.vehicles.keys():
            del self.trails[name], self._ends[name]

        fair_share = _ALL_TRAILS // max(1, len(state.vehicles))
        length = max(_MIN_TRAIL, min(TRAIL_LENGTH, fair_share))
        for name, (x_m, y_m, _) in known.items():
            self._lengthen(name, x_m, y_m, length)

    def _lengthen(self, name: str, x_m: float, y_m: float, length: int) -> None:
        count, last_x_m, last_y_m = self._ends.get(name, (0, math.inf, math.inf))
        if math.hypot(x_m - last_x_m, y_m - last_y_m) <= _TRAIL_STEP_M:
            return

        if name not in self.trails:
            self.trails[name] = np.full((length, 2), np.nan)
        trail = self.trails[name]
        trail[count % len(trail)] = x_m, y_m
        self._ends[name] = count + 1, x_m, y_m

    def _compare(
        self, state: FleetState, known: dict[str, tuple[float, float, float]], now_s: float
    ) -> None:
        views = [(state.vehicles[name], position) for name, position in known.items()]
        self.pairs = closest_pairs(views, height_share=state.height_share)

        if state.airborne_names:
            if self._flight_begin_s is None or self._flight_end_s is not None:
                self._flight_begin_s = now_s
                self._flight_end_s = None
            closest = self.closest_now
            if closest is not None and closest.is_flying:
                self.distances.append((now_s, closest.distance_m))
        elif self._flight_begin_s is not None and self._flight_end_s is None:
            self._flight_end_s = now_s

    def _sample_if_due(self, state: FleetState, now_ns: int) -> None:
        now_s = now_ns * 1e-9
        if now_s - self._sampled_s >= _SLOW_S or now_s < self._sampled_s:
            self._sampled_s = now_s
            self._sample(state, now_ns)

    def _sample(self, state: FleetState, now_ns: int) -> None:
        """Note the slowest loop, the oldest message and all charges."""
        # vehicle -> what it has reported
        periods_ms: dict[str, float] = {}
        ages_ms: dict[str, float] = {}
        for name, view in state.vehicles.items():
            telemetry = view.telemetry
            if telemetry is None or not view.is_fresh(now_ns):
                continue

            if math.isfinite(telemetry.loop_period_p99_ms):
                periods_ms[name] = telemetry.loop_period_p99_ms
            if math.isfinite(telemetry.neighbour_age_s):
                ages_ms[name] = telemetry.neighbour_age_s * 1e3
            if math.isfinite(telemetry.battery_frac) and telemetry.battery_frac >= 0.0:
                by = _Drained(telemetry.boot_id, view.is_airborne)
                self._add_charge(name, by, now_ns * 1e-9, telemetry.battery_frac)

        if periods_ms:
            self.slowest = max(periods_ms, key=lambda name: periods_ms[name])
        if ages_ms:
            self.oldest = max(ages_ms, key=lambda name: ages_ms[name])
        self.periods_ms.append(max(periods_ms.values(), default=math.nan))
        self.ages_ms.append(max(ages_ms.values(), default=math.nan))

    def _add_charge(self, name: str, by: _Drained, now_s: float, charge_frac: float) -> None:
        before, samples = self._charges.get(name, (by, deque(maxlen=_BATTERY_SAMPLES)))
        _, last_frac = samples[-1] if samples else (now_s, charge_frac)
        if before != by or charge_frac > last_frac + _REFILLED_FRAC:
            samples = deque(maxlen=_BATTERY_SAMPLES)  # another load, or another battery
        samples.append((now_s, charge_frac))
        self._charges[name] = by, samples

        self.drains.pop(name, None)
        first_s, _ = samples[0]
        if now_s - first_s < _TREND_S:
            return

        # The slope of the straight line through the samples (least squares).
        times_s, charges = np.array(samples).T
        times_s = times_s - times_s.mean()
        per_min_frac = 60.0 * float(times_s @ (charges - charges.mean()) / (times_s @ times_s))

        left_min = math.inf
        if per_min_frac < _FALLING_PER_MIN:
            left_min = max(0.0, charge_frac - self._land_frac) / -per_min_frac
        self.drains[name] = Drain(per_min_frac, left_min)


def closest_pairs(
    known: list[tuple[VehicleView, tuple[float, float, float]]],
    most: int = PAIRS,
    *,
    height_share: float = 0.0,
) -> list[ClosePair]:
    """Return the closest pairs of vehicles; pairs with a vehicle in the air come first.

    Args:
        known: view and position [m], ENU, of each vehicle with a known position.
        most: number of pairs.
        height_share: weight of a metre of height in a separation.
    """
    if len(known) < 2:
        return []

    names = [view.name for view, _ in known]
    positions_m = np.array([position for _, position in known])
    velocities_m_s = np.array([_velocity_m_s(view) for view, _ in known])
    is_airborne = np.array([view.is_airborne for view, _ in known])

    first, second = _indices_of_pairs(len(known))
    gaps_m = positions_m[second] - positions_m[first]
    distances_m = separations_m(gaps_m, height_share)
    is_flying = is_airborne[first] | is_airborne[second]

    # pairs with a vehicle in the air first, and among these the closest
    sorted_indices = np.lexsort((distances_m, ~is_flying))

    pairs = []
    for index in sorted_indices[:most].tolist():
        relative_m_s = velocities_m_s[second[index]] - velocities_m_s[first[index]]
        approach_s = _approach_s(gaps_m[index], relative_m_s)
        closest_gap_m = gaps_m[index]
        if approach_s > 0.0:
            closest_gap_m = closest_gap_m + approach_s * relative_m_s
        elif approach_s <= 0.0:  # NaN stays: they hover
            approach_s = math.inf  # they move apart

        pair = ClosePair(
            first=names[first[index]],
            second=names[second[index]],
            distance_m=float(distances_m[index]),
            approach_s=approach_s,
            approach_m=float(separations_m(closest_gap_m, height_share)),
            is_flying=bool(is_flying[index]),
        )
        pairs.append(pair)
    return pairs


def _velocity_m_s(view: VehicleView) -> tuple[float, float, float]:
    if view.telemetry is None:
        return 0.0, 0.0, 0.0
    return view.telemetry.velocity_enu_m_s


def _approach_s(gap_m: NDArray[np.float64], relative_m_s: NDArray[np.float64]) -> float:
    """Return the time until two vehicles are closest in the horizontal, by their velocities.

    With p for the gap and v for the relative velocity, the square of the distance at time t is
    |p + t v|^2. It is smallest at t = -p . v / |v|^2.

    Returns:
        The time [s]; negative if they move apart, NaN if their relative speed is nearly 0 or not
        plausible.
    """
    squared_speed_m2_s2 = float(relative_m_s[:2] @ relative_m_s[:2])
    if not _STILL_M2_S2 < squared_speed_m2_s2 < _LARGEST_M2_S2:
        return math.nan
    return -float(gap_m[:2] @ relative_m_s[:2]) / squared_speed_m2_s2


@lru_cache(4)
def _indices_of_pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and the second index of every pair of ``count`` vehicles."""
    return np.triu_indices(count, 1)
