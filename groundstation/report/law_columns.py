"""Packs the law's half-planes for a report: for each vehicle, that of the neighbour it avoids."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from groundstation.recording.law_rows import RecordedLaw
from groundstation.recording.recorded_flight import Flight, VehicleFlight
from groundstation.report.columns import Column, packed
from onboard.arrays import Array, IntArray

MIN_M_S2 = 0.15  # weaker interventions are not drawn
MAX_ROWS = 8_000  # most half-planes of all vehicles; with more, one stands for several samples
# steps to which the report rounds
_ANGLE_RAD = 0.001
_ACCELERATION_M_S2 = 0.005


def law_columns(flight: Flight, grid_s: Array, max_gap_s: float) -> Iterator[Column]:
    """Yield direction and bound of each vehicle's half-plane; vehicles without any are left out.

    Args:
        flight: the flight.
        grid_s: times of the report.
        max_gap_s: largest age of a tick that is still shown.
    """
    law = RecordedLaw(flight)
    interventions = {
        name: _samples(vehicle, grid_s, max_gap_s) for name, vehicle in flight.vehicles.items()
    }
    count = sum(samples.size for samples, _ in interventions.values())
    samples_per_row = max(1, math.ceil(count / MAX_ROWS))

    for number, (name, (samples, ticks)) in enumerate(interventions.items()):
        directions_rad = np.full(grid_s.size, np.nan)
        bounds_m_s2 = np.full(grid_s.size, np.nan)
        for begin in range(0, samples.size, samples_per_row):
            row = law.row(name, int(ticks[begin]))
            if row is not None:
                covered = samples[begin : begin + samples_per_row]
                directions_rad[covered] = math.atan2(row.normal.y, row.normal.x)
                bounds_m_s2[covered] = row.bound_m_s2
        if np.isfinite(bounds_m_s2).any():
            yield packed(f"{number}/row_direction", directions_rad, _ANGLE_RAD)
            yield packed(f"{number}/row_bound", bounds_m_s2, _ACCELERATION_M_S2)


def _samples(vehicle: VehicleFlight, grid_s: Array, max_gap_s: float) -> tuple[IntArray, IntArray]:
    """Return indices of the report's samples that have a half-plane, and of their ticks."""
    ticks = vehicle.ticks
    if not ticks.size:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)

    before = np.searchsorted(ticks.time_s, grid_s, side="right") - 1  # tick; -1 if there is none
    is_known = (before >= 0) & (grid_s - ticks.time_s[before] <= max_gap_s)
    avoids_somebody = ticks.avoided[before] >= 0.0  # the neighbour's number; -1: nobody
    intervenes = (ticks.intervention_m_s2[before] >= MIN_M_S2) & avoids_somebody
    samples = np.flatnonzero(is_known & intervenes)
    return samples, before[samples]
