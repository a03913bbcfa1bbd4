"""Puts a log of PX4 on the clock of a flight's record, by how the vehicle tilted. Pure.

PX4 counts time since its start, and the record counts time since its own start. Nothing in the
files relates the two clocks. But both files contain the attitude: the log has PX4's estimates, and
the record has those that the agent received by telemetry. Roll and pitch of the log are shifted in
time until they fit those of the record. The cross-correlation on a grid finds candidates for the
shift. Near each candidate, the shift with the smallest difference is searched for. The heading is
left out, because the north of PX4's frame and that of the fleet's frame may differ.

The two clocks also run at slightly different rates, by some 20 to 100 parts in a million: 30 ms at
either end of ten minutes. So where log and record overlap for long, the offset is found separately
for the first and the second half, and the times of the log are stretched by the difference.

A hover has no tilt to compare, and an orbit fits at every turn. So the alignment is refused when
the vehicle does not tilt, when the two attitudes do not agree, or when another offset fits nearly
as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array

GRID_S = 0.02  # step of the shift in the search for candidates
FINE_S = 0.002  # step of the shift near a candidate, at the end
_FINE_HALF_S = 0.05  # largest distance from a candidate at which the best shift is sought
MIN_OVERLAP_S = 5.0  # a log and a record with a shorter overlap are not compared
MIN_TILT_DEG = 0.3  # standard deviation of roll and pitch together
MIN_DRIFT_OVERLAP_S = 60.0  # a shorter overlap does not show that the clocks' rates differ
LARGEST_SHARE = 0.5  # largest residual of an accepted fit, as a share of the tilt
_LONGEST_S = 6 * 3600.0
_GAP_S = 0.5  # nothing is interpolated between samples that are farther apart
_MAX_CANDIDATES = 3
_OTHER_PLACE_S = 1.0  # least difference between the offsets of two separate fits
_NEARLY_AS_WELL = 1.15  # a fit is ambiguous if another residual is less than this times its own
_NOISE_DEG = 0.05  # smaller residuals count as this one in that comparison


class Alignment(NamedTuple):
    """Relation between the clock of a log and that of a record."""

    offset_s: float  # record's time minus log's time, at middle_s
    residual_deg: float  # standard deviation of the difference between the two attitudes
    overlap_s: float  # duration that both cover
    middle_s: float = 0.0  # log's time at which the offset holds
    drift_frac: float = 0.0  # share by which the record's clock runs faster than PX4's

    def on_record(self, log_time_s: Array) -> Array:
        """Return times of the log on the record's clock."""
        shown_s: Array = log_time_s + self.offset_s + self.drift_frac * (log_time_s - self.middle_s)
        return shown_s


class NoAlignment(Exception):
    """Log and record cannot be aligned; the message says why in a sentence."""


def up_in_body(quaternion_wxyz: Array) -> Array:
    """Return the upward direction in the body's frame: forward, left, up.

    Args:
        quaternion_wxyz: quaternions (n, 4), ENU <- FLU.

    Returns:
        Unit vectors (n, 3), which do not depend on the heading.
    """
    w, x, y, z = quaternion_wxyz.T
    return np.stack(
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1
    )


def flu_of_frd(quaternion_ned_frd_wxyz: Array) -> Array:
    """Return the same tilt as a quaternion whose two frames have z up.

    Both frames are turned by half a turn about x, which changes the signs of y and z.

    Args:
        quaternion_ned_frd_wxyz: quaternions (n, 4), NED <- FRD.
    """
    turned: Array = quaternion_ned_frd_wxyz * np.array([1.0, 1.0, -1.0, -1.0])
    return turned


