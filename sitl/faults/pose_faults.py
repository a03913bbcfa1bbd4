"""Faults of the poses that a motion capture delivers, or that an autopilot receives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.physics.frames import Array, multiply


@dataclass(frozen=True, slots=True)
class PoseFault:
    """Errors of the poses of one body."""

    kind: str  # frozen, swapped, jump, flipped, turned, drift, late or lost
    other: int = 0  # index of the body with which the body is swapped
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of a jump
    # by which a flipped body is turned, or the frame about the place where the fault begins
    yaw_rad: float = 0.0
    drift_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)  # velocity of a drift
    since_s: float = 0.0  # start of a drift
    delay_s: float = 0.0  # additional delay of the pose


class PoseFaults:
    """The faults of all bodies.

    Args:
        count: number of bodies.
    """

    def __init__(self, count: int) -> None:
        self._faults: list[PoseFault | None] = [None] * count
        # index of a body -> its pose when the fault began, for those that need it
        self._begun: dict[int, Array] = {}

    @property
    def is_clear(self) -> bool:
        """Whether no body has a fault."""
        return not any(self._faults)

    def set(self, index: int, fault: PoseFault | None) -> None:
        """Begin a fault of one body, or end its fault with None.

        A swap changes the fault of the other body as well.
        """
        before = self._faults[index]
        if before is not None and before.kind == "swapped":
            self._faults[before.other] = None

        self._faults[index] = fault
        self._begun.pop(index, None)
        if fault is not None and fault.kind == "swapped":
            self._faults[fault.other] = PoseFault("swapped", other=index)

    def is_lost(self, index: int) -> bool:
        """Return whether a body is not measured."""
        fault = self._faults[index]
        return fault is not None and fault.kind == "lost"

    def delay_s(self, index: int) -> float:
        """Return the additional delay of a body's pose [s]."""
        fault = self._faults[index]
        if fault is None:
            return 0.0
        return fault.delay_s

    def apply(self, poses: Array, time_s: float, index: int | None = None) -> Array:
        """Return the measured poses, which contain the faults.

        Args:
            poses: correct poses (n, k), whose first three columns are positions.
            time_s: present time.
            index: index of the only body that is measured now; None: all are measured.
        """
        measured = poses.copy()
        for i, fault in enumerate(self._faults):
            if fault is None or (index is not None and i != index):
                continue

            if fault.kind == "swapped":
                measured[i] = poses[fault.other]
            elif fault.kind == "jump":
                measured[i, :3] += fault.shift_m
            elif fault.kind == "flipped":
                measured[i, 3:] = _flipped(poses[i, 3:], fault.yaw_rad)
            elif fault.kind == "turned":
                about = self._begun.setdefault(i, poses[i].copy())
                measured[i] = _turned(poses[i], about, fault.yaw_rad)
            elif fault.kind == "drift":
                measured[i, :3] += (time_s - fault.since_s) * np.array(fault.drift_m_s)
            elif fault.kind == "frozen":
                measured[i] = self._begun.setdefault(i, poses[i].copy())
        return np.asarray(measured)


def _flipped(attitude_enu_flu: Array, yaw_rad: float) -> Array:
    """Return an attitude (4,), turned about up."""
    about_up = np.array([math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)])
    return multiply(about_up, attitude_enu_flu)


def _turned(pose: Array, about: Array, yaw_rad: float) -> Array:
    """Return a pose (x, y, z, yaw) in a frame that is turned about a place."""
    cosine = math.cos(yaw_rad)
    sine = math.sin(yaw_rad)
    x, y = pose[:2] - about[:2]

    turned = pose.copy()
    turned[0] = about[0] + cosine * x - sine * y
    turned[1] = about[1] + sine * x + cosine * y
    turned[3] += yaw_rad
    return turned
