"""PX4's own position beside the motion capture's: it contradicts poses that jumped, and remains
when poses are lost.

It lags and drifts, so nothing flies by it while there are poses. But PX4 measures accelerations: it
would have felt a jump of the vehicle. Rejected poses never reach PX4, so they cannot change its
position either. A vehicle that comes down while its poses are rejected counts as lying where it
came down, until a pose agrees. Before a flight PX4's position does not count, since people carry
vehicles about.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.autopilot import Landed, Snapshot, Vec3
from onboard.frames import enu_from_ned

# published; a margin for more would push the other vehicles out of the geofence
STD_M, STD_M_S = 0.3, 0.3
_FRESH_S = 0.25  # it arrives at 10 Hz
_TRUSTED_S = 12.0  # without poses it is dead reckoning; by then most vehicles are down
# Largest error: at first, and growing with the time without poses, for most of which it is the own
# dead reckoning's.
_ERROR_M, _ERROR_M_S2 = 0.3, 0.02
_OFFSET_TIME_S = 1.0
_NS = 1e-9


@dataclass(slots=True)
class Px4PositionCheck:
    """PX4's position of one vehicle, in the fleet's frame once poses have shown the offset of PX4's
    frame.
    """

    _offset_m: Vec3 | None = None  # of PX4's frame
    _learned_ns: int = 0  # when the offset was last compared with a pose
    _position_m: Vec3 = (0.0, 0.0, 0.0)  # ENU, PX4's frame
    _velocity_m_s: Vec3 = (0.0, 0.0, 0.0)
    _stamp_ns: int = 0
    _is_up: bool = False
    # where it came down while poses were rejected, in the fleet's frame
    _landed_m: Vec3 | None = None
    _blind_s: float = 0.0  # time without poses until then

    def update(
        self,
        snapshot: Snapshot,
        believed_enu_m: Vec3 | None,
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
        is_up = snapshot.is_armed and snapshot.landed is not Landed.ON_GROUND
        if is_up or (believed_enu_m is not None and not is_reckoned):
            self._landed_m = None
        elif self._is_up:
            motion = self.motion(now_ns)
            self._landed_m, self._blind_s = (
                (None if motion is None else motion[0]),
                (now_ns - self._learned_ns) * _NS,
            )
        self._is_up = is_up
        if snapshot.local_position_ns == self._stamp_ns:
            return
        dt_s, self._stamp_ns = (
            (snapshot.local_position_ns - self._stamp_ns) * _NS,
            snapshot.local_position_ns,
        )
        self._position_m = enu_from_ned(snapshot.position_local_ned_m)
        self._velocity_m_s = enu_from_ned(snapshot.velocity_local_ned_m_s)
        if believed_enu_m is None:
            return
        x, y, z = believed_enu_m
        east, north, up = self._position_m
        offset = east - x, north - y, up - z
        known, share = self._offset_m, min(1.0, dt_s / _OFFSET_TIME_S)
        if is_reckoned:
            self._offset_m = None if known is None else (east - x, north - y, known[2])
            return
        if known is None or math.dist(offset, known) > _ERROR_M:  # PX4 has moved its origin
            self._offset_m = offset
        else:
            a, b, c = known
            self._offset_m = (
                a + share * (offset[0] - a),
                b + share * (offset[1] - b),
                c + share * (offset[2] - c),
            )
        self._learned_ns = now_ns

    def motion(self, now_ns: int) -> tuple[Vec3, Vec3] | None:
        """Return position and velocity in the fleet's frame; None while PX4 sends none, or none
        that can be trusted.
        """
        if self._landed_m is not None:
            return self._landed_m, (0.0, 0.0, 0.0)
        age_s, blind_s = (now_ns - self._stamp_ns) * _NS, (now_ns - self._learned_ns) * _NS
        if not self._is_up or self._offset_m is None or age_s > _FRESH_S or blind_s > _TRUSTED_S:
            return None
        (x, y, z), (u, v, w), (a, b, c) = self._position_m, self._velocity_m_s, self._offset_m
        return (x + age_s * u - a, y + age_s * v - b, z + age_s * w - c), (u, v, w)

    def contradicts(self, position_enu_m: Vec3, now_ns: int) -> bool:
        """Whether PX4's position excludes this one."""
        motion = self.motion(now_ns)
        blind_s = self._blind_s if self._landed_m is not None else (now_ns - self._learned_ns) * _NS
        error_m = _ERROR_M + _ERROR_M_S2 * blind_s * blind_s
        return motion is not None and math.dist(motion[0], position_enu_m) > error_m