def align(record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array) -> Alignment:
    """Find the relation between a log's clock and a record's clock.

    Args:
        record_time_s: times of the record (n,), rising.
        record_up: upward directions (n, 3) in the record, see :func:`up_in_body`.
        log_time_s: times of the log (m,), rising.
        log_up: upward directions (m, 3) in the log.

    Raises:
        NoAlignment: log and record do not fit, or the offset is ambiguous.
    """
    for time_s, source in ((record_time_s, "record"), (log_time_s, "log")):
        if time_s.size < 2 or time_s[-1] - time_s[0] < MIN_OVERLAP_S:
            raise NoAlignment(f"The {source} has less than {MIN_OVERLAP_S:g} s of attitude.")
        if time_s[-1] - time_s[0] > _LONGEST_S:
            raise NoAlignment(f"The {source} is longer than {_LONGEST_S / 3600.0:g} h.")

    record_tilt = _on_grid(record_time_s, record_up)
    log_tilt = _on_grid(log_time_s, log_up)
    for tilt, source in ((record_tilt, "record"), (log_tilt, "log")):
        tilt_deg = _spread_deg(tilt)
        if tilt_deg < MIN_TILT_DEG:
            raise NoAlignment(
                f"The vehicle hardly tilts in the {source} ({tilt_deg:.1f} deg): nothing tells"
                " which moments are the same."
            )

    lags = _best_lags(record_tilt, log_tilt)
    begin_offset_s = float(record_time_s[0] - log_time_s[0])
    candidates = [
        _refined(record_time_s, record_up, log_time_s, log_up, begin_offset_s + lag * GRID_S)
        for lag in lags
    ]
    best = min(candidates, key=lambda candidate: candidate.residual_deg)
    _check(best, _spread_deg(log_tilt), candidates)
    return _stretched(record_time_s, record_up, log_time_s, log_up, best)


def _stretched(
    record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array, best: Alignment
) -> Alignment:
    """Return the alignment with the drift of the two clocks, or ``best`` if that fits no worse.

    Args:
        record_time_s, record_up, log_time_s, log_up: as for :func:`align`.
        best: alignment with the best constant offset.
    """
    begin_s = max(float(log_time_s[0]), float(record_time_s[0]) - best.offset_s)
    end_s = min(float(log_time_s[-1]), float(record_time_s[-1]) - best.offset_s)
    if end_s - begin_s < MIN_DRIFT_OVERLAP_S:
        return best

    # Each half of the log is aligned by itself. The middles of the two halves are half of the
    # overlap apart.
    middle_s = (begin_s + end_s) / 2.0
    is_first = log_time_s < middle_s
    first_offset_s, second_offset_s = [
        _refined(record_time_s, record_up, log_time_s[part], log_up[part], best.offset_s).offset_s
        for part in (is_first, ~is_first)
    ]
    stretched = Alignment(
        offset_s=(first_offset_s + second_offset_s) / 2.0,
        residual_deg=best.residual_deg,
        overlap_s=best.overlap_s,
        middle_s=middle_s,
        drift_frac=(second_offset_s - first_offset_s) / ((end_s - begin_s) / 2.0),
    )

    fit = _fit(record_time_s, record_up, stretched.on_record(log_time_s), log_up, 0.0)
    if not fit.residual_deg < best.residual_deg:
        return best
    return stretched._replace(residual_deg=fit.residual_deg)


def _check(best: Alignment, tilt_deg: float, candidates: list[Alignment]) -> None:
    """Refuse an alignment that does not fit, or is ambiguous.

    Args:
        best: the candidate with the smallest residual.
        tilt_deg: standard deviation of roll and pitch in the log.
        candidates: all candidates.

    Raises:
        NoAlignment: the alignment is refused.
    """
    if best.overlap_s < MIN_OVERLAP_S or not math.isfinite(best.residual_deg):
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
    """Return the tilt at each GRID_S, minus its mean; 0 in gaps between samples.

    The tilt is the forward and the left part of an upward direction: nearly pitch and roll [rad].
    """
    grid_s = np.arange(time_s[0], time_s[-1], GRID_S)
    values = _between(time_s, up, grid_s)[:, :2]
    is_known = np.isfinite(values).all(-1)
    if not is_known.any():
        return np.zeros((0, 2))
    values -= values[is_known].mean(0)
    values[~is_known] = 0.0
    return values


def _between(time_s: Array, values: Array, at_s: Array) -> Array:
    """Return values interpolated at other times; NaN outside the samples and in gaps."""
    interpolated = np.stack(
        [np.interp(at_s, time_s, values[:, axis], np.nan, np.nan) for axis in range(3)], axis=-1
    )
    # index of the next sample after each time, so that the one before it exists
    after = np.clip(np.searchsorted(time_s, at_s), 1, time_s.size - 1)
    is_in_gap = time_s[after] - time_s[after - 1] > _GAP_S
    interpolated[is_in_gap] = np.nan
    return interpolated


