"""Puts a log of PX4 on the clock of a flight's record, by how the vehicle tilted. Pure.

PX4 counts time since its start, the record since its own begin, and nobody wrote down which is
which. But both have the attitude: what PX4 logged, and what the agent got of it by telemetry. Roll
and pitch of the two are shifted against each other until they fit: first the cross-correlation says
where, on a grid, then the smallest difference says it finely. The heading is left out: PX4's and
the fleet's frame may differ by a turn.

The two clocks also run at slightly different rates, by some 20 to 100 parts in a million: 30 ms at
either end of ten minutes. So where the two overlap for long, the offset of the first half and that
of the second are found apart, and the log is stretched by what they differ.

A hover has no tilt to go by, and an orbit fits at every turn. So the fit is refused when nothing
moves, when the two do not agree, or when another place fits nearly as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array

GRID_S = 0.02
FINE_S = 0.002
_FINE_HALF_S = 0.05
LEAST_OVERLAP_S = 5.0
LEAST_TILT_DEG = 0.3  # standard deviation of roll and pitch together
LEAST_DRIFT_OVERLAP_S = 60.0  # in less, clocks of a different rate cannot be told apart
LARGEST_SHARE = 0.5  # of the tilt that the residual may have
_LONGEST_S = 6 * 3600.0
_GAP_S = 0.5  # between two samples; over a longer one nothing is known
_OTHER_PLACE_S = 1.0  # from the best, from where on a place is another one
_NEARLY_AS_WELL = 1.15  # times the residual of the best
_NOISE_DEG = 0.05  # below which residuals do not differ


class Alignment(NamedTuple):
    """Place of a log on a record's clock."""

    offset_s: float  # record less log, at the middle of the log
    residual_deg: float  # standard deviation of what the two attitudes differ by
    overlap_s: float  # of both
    middle_s: float = 0.0  # of the log
    drift_frac: float = 0.0  # by which the record's clock runs faster than PX4's

    def on_record(self, log_time_s: Array) -> Array:
        """Return times of the log on the record's clock."""
        shown_s: Array = log_time_s + self.offset_s + self.drift_frac * (log_time_s - self.middle_s)
        return shown_s


class NoAlignment(Exception):
    """The two do not fit: a sentence."""


def up_in_body(quaternion_wxyz: Array) -> Array:
    """Return which way is up, in the body's frame: forward, left, up.

    Args:
        quaternion_wxyz: (n, 4) ENU <- FLU.

    Returns:
        (n, 3); it does not depend on the heading.
    """
    w, x, y, z = quaternion_wxyz.T
    return np.stack(
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1
    )


def flu_of_frd(quaternion_ned_frd_wxyz: Array) -> Array:
    """Return the same tilt as a quaternion whose two frames have z up.

    Both frames are turned by half a turn about x, which changes the signs of y and z.

    Args:
        quaternion_ned_frd_wxyz: (n, 4).
    """
    turned: Array = quaternion_ned_frd_wxyz * np.array([1.0, 1.0, -1.0, -1.0])
    return turned


