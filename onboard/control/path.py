"""Paths: pieces of seventh-order polynomials of x, y, z and yaw, and their bytes.

Every file format of a path is converted to this form. In flight :func:`point_at` evaluates it at
each tick. Checks before a flight use :func:`sampled`, which evaluates it at many times at once.
"""

from __future__ import annotations

import hashlib
import itertools
import struct
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array
from onboard.config.config_error import ConfigError
from onboard.vectors import ZERO_3, Vec3

# how many numbers a piece has: its duration, then eight coefficients each of x, y, z and yaw, with
# the constant coefficient first
NUMBER_COUNT = 33
DURATION = 0  # index of the duration
AXES = 4
YAW = 3  # index of yaw among the axes
POWERS = 8
MAX_BYTES = 262_144  # largest path: nearly two thousand pieces
PART_BYTES = 24_576  # a path is sent in parts of this size: a message has at most 65536 bytes
LONGEST_S = 3600.0
_ROW = struct.Struct(f"<{NUMBER_COUNT}f")  # one piece as little-endian 32-bit floats
MAX_PIECES = MAX_BYTES // _ROW.size
# largest jumps from the end of a piece to the begin of the next one
MAX_JUMP_M = 0.02
MAX_JUMP_M_S = 0.05
MAX_TURN_RAD_S = 1.0  # with which a vehicle turns to the heading of a path or of a goal


class Path(NamedTuple):
    """Pieces of a path; the first piece begins at the time 0."""

    ends_s: tuple[float, ...]  # time at which each piece ends
    pieces: tuple[tuple[float, ...], ...]  # lengths in metres ENU, yaw in radians

    @property
    def duration_s(self) -> float:
        """Time from the start of the first piece to the end of the last."""
        return self.ends_s[-1]


