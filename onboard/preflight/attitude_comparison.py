"""PX4's attitude on the ground: its rate of arrival, and its tilt compared with the mocap's."""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.autopilot import Snapshot, Vec3, Vec4

_RATE_OVER_NS = 1_000_000_000
_TILT_TIME_S = 0.5
_HANDLED_RAD, _WRONG_TILT_RAD = math.radians(12.0), math.radians(10.0)
_UP: Vec3 = (0.0, 0.0, 1.0)


@dataclass(slots=True)
class AttitudeRate:
    """Counts the attitudes of each second; call :meth:`update` every tick on the ground."""

    rate_hz: float | None = None  # None until a second has passed
    _attitude_ns: int = 0
    _count: int = 0
    _count_from_ns: int | None = None

    def update(self, now_ns: int, attitude_ns: int) -> None:
        """Count one tick; ``attitude_ns`` is the arrival of the newest attitude, 0 never."""
        if not attitude_ns:
            return  # there is no rate before the first one
        if self._count_from_ns is None or now_ns - self._count_from_ns > 2 * _RATE_OVER_NS:
            # the first tick, or the first after a flight
            self._count_from_ns, self._count = now_ns, 0
        if attitude_ns != self._attitude_ns:
            self._attitude_ns = attitude_ns
            self._count += 1
        over_ns = now_ns - self._count_from_ns
        if over_ns >= _RATE_OVER_NS:
            self.rate_hz = self._count / (over_ns * 1e-9)
            self._count_from_ns, self._count = now_ns, 0


@dataclass(slots=True)
class TiltComparison:
    """Compares the direction of up in the body's axes, by mocap and by PX4.

    This needs no common heading, and shows whether the mocap's body is on this vehicle at all.
    """

    difference_rad: float = 0.0  # between both directions, low-passed
    has_wrong_tilt: bool = False  # they differed when the vehicle was last tilted by hand
    _directions: tuple[Vec3, Vec3] | None = None  # of mocap and PX4, low-passed

    def update(self, mocap_wxyz: Vec4, snapshot: Snapshot, dt_s: float) -> None:
        """Take one tick on the ground; ``mocap_wxyz`` is the newest sample's attitude."""
        measured = _body_up(mocap_wxyz), _body_up(snapshot.quaternion_enu_flu_wxyz)
        if not snapshot.attitude_ns or not all(map(math.isfinite, (*measured[0], *measured[1]))):
            return
        share = min(1.0, dt_s / _TILT_TIME_S)
        before = self._directions or measured
        mocap, px4 = (_mixed(old, new, share) for old, new in zip(before, measured, strict=True))
        self._directions = mocap, px4
        self.difference_rad = _angle_rad(mocap, px4)
        if max(_angle_rad(mocap, _UP), _angle_rad(px4, _UP)) > _HANDLED_RAD:
            self.has_wrong_tilt = self.difference_rad > _WRONG_TILT_RAD


def _body_up(quaternion_wxyz: Vec4) -> Vec3:
    """Return the fleet's up in the body's axes: the last row of the rotation."""
    w, x, y, z = quaternion_wxyz
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def _mixed(old: Vec3, new: Vec3, share: float) -> Vec3:
    x, y, z = (a + share * (b - a) for a, b in zip(old, new, strict=True))
    return x, y, z


def _angle_rad(one: Vec3, other: Vec3) -> float:
    size = math.hypot(*one) * math.hypot(*other)
    return (
        math.acos(max(-1.0, min(1.0, sum(a * b for a, b in zip(one, other, strict=True)) / size)))
        if size
        else 0.0
    )