def align(record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array) -> Alignment:
    """Find how a log lies on a record's clock.

    Args:
        record_time_s: (n,), rising.
        record_up: (n, 3), see :func:`up_in_body`.
        log_time_s: (m,), rising.
        log_up: (m, 3).

    Raises:
        NoAlignment: they do not fit, or nothing tells where.
    """
    for time_s, who in ((record_time_s, "record"), (log_time_s, "log")):
        if time_s.size < 2 or time_s[-1] - time_s[0] < LEAST_OVERLAP_S:
            raise NoAlignment(f"The {who} has less than {LEAST_OVERLAP_S:g} s of attitude.")
        if time_s[-1] - time_s[0] > _LONGEST_S:
            raise NoAlignment(f"The {who} is longer than {_LONGEST_S / 3600.0:g} h.")

    record = _on_grid(record_time_s, record_up)
    log = _on_grid(log_time_s, log_up)
    for signal, who in ((record, "record"), (log, "log")):
        tilt_deg = _spread_deg(signal)
        if tilt_deg < LEAST_TILT_DEG:
            raise NoAlignment(
                f"The vehicle hardly tilts in the {who} ({tilt_deg:.1f} deg): nothing tells which"
                " moments are the same."
            )

    lags = _best_lags(record, log)
    begin_offset_s = float(record_time_s[0] - log_time_s[0])
    candidates = [
        _refined(record_time_s, record_up, log_time_s, log_up, begin_offset_s + lag * GRID_S)
        for lag in lags
    ]
    best = min(candidates, key=lambda one: one.residual_deg)
    _check(best, _spread_deg(log), candidates)
    return _stretched(record_time_s, record_up, log_time_s, log_up, best)


def _stretched(
    record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array, best: Alignment
) -> Alignment:
    """Return the alignment with the drift of the two clocks, where it makes them fit better."""
    begin_s = max(float(log_time_s[0]), float(record_time_s[0]) - best.offset_s)
    end_s = min(float(log_time_s[-1]), float(record_time_s[-1]) - best.offset_s)
    if end_s - begin_s < LEAST_DRIFT_OVERLAP_S:
        return best

    middle_s = (begin_s + end_s) / 2.0
    is_first = log_time_s < middle_s
    offsets_s = [
        _refined(record_time_s, record_up, log_time_s[part], log_up[part], best.offset_s).offset_s
        for part in (is_first, ~is_first)
    ]
    stretched = Alignment(
        offset_s=(offsets_s[0] + offsets_s[1]) / 2.0,
        residual_deg=best.residual_deg,
        overlap_s=best.overlap_s,
        middle_s=middle_s,
        drift_frac=(offsets_s[1] - offsets_s[0]) / ((end_s - begin_s) / 2.0),
    )
    fit = _fit(record_time_s, record_up, stretched.on_record(log_time_s), log_up, 0.0)
    if not fit.residual_deg < best.residual_deg:
        return best
    return stretched._replace(residual_deg=fit.residual_deg)


def _check(best: Alignment, tilt_deg: float, candidates: list[Alignment]) -> None:
    """Refuse what does not fit, or fits elsewhere as well."""
    if best.overlap_s < LEAST_OVERLAP_S or not math.isfinite(best.residual_deg):
        raise NoAlignment("Nowhere do the log and the record overlap long enough.")
    if best.residual_deg > LARGEST_SHARE * tilt_deg:
        raise NoAlignment(
            f"The log is of another flight or vehicle: where it fits best the attitudes differ by"
            f" {best.residual_deg:.1f} deg, and the vehicle tilts by {tilt_deg:.1f} deg."
        )
    for other in candidates:
        is_elsewhere = abs(other.offset_s - best.offset_s) > _OTHER_PLACE_S
        bound_deg = _NEARLY_AS_WELL * max(best.residual_deg, _NOISE_DEG)
        if is_elsewhere and other.residual_deg < bound_deg:
            raise NoAlignment(
                f"The log fits {best.offset_s:.1f} s and {other.offset_s:.1f} s after PX4's start"
                " nearly as well: the flight repeats itself."
            )


def _on_grid(time_s: Array, up: Array) -> Array:
    """Return forward and left part of up on a grid of GRID_S, less its mean; 0 in gaps."""
    grid_s = np.arange(time_s[0], time_s[-1], GRID_S)
    values = _between(time_s, up, grid_s)[:, :2]
    is_known = np.isfinite(values).all(-1)
    if not is_known.any():
        return np.zeros((0, 2))
    values -= values[is_known].mean(0)
    values[~is_known] = 0.0
    return values


