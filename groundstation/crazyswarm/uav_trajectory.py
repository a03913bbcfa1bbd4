"""Trajectories of Crazyswarm: CSVs of 33 columns, as polynomials of seventh order."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np

from groundstation.paths.files import load_path
from onboard.arrays import Array
from onboard.control.path import Path, path_of, point_at


class TrajectoryOutput(NamedTuple):
    """Motion at one time of a trajectory."""

    pos: Array  # (3,) [m]
    vel: Array  # (3,) [m/s]
    acc: Array  # (3,) [m/s^2]
    yaw: float  # [rad]


class Polynomial(NamedTuple):
    """Coefficients of one axis, the constant one first."""

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
            filename: of the CSV.

        Raises:
            ConfigError: it cannot be read.
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
        )


def path_of_trajectory(trajectory: Any) -> Path:
    """Return the path of a trajectory, of this class or of Crazyswarm's own.

    Raises:
        ValueError: it has no pieces.
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


def _eight(coefficients: Any) -> list[float]:
    """Return the coefficients of a seventh order; those that are left out are 0."""
    values = [float(value) for value in coefficients]
    return values + [0.0] * (8 - len(values))
