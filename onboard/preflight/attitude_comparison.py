"""Checks PX4's attitude on the ground: its rate, and its tilt compared with the mocap's."""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.autopilot import Snapshot
from onboard.tuples import Wxyz, Xyz

_RATE_OVER_NS = 1_000_000_000  # time over which attitudes are counted
_GAP_NS = 200_000_000  # attitudes were not counted between ticks that are farther apart
_TILT_TIME_S = 0.5  # time constant of the low-pass
_IN_HANDS_RAD = math.radians(12.0)  # a vehicle tilted more than this is held by a person
_WRONG_TILT_RAD = math.radians(10.0)  # largest difference of the two tilts while it is held
_UP: Xyz = (0.0, 0.0, 1.0)


@dataclass(slots=True)
class AttitudeRate:
    """Counts the attitudes of each second; call :meth:`update` every tick on the ground."""

    rate_hz: float | None = None  # None until a second has passed
    _attitude_ns: int = 0  # arrival of the newest counted attitude
    _count: int = 0
    _tick_ns: int = 0  # newest tick
    _count_from_ns: int | None = None  # start of the present second

    def update(self, now_ns: int, attitude_ns: int) -> None:
        """Count one tick; ``attitude_ns`` is the arrival of the newest attitude, 0: none yet."""
        if not attitude_ns:
            return  # there is no rate before the first attitude

        # the first tick, or the first after a flight or a kill, during which nobody counted
        is_after_gap = now_ns - self._tick_ns > _GAP_NS
        self._tick_ns = now_ns
        if self._count_from_ns is None or is_after_gap:
            self._count_from_ns = now_ns
            self._count = 0

        if attitude_ns != self._attitude_ns:
            self._attitude_ns = attitude_ns
            self._count += 1

        over_ns = now_ns - self._count_from_ns
        if over_ns >= _RATE_OVER_NS:
            self.rate_hz = self._count / (over_ns * 1e-9)
            self._count_from_ns = now_ns
            self._count = 0


@dataclass(slots=True)
class TiltComparison:
    """Compares the up direction in body axes measured by the mocap with the one estimated by PX4.

    No common heading is needed. If a person tilts the vehicle, the comparison also shows whether
    the mocap's body belongs to this vehicle at all.
    """

    difference_rad: float = 0.0  # angle between both directions, low-passed
    # whether the directions differed when a person last tilted the vehicle
    differed_when_tilted: bool = False
    _by_mocap: Xyz | None = None  # direction from the mocap, low-passed; None before the first tick
    _by_px4: Xyz | None = None  # direction from PX4, low-passed; None before the first tick

    def update(self, mocap_wxyz: Wxyz, snapshot: Snapshot, dt_s: float) -> None:
        """Take one tick on the ground; ``mocap_wxyz`` is the newest sample's attitude."""
        by_mocap = _body_up(mocap_wxyz)
        by_px4 = _body_up(snapshot.quaternion_enu_flu_wxyz)
        is_finite = all(map(math.isfinite, (*by_mocap, *by_px4)))
        if not snapshot.attitude_ns or not is_finite:
            return

        if self._by_mocap is None or self._by_px4 is None:
            self._by_mocap = by_mocap
            self._by_px4 = by_px4
        weight = min(1.0, dt_s / _TILT_TIME_S)
        self._by_mocap = _mixed(self._by_mocap, by_mocap, weight)
        self._by_px4 = _mixed(self._by_px4, by_px4, weight)

        self.difference_rad = _angle_rad(self._by_mocap, self._by_px4)
        tilt_rad = max(_angle_rad(self._by_mocap, _UP), _angle_rad(self._by_px4, _UP))
        if tilt_rad > _IN_HANDS_RAD:
            self.differed_when_tilted = self.difference_rad > _WRONG_TILT_RAD


def _body_up(quaternion_wxyz: Wxyz) -> Xyz:
    """Return the fleet's up direction in body axes: the last row of the rotation."""
    w, x, y, z = quaternion_wxyz
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def _mixed(old: Xyz, new: Xyz, weight: float) -> Xyz:
    """Return the weighted mean of two directions; ``weight`` is the weight of the new direction."""
    x, y, z = (a + weight * (b - a) for a, b in zip(old, new, strict=True))
    return x, y, z


def _angle_rad(one: Xyz, other: Xyz) -> float:
    """Return the angle between two directions; 0 if one of them has no length."""
    lengths = math.hypot(*one) * math.hypot(*other)
    if not lengths:
        return 0.0
    cosine = sum(a * b for a, b in zip(one, other, strict=True)) / lengths
    return math.acos(max(-1.0, min(1.0, cosine)))
