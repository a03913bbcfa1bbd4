"""PX4's local frame in the fleet's, for vehicles that fly without a mocap.

Each PX4 has an origin of its own: where its estimator started. Outdoors PX4 sends the position of
that origin on Earth, and the fleet file gives the position of the fleet's; the difference is the
horizontal offset. Heights are measured from the ground under the vehicle, since satellite heights
differ by metres. Without a global origin, the first take-off spot is taken to be that of the fleet
file.

PX4's estimate may jump ("reset"). In the air the offset absorbs a jump, so that nothing downstream
notices it. A horizontal jump is given back slowly where a global origin shows the right offset; a
jump in height is absorbed for good, because the ground was measured before it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.autopilot import Landed, Snapshot
from onboard.config.fleet import Origin, Vec3
from onboard.frames import enu_from_ned

_EARTH_RADIUS_M = 6_371_000.0  # of the sphere that PX4 projects its local frame from
_JUMP_M, _JUMP_M_S2 = 0.3, 3.0
_GIVE_BACK_M_S = 0.2


@dataclass(slots=True)
class LocalFrame:
    """One vehicle's local frame; :meth:`take` each new local position."""

    start_enu_m: Vec3  # the vehicle's take-off spot in the fleet file
    origin: Origin | None  # of the fleet on Earth; None if only take-off spots are known
    jumps: int = 0
    _offset_enu_m: Vec3 | None = None
    _last: tuple[int, Vec3, Vec3] | None = None
    _has_flown: bool = False

    def take(self, snapshot: Snapshot) -> Vec3 | None:
        """Return the newest local position in the fleet frame; None while the local frame's offset
        is not known.
        """
        local, velocity = (
            enu_from_ned(snapshot.position_local_ned_m),
            enu_from_ned(snapshot.velocity_local_ned_m_s),
        )
        now_ns = snapshot.local_position_ns
        last, self._last = self._last, (now_ns, local, velocity)
        anchored = self._anchored_m(local, snapshot)
        is_parked = not snapshot.is_armed and snapshot.landed is Landed.ON_GROUND
        self._has_flown = self._has_flown or snapshot.is_armed
        if anchored is None:
            return None
        if self._offset_enu_m is None or (
            is_parked and (self.origin is not None or not self._has_flown)
        ):
            self._offset_enu_m = anchored
        elif is_parked:
            self._offset_enu_m = (self._offset_enu_m[0], self._offset_enu_m[1], anchored[2])
        elif last is not None:
            self._absorb(last, local, anchored, now_ns)
        x, y, z = self._offset_enu_m
        return local[0] + x, local[1] + y, local[2] + z

    def _anchored_m(self, local: Vec3, snapshot: Snapshot) -> Vec3 | None:
        """Return the offset while the vehicle stands on the ground."""
        x, y, z = (start - here for start, here in zip(self.start_enu_m, local, strict=True))
        if self.origin is None:
            return x, y, z
        if snapshot.global_origin is None:
            return None
        east_m, north_m = _east_north_m(self.origin, snapshot.global_origin)
        return east_m, north_m, z

    def _absorb(
        self, last: tuple[int, Vec3, Vec3], local: Vec3, anchored: Vec3, now_ns: int
    ) -> None:
        assert self._offset_enu_m is not None
        last_ns, before, velocity = last
        dt_s = (now_ns - last_ns) * 1e-9
        jump = tuple(p - b - v * dt_s for p, b, v in zip(local, before, velocity, strict=True))
        x, y, z = self._offset_enu_m
        if math.hypot(*jump) > _JUMP_M + _JUMP_M_S2 * dt_s * max(1.0, dt_s):
            self.jumps += 1
            x, y, z = x - jump[0], y - jump[1], z - jump[2]
        if self.origin is not None:
            miss = math.hypot(anchored[0] - x, anchored[1] - y)
            share = min(1.0, _GIVE_BACK_M_S * dt_s / miss) if miss > 0.0 else 0.0
            x, y = x + share * (anchored[0] - x), y + share * (anchored[1] - y)
        self._offset_enu_m = x, y, z


def _east_north_m(origin: Origin, position: Vec3) -> tuple[float, float]:
    """Return east and north [m] of a position (latitude deg, longitude deg, altitude m) from the
    fleet's origin.

    Azimuthal equidistant on PX4's sphere, the projection that PX4 uses for its local positions.
    """
    here, there = math.radians(origin.latitude_deg), math.radians(position[0])
    turn = math.radians(position[1] - origin.longitude_deg)
    cosine = math.sin(here) * math.sin(there) + math.cos(here) * math.cos(there) * math.cos(turn)
    angle = math.acos(min(1.0, max(-1.0, cosine)))
    scale = _EARTH_RADIUS_M * (angle / math.sin(angle) if angle > 1e-7 else 1.0)
    east = scale * math.cos(there) * math.sin(turn)
    north = scale * (
        math.cos(here) * math.sin(there) - math.sin(here) * math.cos(there) * math.cos(turn)
    )
    return east, north
