"""PX4's own position beside the motion capture's.

It contradicts poses that jumped, and remains when poses are lost. It lags and drifts, so nothing
flies by it while there are poses. But PX4 measures accelerations: it would have felt a jump of the
vehicle. Rejected poses never reach PX4, so they cannot change its position either.

A vehicle that comes down while its poses are rejected counts as lying where it came down, until a
pose agrees. Before a flight PX4's position does not count, since people carry vehicles about.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.autopilot import Landed, Snapshot
from onboard.frames import enu_from_ned
from onboard.safety.limits import LOCAL_POSITION_FRESH_S
from onboard.tuples import Xyz

# Published standard deviations of position and velocity; a margin for more would push the other
# vehicles out of the geofence.
STD_M = 0.3
STD_M_S = 0.3

_TRUSTED_S = 12.0  # without poses it is dead reckoning; by then most vehicles are down
_OFFSET_TIME_S = 1.0  # time constant of the offset of PX4's frame

# Largest error: at first, and growing with the time without poses, for most of which it is the own
# dead reckoning's.
_ERROR_M = 0.3
_ERROR_M_S2 = 0.02

_NS = 1e-9  # seconds in a nanosecond


@dataclass(slots=True)
class Px4PositionCheck:
    """PX4's position of one vehicle, in the fleet's frame once poses have shown the offset."""

    _offset_m: Xyz | None = None  # PX4's frame minus the fleet's; None while not known
    _learned_ns: int = 0  # when the offset was last compared with a pose
    _position_m: Xyz = (0.0, 0.0, 0.0)  # ENU, PX4's frame
    _velocity_m_s: Xyz = (0.0, 0.0, 0.0)  # ENU
    _stamp_ns: int = 0  # of both
    _is_up: bool = False  # armed and not on the ground
    # where it came down while poses were rejected, in the fleet's frame
    _landed_m: Xyz | None = None
    _landed_blind_s: float = 0.0  # time without poses until then

    def update(
        self,
        snapshot: Snapshot,
        believed_enu_m: Xyz | None,
        now_ns: int,
        *,
        is_reckoned: bool = False,
    ) -> None:
        """Take one tick.

        Args:
            snapshot: newest of PX4.
            believed_enu_m: the vehicle's position, None while its poses are not believed.
            now_ns: time of the tick.
            is_reckoned: that position rests on own dead reckoning, which is better than PX4's but
                for the height.
        """
        has_pose = believed_enu_m is not None and not is_reckoned
        self._follow_landing(snapshot, has_pose, now_ns)

        if snapshot.local_position_ns == self._stamp_ns:
            return
        dt_s = (snapshot.local_position_ns - self._stamp_ns) * _NS
        self._stamp_ns = snapshot.local_position_ns
        self._position_m = enu_from_ned(snapshot.position_local_ned_m)
        self._velocity_m_s = enu_from_ned(snapshot.velocity_local_ned_m_s)

        if believed_enu_m is not None:
            self._learn_offset(believed_enu_m, dt_s, now_ns, is_reckoned)

    def _follow_landing(self, snapshot: Snapshot, has_pose: bool, now_ns: int) -> None:
        """Remember where the vehicle came down without poses; forget it with the next pose."""
        is_up = snapshot.is_armed and snapshot.landed is not Landed.ON_GROUND
        if is_up or has_pose:
            self._landed_m = None
        elif self._is_up:
            motion = self.motion(now_ns)
            self._landed_m = None if motion is None else motion[0]
            self._landed_blind_s = (now_ns - self._learned_ns) * _NS
        self._is_up = is_up

    def _learn_offset(
        self, believed_enu_m: Xyz, dt_s: float, now_ns: int, is_reckoned: bool
    ) -> None:
        """Compare PX4's position with the believed one."""
        x, y, z = believed_enu_m
        east, north, up = self._position_m
        offset = (east - x, north - y, up - z)
        known = self._offset_m

        if is_reckoned:
            if known is not None:  # horizontally only
                self._offset_m = (offset[0], offset[1], known[2])
            return

        has_moved_origin = known is None or math.dist(offset, known) > _ERROR_M
        if known is None or has_moved_origin:
            self._offset_m = offset
        else:
            share = min(1.0, dt_s / _OFFSET_TIME_S)
            self._offset_m = (
                known[0] + share * (offset[0] - known[0]),
                known[1] + share * (offset[1] - known[1]),
                known[2] + share * (offset[2] - known[2]),
            )
        self._learned_ns = now_ns

    def motion(self, now_ns: int) -> tuple[Xyz, Xyz] | None:
        """Return position and velocity in the fleet's frame.

        None while PX4 sends none, or none that can be trusted.
        """
        if self._landed_m is not None:
            return self._landed_m, (0.0, 0.0, 0.0)
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
        return position_m, (vx, vy, vz)

    def contradicts(self, position_enu_m: Xyz, now_ns: int) -> bool:
        """Whether PX4's position excludes this one."""
        motion = self.motion(now_ns)
        if motion is None:
            return False

        blind_s = (now_ns - self._learned_ns) * _NS
        if self._landed_m is not None:
            blind_s = self._landed_blind_s
        error_m = _ERROR_M + _ERROR_M_S2 * blind_s * blind_s
        return math.dist(motion[0], position_enu_m) > error_m
