"""Checks the motion capture's poses against PX4's own position.

PX4's position contradicts poses that jumped, and is still known when poses are lost. It lags and
drifts, so vehicles do not use it while poses arrive. But PX4 measures accelerations, so a real
sudden motion of the vehicle also changes PX4's position. Rejected poses are not sent to PX4, so
they do not change it.

If a vehicle lands while its poses are rejected, the position of the landing is used until a pose is
accepted. Before a flight PX4's position is not used, since people carry vehicles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from onboard.autopilot import Landed, Snapshot
from onboard.frames import enu_from_ned
from onboard.safety.limits import LOCAL_POSITION_FRESH_S
from onboard.tuples import Xyz

# Published standard deviations of position and velocity in flight. With larger values, the other
# vehicles' margins would push them out of the geofence.
_STD_M = 0.3
_STD_M_S = 0.3

# PX4's position is not used after this time without poses. Most vehicles have landed by then.
_TRUSTED_S = 12.0
_OFFSET_TIME_S = 1.0  # time constant of the offset of PX4's frame

# Largest error of PX4's position: _ERROR_M, plus _ERROR_M_S2 times the square of the time without
# poses. During most of that time, Covey's dead reckoning corrects the offset of PX4's frame.
_ERROR_M = 0.3
_ERROR_M_S2 = 0.02

_NS = 1e-9  # one nanosecond, in seconds


class Px4Motion(NamedTuple):
    """PX4's position and velocity in the fleet frame, with their standard deviations."""

    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    position_std_m: float
    velocity_std_m_s: float


@dataclass(slots=True)
class Px4PositionCheck:
    """PX4's position of one vehicle, converted to the fleet frame by an offset from poses."""

    _offset_m: Xyz | None = None  # position in PX4's frame minus fleet frame; None: not known
    _learned_ns: int = 0  # when the offset was last compared with a pose
    _position_m: Xyz = (0.0, 0.0, 0.0)  # ENU, PX4's frame
    _velocity_m_s: Xyz = (0.0, 0.0, 0.0)  # ENU
    _stamp_ns: int = 0  # time of position and velocity
    _is_up: bool = False  # whether the vehicle is armed and not on the ground
    _landed: Px4Motion | None = None  # of a vehicle that landed without poses, at rest
    _landed_blind_s: float = 0.0  # time without poses before that landing

    def update(
        self,
        snapshot: Snapshot,
        trusted_enu_m: Xyz | None,
        now_ns: int,
        *,
        dead_reckoned_std_m: float | None = None,
    ) -> None:
        """Update PX4's position and its offset at a tick.

        Args:
            snapshot: newest snapshot of PX4.
            trusted_enu_m: the vehicle's estimated position; None if it cannot be trusted.
            now_ns: time of the tick.
            dead_reckoned_std_m: standard deviation of that position [m] if it is dead reckoning,
                otherwise None. Dead reckoning is more accurate than
                PX4's position horizontally, but not vertically.
        """
        has_pose = trusted_enu_m is not None and dead_reckoned_std_m is None
        self._follow_landing(snapshot, has_pose, dead_reckoned_std_m, now_ns)

        if snapshot.local_position_ns == self._stamp_ns:
            return
        dt_s = (snapshot.local_position_ns - self._stamp_ns) * _NS
        self._stamp_ns = snapshot.local_position_ns
        self._position_m = enu_from_ned(snapshot.position_local_ned_m)
        self._velocity_m_s = enu_from_ned(snapshot.velocity_local_ned_m_s)

        if trusted_enu_m is not None:
            is_dead_reckoned = dead_reckoned_std_m is not None
            self._learn_offset(trusted_enu_m, dt_s, now_ns, is_dead_reckoned)

    def _follow_landing(
        self,
        snapshot: Snapshot,
        has_pose: bool,
        dead_reckoned_std_m: float | None,
        now_ns: int,
    ) -> None:
        """Remember where the vehicle landed without poses; forget it with the next pose.

        A vehicle that landed by dead reckoning is where dead reckoning says. If its standard
        deviation grew after the landing, the other vehicles would leave their places beside it.
        """
        is_up = snapshot.is_armed and snapshot.landed is not Landed.ON_GROUND
        if is_up or has_pose:
            self._landed = None
        elif self._is_up:
            motion = self.motion(now_ns)
            if motion is not None:
                std_m = motion.position_std_m
                if dead_reckoned_std_m is not None:
                    std_m = dead_reckoned_std_m
                self._landed = Px4Motion(
                    position_enu_m=motion.position_enu_m,
                    velocity_enu_m_s=(0.0, 0.0, 0.0),
                    position_std_m=std_m,
                    velocity_std_m_s=0.0,
                )
            self._landed_blind_s = (now_ns - self._learned_ns) * _NS
        self._is_up = is_up

    def _learn_offset(
        self, trusted_enu_m: Xyz, dt_s: float, now_ns: int, is_dead_reckoned: bool
    ) -> None:
        """Update the offset of PX4's frame from PX4's position and the estimated position."""
        x, y, z = trusted_enu_m
        east, north, up = self._position_m
        offset = (east - x, north - y, up - z)
        new_x, new_y, new_z = offset
        last_offset = self._offset_m

        if is_dead_reckoned:
            if last_offset is not None:  # dead reckoning corrects only the horizontal part
                _, _, last_z = last_offset
                self._offset_m = (new_x, new_y, last_z)
            return

        # a large change means that PX4 has moved its origin
        if last_offset is None or math.dist(offset, last_offset) > _ERROR_M:
            self._offset_m = offset
        else:
            weight = min(1.0, dt_s / _OFFSET_TIME_S)
            last_x, last_y, last_z = last_offset
            self._offset_m = (
                last_x + weight * (new_x - last_x),
                last_y + weight * (new_y - last_y),
                last_z + weight * (new_z - last_z),
            )
        self._learned_ns = now_ns

    def motion(self, now_ns: int) -> Px4Motion | None:
        """Return PX4's position and velocity in the fleet frame; None if they must not be used."""
        if self._landed is not None:
            return self._landed
        if not self._is_up or self._offset_m is None:
            return None

        age_s = (now_ns - self._stamp_ns) * _NS
        blind_s = (now_ns - self._learned_ns) * _NS
        if age_s > LOCAL_POSITION_FRESH_S or blind_s > _TRUSTED_S:
            return None

        x, y, z = self._position_m
        vx, vy, vz = self._velocity_m_s
        offset_x, offset_y, offset_z = self._offset_m
        position_m = (
            x + age_s * vx - offset_x,
            y + age_s * vy - offset_y,
            z + age_s * vz - offset_z,
        )
        return Px4Motion(
            position_enu_m=position_m,
            velocity_enu_m_s=(vx, vy, vz),
            position_std_m=_STD_M,
            velocity_std_m_s=_STD_M_S,
        )

    def contradicts(self, position_enu_m: Xyz, now_ns: int) -> bool | None:
        """Whether PX4's position differs from a pose's position by more than its largest error.

        None if PX4's position must not be used.
        """
        motion = self.motion(now_ns)
        if motion is None:
            return None

        blind_s = (now_ns - self._learned_ns) * _NS
        if self._landed is not None:
            blind_s = self._landed_blind_s
        error_m = _ERROR_M + _ERROR_M_S2 * blind_s * blind_s
        return math.dist(motion.position_enu_m, position_enu_m) > error_m
