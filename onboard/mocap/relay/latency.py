"""Compares a body's tilt with PX4's, to find the vehicle's body and the lag of its stamps.

PX4 measures with a gyroscope, so its attitude is late only by the link's few milliseconds. Mocap
and PX4 both give the direction of gravity in the body's own axes. This direction does not depend on
a heading or on the frame of the room. If this direction changes over time in the same way for a
body and for PX4, the body belongs to this PX4. The time shift at which the two curves fit best is
the lag of the stamps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array
from onboard.tuples import Wxyz

_STEP_S = 0.004  # time between two samples of a curve, and between two candidate lags
_EARLIEST_S = -0.1  # smallest candidate lag
_LATEST_S = 0.3  # largest candidate lag
_SHORTEST_S = 2.0  # both curves must overlap for at least this time
_FEWEST_SAMPLES = 10  # least number of samples of each curve
_SMALLEST_TILT_RAD = 0.008  # half a degree, which is ten times the noise of a mocap
_SAME_CORRELATION = 0.85  # least correlation of two curves of the same body


@dataclass(frozen=True, slots=True)
class TiltFit:
    """Best fit of a body's tilt to PX4's tilt."""

    lag_s: float  # time by which the body's stamps are later than PX4's
    correlation: float  # at most 1

    @property
    def is_same(self) -> bool:
        """Whether the body belongs to this PX4."""
        return self.correlation >= _SAME_CORRELATION


def gravity(quaternions_wxyz: Sequence[Wxyz]) -> Array:
    """Return the components (n, 2) of the vertical along the body's x and y axes."""
    w, x, y, z = np.array(quaternions_wxyz, dtype=np.float64).reshape(-1, 4).T
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x)], axis=-1)


def fit(body_s: Array, body: Array, px4_s: Array, px4: Array) -> TiltFit | None:
    """Fit a body's tilt to PX4's.

    Args:
        body_s: times (n,) [s] of the body's samples, increasing.
        body: :func:`gravity` (n, 2) at those times.
        px4_s: times (m,) [s] of PX4's samples, increasing.
        px4: :func:`gravity` (m, 2) at those times.
    Returns:
        the best fit; None if there are too few samples or too little motion.
    """
    if body_s.size < _FEWEST_SAMPLES or px4_s.size < _FEWEST_SAMPLES:
        return None

    # the time span in which both curves have samples, for every candidate lag
    begin_s = max(body_s.min() - _EARLIEST_S, px4_s.min() + _LATEST_S)
    end_s = min(body_s.max() - _LATEST_S, px4_s.max())
    if end_s - begin_s < _SHORTEST_S:
        return None

    times_s = np.arange(begin_s, end_s, _STEP_S)
    reference = _at(times_s, px4_s, px4)
    tilt_rad = float(np.sqrt(np.square(reference).mean()))
    if tilt_rad < _SMALLEST_TILT_RAD:
        return None

    lags_s = np.arange(_EARLIEST_S, _LATEST_S + 0.5 * _STEP_S, _STEP_S)
    correlations = np.empty_like(lags_s)
    for index, lag_s in enumerate(lags_s):
        shifted = _at(times_s + lag_s, body_s, body)
        correlations[index] = _correlation(shifted, reference)

    best = int(correlations.argmax())
    lag_s = float(lags_s[best]) + _STEP_S * _vertex(correlations, best)
    return TiltFit(lag_s, float(correlations[best]))


def _at(times_s: Array, samples_s: Array, samples: Array) -> Array:
    """Return a curve interpolated at other times, with its mean subtracted."""
    columns = [np.interp(times_s, samples_s, samples[:, axis]) for axis in range(2)]
    values = np.stack(columns, axis=-1)
    # the mean only shows that the markers are not mounted exactly level with the autopilot
    return np.asarray(values - values.mean(axis=0))


def _correlation(one: Array, other: Array) -> float:
    """Return the correlation of two curves whose means are zero; 0 if a curve is all zeros."""
    norm = float(np.sqrt(np.square(one).sum() * np.square(other).sum()))
    if norm <= 0.0:
        return 0.0
    return float((one * other).sum()) / norm


def _vertex(values: Array, index: int) -> float:
    """Return by how many steps the true maximum lies after ``index``, the index of the largest
    value.

    The true maximum is taken from the parabola through the largest value and its two neighbours.
    """
    if not 0 < index < values.size - 1:
        return 0.0
    before, top, after = values[index - 1 : index + 2].tolist()
    bend = before - 2.0 * top + after
    if bend >= 0.0:  # no maximum
        return 0.0
    offset: float = 0.5 * (before - after) / bend
    return offset
