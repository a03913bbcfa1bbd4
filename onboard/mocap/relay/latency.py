"""Lag of a body's stamps behind its motion, and the vehicle of a body: its tilt compared with PX4's
attitude.

PX4 measures with a gyroscope, so its attitude is right in time except for a few milliseconds of
link. Both measure the direction of gravity in the body's own axes, which depends neither on a
heading nor on the frame of the room. The time shift at which both curves fit best is the lag of the
stamps; the body whose curve fits belongs to this PX4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array
from onboard.bus.schema import Vec4

_STEP_S = 0.004
_EARLIEST_S, _LATEST_S = -0.1, 0.3
_SHORTEST_S = 2.0
_SMALLEST_TILT_RAD = 0.008  # half a degree: ten times the noise of a mocap
_FITS = 0.85


@dataclass(frozen=True, slots=True)
class Fit:
    """Best fit of two curves of tilt."""

    lag_s: float  # time shift of the best fit
    correlation: float  # at most 1

    @property
    def is_same(self) -> bool:
        """Whether both belong to one body."""
        return self.correlation >= _FITS


def gravity(quaternions_wxyz: Sequence[Vec4]) -> Array:
    """Return the horizontal components (n, 2) of the vertical, in the body's axes."""
    w, x, y, z = np.array(quaternions_wxyz, dtype=np.float64).reshape(-1, 4).T
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x)], axis=-1)


def fit(body_s: Array, body: Array, px4_s: Array, px4: Array) -> Fit | None:
    """Fit a body's tilt to PX4's.

    Args:
        body_s: times (n,) [s] of the body's samples, rising.
        body: :func:`gravity` (n, 2) at them.
        px4_s: times (m,) [s] of PX4's samples, rising.
        px4: :func:`gravity` (m, 2) at them.
    Returns:
        the best fit; None if there is too little motion.
    """
    if body_s.size < 10 or px4_s.size < 10:
        return None
    begin, end = (
        max(body_s[0] - _EARLIEST_S, px4_s[0] + _LATEST_S),
        min(body_s[-1] - _LATEST_S, px4_s[-1]),
    )
    if end - begin < _SHORTEST_S:
        return None
    times_s = np.arange(begin, end, _STEP_S)
    lags_s = np.arange(_EARLIEST_S, _LATEST_S + 0.5 * _STEP_S, _STEP_S)
    reference = _at(times_s, px4_s, px4)
    if float(np.sqrt(np.square(reference).mean())) < _SMALLEST_TILT_RAD:
        return None
    correlations = np.array(
        [_correlation(_at(times_s + lag_s, body_s, body), reference) for lag_s in lags_s]
    )
    best = int(correlations.argmax())
    return Fit(
        float(lags_s[best]) + _STEP_S * _vertex(correlations, best), float(correlations[best])
    )


def _at(times_s: Array, samples_s: Array, samples: Array) -> Array:
    values = np.stack(
        [np.interp(times_s, samples_s, samples[:, axis]) for axis in range(2)], axis=-1
    )
    # markers are never exactly level with the autopilot
    return np.asarray(values - values.mean(axis=0))


def _correlation(one: Array, other: Array) -> float:
    size = float(np.sqrt(np.square(one).sum() * np.square(other).sum()))
    return float((one * other).sum()) / size if size > 0.0 else 0.0


def _vertex(values: Array, index: int) -> float:
    """Return the offset of the maximum from an index, in steps, by a parabola through three values."""
    if not 0 < index < values.size - 1:
        return 0.0
    before, top, after = values[index - 1 : index + 2].tolist()
    bend = before - 2.0 * top + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0