def _spread_deg(tilt: Array) -> float:
    """Return the standard deviation of roll and pitch together, of a tilt from _on_grid."""
    if not tilt.size:
        return 0.0
    return math.degrees(math.sqrt(float((tilt**2).sum(-1).mean())))


def _best_lags(record_tilt: Array, log_tilt: Array) -> list[int]:
    """Return the shifts at which the log fits the record best, in grid steps, best first.

    Args:
        record_tilt, log_tilt: tilts from _on_grid.
    """
    record_size = record_tilt.shape[0]
    log_size = log_tilt.shape[0]
    # a power of two, large enough that the log is never compared with a wrapped-around record
    size = 1 << (record_size + log_size - 1).bit_length()
    score = _correlated(record_tilt, log_tilt, size).sum(-1)

    # The sum is not divided by the tilts within the overlap. So a lag at which little of the
    # tilting overlaps has a low score, even if that little fits by chance.
    overlap = _correlated(np.ones(record_size), np.ones(log_size), size)
    score[overlap * GRID_S < MIN_OVERLAP_S] = -1.0

    # The best lags, each far from those before. An index in the upper half is a negative lag.
    lags: list[int] = []
    least_distance = round(_OTHER_PLACE_S / GRID_S)
    remaining = score.copy()
    for _ in range(_MAX_CANDIDATES):
        lag = int(remaining.argmax())
        if remaining[lag] <= 0.0:
            break
        if lag < size // 2:
            lags.append(lag)
        else:
            lags.append(lag - size)
        near = (np.arange(lag - least_distance, lag + least_distance + 1)) % size
        remaining[near] = -1.0
    if not lags:
        return [0]
    return lags


def _correlated(first: Array, second: Array, size: int) -> Array:
    """Return the circular cross-correlation of two signals along their first axis.

    Args:
        first, second: signals, padded with zeros to ``size``.
        size: length of the result; index k is the lag by which ``second`` is shifted.
    """
    spectrum = np.fft.rfft(first, size, axis=0) * np.conj(np.fft.rfft(second, size, axis=0))
    correlation: Array = np.fft.irfft(spectrum, size, axis=0)
    return correlation


def _refined(
    record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array, offset_s: float
) -> Alignment:
    """Return the alignment with the smallest residual near an offset.

    It is found by a coarse search, and by a fine search about the result of the coarse one.

    Args:
        record_time_s, record_up, log_time_s, log_up: as for :func:`align`.
        offset_s: offset about which the search begins.
    """
    best = Alignment(offset_s, residual_deg=math.inf, overlap_s=0.0)
    # first in coarse steps around the offset, then in fine steps around the best of them
    for step_s, half_s in ((GRID_S, _FINE_HALF_S), (FINE_S, GRID_S)):
        # half a step more, so that rounding does not exclude the last shift
        for shift_s in np.arange(-half_s, half_s + step_s / 2.0, step_s):
            fit = _fit(record_time_s, record_up, log_time_s, log_up, offset_s + float(shift_s))
            if fit.residual_deg < best.residual_deg:
                best = fit
        offset_s = best.offset_s
    return best


def _fit(
    record_time_s: Array, record_up: Array, log_time_s: Array, log_up: Array, offset_s: float
) -> Alignment:
    """Return the alignment with a given offset, and its residual.

    A constant difference of the tilt comes from an autopilot that is mounted askew, and is
    subtracted.
    """
    log_up_on_record = _between(log_time_s + offset_s, log_up, record_time_s)
    difference = (log_up_on_record - record_up)[:, :2]
    difference = difference[np.isfinite(difference).all(-1)]
    if difference.shape[0] < 2:
        return Alignment(offset_s, residual_deg=math.inf, overlap_s=0.0)

    difference = difference - difference.mean(0)
    residual_deg = math.degrees(math.sqrt(float((difference**2).sum(-1).mean())))
    period_s = float(np.median(np.diff(record_time_s)))
    overlap_s = difference.shape[0] * period_s
    return Alignment(offset_s, residual_deg=residual_deg, overlap_s=overlap_s)
