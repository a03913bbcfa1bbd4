"""Trajectories of Crazyswarm: files (CSV) with 33 columns, read as polynomials of seventh order."""

from __future__ import annotations

import math
import os
from typing import Any, NamedTuple

import numpy as np

from groundstation.orders.grammar import OrderError
from groundstation.paths.checks import (
    jump_findings,
    limits_of,
    needed_slowing,
    refusals,
    sample,
)
from groundstation.paths.path_files import load_path
from groundstation.paths.pieces import slowed
from onboard.arrays import Array
from onboard.config.fleet import FleetConfig
from onboard.constants import GRAVITY_M_S2
from onboard.control.path import Path, path_of, point_at

_SLOWING_SLACK = 1.01  # a trajectory is accepted if it needs no more slowing than this factor


class TrajectoryOutput(NamedTuple):
    """Motion at one time of a trajectory."""

    pos: Array  # (3,) [m]
    vel: Array  # (3,) [m/s]
    acc: Array  # (3,) [m/s^2]
    yaw: float  # [rad]
    omega: Array  # (3,) body rates that the motion needs [rad/s]


class Polynomial(NamedTuple):
    """Coefficients of one axis, beginning with the constant one."""

    p: Array


class Polynomial4D(NamedTuple):
    """One piece of a trajectory."""

    duration: float
    px: Polynomial
    py: Polynomial
    pz: Polynomial
    pyaw: Polynomial


class Trajectory:
    """A trajectory, empty until :meth:`loadcsv`."""

    def __init__(self) -> None:
        self.polynomials: list[Polynomial4D] | None = None
        self.duration: float = 0.0

    def n_pieces(self) -> int:
        """Return the number of pieces."""
        return len(self.polynomials or ())

    def loadcsv(self, filename: str | os.PathLike[str]) -> None:
        """Read a file of ``duration,x^0,...,yaw^7``.

        Args:
            filename: name of the CSV.

        Raises:
            ConfigError: the file cannot be read.
        """
        path = load_path(filename)
        self.polynomials = [_polynomials(np.array(piece)) for piece in path.pieces]
        self.duration = path.duration_s

    def eval(self, t: float) -> TrajectoryOutput:
        """Return the motion at a time [s]."""
        point = point_at(path_of_trajectory(self), t)
        return TrajectoryOutput(
            pos=np.array(point.position_enu_m),
            vel=np.array(point.velocity_enu_m_s),
            acc=np.array(point.acceleration_enu_m_s2),
            yaw=point.yaw_rad,
            omega=self._body_rates_rad_s(t),
        )

    def _body_rates_rad_s(self, t: float) -> Array:
        """Return the rates of roll, pitch and yaw that a multirotor needs at a time.

        Mellinger and Kumar, Minimum snap trajectory generation and control for quadrotors (2011),
        section III.
        """
        piece, time_s = self._piece_at(t)
        axes = (piece.px, piece.py, piece.pz)
        acceleration_m_s2 = np.array([_derivative(axis.p, time_s, 2) for axis in axes])
        jerk_m_s3 = np.array([_derivative(axis.p, time_s, 3) for axis in axes])
        yaw_rad = _derivative(piece.pyaw.p, time_s, 0)
        yaw_rate_rad_s = _derivative(piece.pyaw.p, time_s, 1)

        thrust_m_s2 = acceleration_m_s2 + np.array([0.0, 0.0, GRAVITY_M_S2])
        thrust_norm_m_s2 = float(np.linalg.norm(thrust_m_s2))
        up_b = thrust_m_s2 / thrust_norm_m_s2

        heading = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
        left_b = np.cross(up_b, heading)
        left_b /= np.linalg.norm(left_b)
        forward_b = np.cross(left_b, up_b)

        # The direction of the thrust turns with the part of the jerk across it.
        turning_rad_s = (jerk_m_s3 - up_b * (up_b @ jerk_m_s3)) / thrust_norm_m_s2
        return np.array(
            [-turning_rad_s @ left_b, turning_rad_s @ forward_b, up_b[2] * yaw_rate_rad_s]
        )

    def _piece_at(self, t: float) -> tuple[Polynomial4D, float]:
        """Return the piece at a time, and the time since the start of this piece [s].

        A time before the start or after the end is clamped to the start or the end.
        """
        pieces = self.polynomials or []
        time_s = max(0.0, t)
        for piece in pieces[:-1]:
            if time_s <= piece.duration:
                return piece, time_s
            time_s -= piece.duration
        return pieces[-1], min(time_s, pieces[-1].duration)


def path_of_trajectory(trajectory: Any) -> Path:
    """Return the path of a :class:`Trajectory`, or of a trajectory of Crazyswarm's own class.

    Raises:
        ValueError: the trajectory has no pieces.
    """
    pieces = trajectory.polynomials or ()
    if not pieces:
        raise ValueError("This trajectory is empty: read a file with loadcsv first.")

    rows = []
    for piece in pieces:
        row = [piece.duration]
        for polynomial in (piece.px, piece.py, piece.pz, piece.pyaw):
            row += _eight(polynomial.p)
        rows.append(row)
    return path_of(rows)


def _polynomials(row: Array) -> Polynomial4D:
    """Return one row of a file, (33,): a duration, and eight coefficients for each axis."""
    x, y, z, yaw = (Polynomial(row[begin : begin + 8]) for begin in (1, 9, 17, 25))
    return Polynomial4D(duration=float(row[0]), px=x, py=y, pz=z, pyaw=yaw)


def _derivative(coefficients: Array, time_s: float, order: int) -> float:
    """Return a derivative of a polynomial whose coefficients begin with the constant one."""
    return float(np.polynomial.Polynomial(coefficients).deriv(order)(time_s))


def _eight(coefficients: Any) -> list[float]:
    """Return eight coefficients; missing ones are 0."""
    values = [float(value) for value in coefficients]
    return values + [0.0] * (8 - len(values))


def refuse_unflyable_trajectory(
    path: Path, timescale: float, name: str, fleet: FleetConfig
) -> None:
    """Refuse a trajectory that a vehicle cannot fly, wherever it begins.

    Args:
        path: path as it stands in its file.
        timescale: factor by which the flight takes longer.
        name: name of the vehicle.
        fleet: the fleet file.

    Raises:
        OrderError: the trajectory needs more speed, acceleration or tilt than the vehicle has, or
            its position or velocity jumps between two pieces.
    """
    slower = {name: slowed(path, timescale)}
    jumping = refusals(jump_findings(slower, "the trajectory"))
    if jumping:
        raise OrderError(jumping[0])

    slowing, worst_words = needed_slowing(sample(slower), limits_of(fleet, [name]))
    if slowing <= _SLOWING_SLACK:
        return

    needed = math.ceil(100.0 * timescale * slowing) / 100.0
    raise OrderError(
        f"The trajectory is too fast for {name}: with timescale {timescale:g} {worst_words}. "
        f"A timescale of {needed:g} would do."
    )
