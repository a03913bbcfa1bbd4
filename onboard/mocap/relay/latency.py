"""By how much a body's stamps lag the motion, and whose body it is: its tilt beside the attitude that PX4 measures.

PX4 measures with a gyroscope, so that its attitude is right in time but for a few milliseconds of link. Both see the
direction of gravity in the body's own axes, which no heading and no frame of the room enters. The shift in time at
which both curves fit best is what the stamps are late; the body whose curve fits is the one that this PX4 sits on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.bus.schema import Vec4

Array = NDArray[np.float64]

_STEP_S = 0.004
_EARLIEST_S, _LATEST_S = -0.1, 0.3
_SHORTEST_S = 2.0
_SMALLEST_TILT_RAD = 0.008  # half a degree: ten times the noise of a mocap
_FITS = 0.85


@dataclass(frozen=True, slots=True)
class Fit:
    """How two curves of tilt fit: at which shift best, and how well (correlation, 1 at most)."""

    lag_s: float
    correlation: float

    @property
    def is_same(self) -> bool:
        """Whether both belong to one body."""
        return self.correlation >= _FITS


def gravity(quaternions_wxyz: Sequence[Vec4]) -> Array:
    """Horizontal components (n, 2) of the vertical, seen in the body's axes."""
    w, x, y, z = np.array(quaternions_wxyz, dtype=np.float64).reshape(-1, 4).T
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x)], axis=-1)


def fit(body_s: Array, body: Array, px4_s: Array, px4: Array) -> Fit | None:
    """Where a body's tilt fits PX4's best; None when there is too little of it to say.

    Args:
        body_s, px4_s: times (n,), (m,) of the samples, rising. body, px4: :func:`gravity` (n, 2), (m, 2) at them.
    """
    if body_s.size < 10 or px4_s.size < 10:
        return None
    begin, end = max(body_s[0] - _EARLIEST_S, px4_s[0] + _LATEST_S), min(body_s[-1] - _LATEST_S, px4_s[-1])
    if end - begin < _SHORTEST_S:
        return None
    times_s = np.arange(begin, end, _STEP_S)
    lags_s = np.arange(_EARLIEST_S, _LATEST_S + 0.5 * _STEP_S, _STEP_S)
    wanted = _at(times_s, px4_s, px4)
    if float(np.sqrt(np.square(wanted).mean())) < _SMALLEST_TILT_RAD:
        return None
    found = np.array([_correlation(_at(times_s + lag_s, body_s, body), wanted) for lag_s in lags_s])
    best = int(found.argmax())
    return Fit(float(lags_s[best]) + _STEP_S * _vertex(found, best), float(found[best]))


def _at(times_s: Array, samples_s: Array, samples: Array) -> Array:
    values = np.stack([np.interp(times_s, samples_s, samples[:, axis]) for axis in range(2)], axis=-1)
    return np.asarray(values - values.mean(axis=0))  # markers are never quite level with the autopilot


def _correlation(one: Array, other: Array) -> float:
    size = float(np.sqrt(np.square(one).sum() * np.square(other).sum()))
    return float((one * other).sum()) / size if size > 0.0 else 0.0


def _vertex(values: Array, place: int) -> float:
    """Where between its neighbours the top lies, in steps, by a parabola."""
    if not 0 < place < values.size - 1:
        return 0.0
    before, top, after = values[place - 1 : place + 2].tolist()
    bend = before - 2.0 * top + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0