def _between(time_s: Array, values: Array, at_s: Array) -> Array:
    """Return values between samples, at other times; NaN outside and in gaps."""
    found = np.stack(
        [np.interp(at_s, time_s, values[:, part], np.nan, np.nan) for part in range(3)], axis=-1
    )
    after = np.clip(np.searchsorted(time_s, at_s), 1, time_s.size - 1)
    found[time_s[after] - time_s[after - 1] > _GAP_S] = np.nan
    return found


def _spread_deg(signal: Array) -> float:
    """Return the standard deviation of roll and pitch together."""
    if not signal.size:
        return 0.0
    return math.degrees(math.sqrt(float((signal**2).sum(-1).mean())))


def _best_lags(record: Array, log: Array) -> list[int]:
    """Return where the log fits the record best, in steps of the grid: the peaks, best first."""
    size = 1 << (record.shape[0] + log.shape[0] - 1).bit_length()
    spectrum = np.fft.rfft(record, size, axis=0) * np.conj(np.fft.rfft(log, size, axis=0))
    correlation = np.fft.irfft(spectrum, size, axis=0).sum(-1)

    # normalised by what the two have where they overlap: a short overlap is no better fit
    energy = np.fft.irfft(
        np.fft.rfft((record**2).sum(-1), size) * np.conj(np.fft.rfft(np.ones(log.shape[0]), size)),
        size,
    )
    other = np.fft.irfft(
        np.fft.rfft(np.ones(record.shape[0]), size) * np.conj(np.fft.rfft((log**2).sum(-1), size)),
        size,
    )
    overlap = np.fft.irfft(
        np.fft.rfft(np.ones(record.shape[0]), size)
        * np.conj(np.fft.rfft(np.ones(log.shape[0]), size)),
        size,
    )
    with np.errstate(all="ignore"):
        score = correlation / np.sqrt(np.maximum(energy, 1e-9) * np.maximum(other, 1e-9))
    score[overlap * GRID_S < LEAST_OVERLAP_S] = -1.0
    # a lag at which little of the flight overlaps may fit by chance
    moved = np.sqrt(np.clip(energy / energy.max(), 0.0, 1.0) * np.clip(other / other.max(), 0, 1))
    score *= moved

    lags: list[int] = []
    apart = round(_OTHER_PLACE_S / GRID_S)
    left = score.copy()
    for _ in range(3):
        lag = int(left.argmax())
        if left[lag] <= 0.0:
            break
        lags.append(lag if lag < size // 2 else lag - size)
        near = (np.arange(lag - apart, lag + apart + 1)) % size
        left[near] = -1.0
    return lags or [0]


def _refined(
    record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array, offset_s: float
) -> Alignment:
    """Return the best offset near one, with what the attitudes differ by there."""
    best = Alignment(offset_s, math.inf, 0.0)
    for fine_s in (GRID_S, FINE_S):
        half = _FINE_HALF_S if fine_s == GRID_S else GRID_S
        for shift_s in np.arange(-half, half + fine_s / 2.0, fine_s):
            one = _fit(record_time_s, record_up, log_time_s, log_up, offset_s + float(shift_s))
            if one.residual_deg < best.residual_deg:
                best = one
        offset_s = best.offset_s
    return best


def _fit(
    record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array, offset_s: float
) -> Alignment:
    """Return by how much the attitudes differ with an offset.

    A difference that lasts (a body that is mounted askew) is no matter of time, and left out.
    """
    shown = _between(log_time_s + offset_s, log_up, record_time_s)
    difference = (shown - record_up)[:, :2]
    difference = difference[np.isfinite(difference).all(-1)]
    if difference.shape[0] < 2:
        return Alignment(offset_s, math.inf, 0.0)

    difference = difference - difference.mean(0)
    residual_deg = math.degrees(math.sqrt(float((difference**2).sum(-1).mean())))
    step_s = float(np.median(np.diff(record_time_s)))
    return Alignment(offset_s, residual_deg, difference.shape[0] * step_s)