class PathPoint(NamedTuple):
    """Motion at one time of a path."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    acceleration_enu_m_s2: Vec3
    yaw_rad: float


def path_of(pieces: Sequence[Sequence[float]]) -> Path:
    """Return the path of these pieces, rounded to 32-bit floats.

    Raises:
        ConfigError: There is no piece; or a piece has another number of values, a value that is not
            finite, or no positive duration; or the path is too long.
    """
    try:
        rows = [_ROW.pack(*piece) for piece in pieces]
    except (struct.error, OverflowError):
        raise ConfigError(
            f"A piece has other than {NUMBER_COUNT} numbers, or one that is too large for 32 bits."
        ) from None
    return from_bytes(b"".join(rows))


def to_bytes(path: Path) -> bytes:
    """Return the bytes of a path, from which :func:`path_id` computes its id."""
    return b"".join(_ROW.pack(*piece) for piece in path.pieces)


def from_bytes(data: bytes) -> Path:
    """Return the path of these bytes.

    Raises:
        ConfigError: The bytes are not a path; the message says why.
    """
    if not data or len(data) % _ROW.size:
        raise ConfigError(f"{len(data)} bytes are no path.")
    if len(data) > MAX_BYTES:
        raise ConfigError(
            f"A path has at most {MAX_PIECES} pieces, and this one has {len(data) // _ROW.size}. "
            "Fly it in parts."
        )

    pieces = tuple(_ROW.iter_unpack(data))
    durations_s = [piece[DURATION] for piece in pieces]
    ends_s = tuple(itertools.accumulate(durations_s))

    is_finite = np.isfinite(np.array(pieces)).all()
    if not is_finite or min(durations_s) <= 0.0 or ends_s[-1] > LONGEST_S:
        raise ConfigError(
            "A piece is not finite, or lasts no time, or the path is longer than "
            f"{LONGEST_S:.0f} s."
        )
    return Path(ends_s, pieces)


def coefficients_of(pieces: Array) -> Array:
    """Return the coefficients (..., 4, 8) of pieces (..., 33), by axis and power: a view."""
    return pieces[..., 1:].reshape(*pieces.shape[:-1], AXES, POWERS)


def piece_of(duration_s: float, coefficients: Array) -> Array:
    """Return the piece (33,) with these coefficients (4, 8)."""
    return np.concatenate([[duration_s], coefficients.reshape(-1)])


def start_of(piece: Array) -> Array:
    """Return x, y, z and yaw (4,) at the start of a piece (33,)."""
    return coefficients_of(piece)[:, 0]


def path_id(data: bytes) -> str:
    """Return the id of a path. Only equal bytes have equal ids."""
    return hashlib.sha256(data).hexdigest()[:16]


def point_at(path: Path, time_s: float) -> PathPoint:
    """Return the motion at a time of the path. Before its start and after its end, it is at
    rest.
    """
    if time_s >= path.duration_s:
        last = path.pieces[-1]
        return _rest(last, last[DURATION])
    if not time_s > 0.0:  # or NaN
        return _rest(path.pieces[0], 0.0)

    index = bisect_right(path.ends_s, time_s)
    piece = path.pieces[index]
    begin_s = path.ends_s[index] - piece[DURATION]
    since_s = time_s - begin_s

    x, v_x, a_x = horner(piece, 0, since_s)
    y, v_y, a_y = horner(piece, 1, since_s)
    z, v_z, a_z = horner(piece, 2, since_s)
    yaw_rad, _, _ = horner(piece, 3, since_s)
    return PathPoint(
        position_enu_m=Vec3(x, y, z),
        velocity_enu_m_s=Vec3(v_x, v_y, v_z),
        acceleration_enu_m_s2=Vec3(a_x, a_y, a_z),
        yaw_rad=yaw_rad,
    )


def _rest(piece: Sequence[float], since_s: float) -> PathPoint:
    """Return the position and yaw at a time of a piece, with zero velocity and acceleration."""
    x, _, _ = horner(piece, 0, since_s)
    y, _, _ = horner(piece, 1, since_s)
    z, _, _ = horner(piece, 2, since_s)
    yaw_rad, _, _ = horner(piece, 3, since_s)
    return PathPoint(
        position_enu_m=Vec3(x, y, z),
        velocity_enu_m_s=ZERO_3,
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=yaw_rad,
    )


def horner(piece: Sequence[float], axis: int, t: float) -> tuple[float, float, float]:
    """Return value, first and second derivative of one axis of a piece.

    Args:
        piece: the numbers of one piece, or an array of each number for many times.
        axis: 0 to 3 for x, y, z, yaw.
        t: time since the start of the piece [s], or an array.
    """
    # the coefficients follow the duration
    c0, c1, c2, c3, c4, c5, c6, c7 = piece[1 + 8 * axis : 9 + 8 * axis]
    value = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * (c6 + t * c7))))))
    first = c1 + t * (
        2 * c2 + t * (3 * c3 + t * (4 * c4 + t * (5 * c5 + t * (6 * c6 + t * 7 * c7))))
    )
    second = 2 * c2 + t * (6 * c3 + t * (12 * c4 + t * (20 * c5 + t * (30 * c6 + t * 42 * c7))))
    return value, first, second


def sampled(path: Path, times_s: Array) -> Array:
    """Return the motion (3, T, 4) at many times (T,) of a path.

    Along the first axis are value, first and second derivative; along the last x, y, z and yaw.
    """
    ends_s = np.array(path.ends_s)
    pieces = np.array(path.pieces)

    # the end of the path belongs to its last piece
    clipped_s = np.clip(times_s, 0.0, path.duration_s)
    index = np.minimum(np.searchsorted(ends_s, clipped_s, side="right"), len(pieces) - 1)
    begins_s = ends_s[index] - pieces[index, DURATION]
    since_s = clipped_s - begins_s

    numbers = pieces[index].T  # (NUMBER_COUNT, T): the numbers of each time's piece
    by_axis = [horner(numbers, axis, since_s) for axis in range(4)]  # type: ignore[arg-type]
    motion = np.array(by_axis).transpose(1, 2, 0)  # from (axis, derivative, time)

    # before its start and after its end, the path is at rest
    is_outside = (times_s < 0.0) | (times_s > path.duration_s)
    motion[1:, is_outside] = 0.0
    return motion


def jumps(path: Path) -> Array:
    """Return the jumps (2, P - 1) of position [m] and velocity [m/s] between successive pieces."""
    numbers = np.array(path.pieces).T  # (NUMBER_COUNT, P)
    earlier = numbers[:, :-1]
    later = numbers[:, 1:]

    # (axis, position and velocity, piece)
    ends = np.array([horner(earlier, axis, earlier[DURATION])[:2] for axis in range(3)])  # type: ignore[arg-type]
    begins = np.array([horner(later, axis, 0.0)[:2] for axis in range(3)])  # type: ignore[arg-type]
    return np.asarray(np.sqrt(((begins - ends) ** 2).sum(0)))
