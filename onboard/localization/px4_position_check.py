"""PX4's own position beside the motion capture's: what contradicts a pose that jumped, and what is left without poses.

It lags and wanders, so nothing flies by it while there are poses. But it knows of accelerations what no camera can get
wrong: a body that really jumped would have felt it. Poses that are not believed never reach PX4, so they cannot talk it
round either. Who comes down without being believed lies where it came down, until a pose says so too. On the ground
before a flight people carry vehicles about, and PX4 has no say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.autopilot import Landed, Snapshot, Vec3
from onboard.frames import enu_from_ned

STD_M, STD_M_S = 0.3, 0.3  # told to the others: a margin for more would push them out of the fence
_FRESH_S = 0.25  # it comes at 10 Hz
_TRUSTED_S = 8.0  # without poses it is dead reckoning; by then most vehicles are down
# How wrong it may be: at first, and more with the time without poses. Real ones were off by 0.5 to 1.3 m after 6 s.
_WRONG_M, _WORSE_M_S2 = 0.3, 0.02
_LEARN_S = 1.0
_NS = 1e-9


@dataclass(slots=True)
class Px4PositionCheck:
    """Where PX4 believes one vehicle to be, in the fleet's frame as long as poses showed how PX4's lies in it."""

    _offset_m: Vec3 | None = None  # of PX4's frame
    _learned_ns: int = 0
    _position_m: Vec3 = (0.0, 0.0, 0.0)  # ENU, PX4's frame
    _velocity_m_s: Vec3 = (0.0, 0.0, 0.0)
    _stamp_ns: int = 0
    _is_up: bool = False
    _lies_m: Vec3 | None = None  # where it came down unbelieved, in the fleet's frame, after so long without poses
    _blind_s: float = 0.0

    def look(self, snapshot: Snapshot, believed_enu_m: Vec3 | None, now_ns: int) -> None:
        """Once a tick; ``believed_enu_m``: where the vehicle is while its poses are believed."""
        is_up = snapshot.is_armed and snapshot.landed is not Landed.ON_GROUND
        if believed_enu_m is not None or is_up:
            self._lies_m = None
        elif self._is_up:
            place = self.place(now_ns)
            self._lies_m, self._blind_s = (None if place is None else place[0]), (now_ns - self._learned_ns) * _NS
        self._is_up = is_up
        if snapshot.local_position_ns == self._stamp_ns:
            return
        dt_s, self._stamp_ns = (snapshot.local_position_ns - self._stamp_ns) * _NS, snapshot.local_position_ns
        self._position_m = enu_from_ned(snapshot.position_local_ned_m)
        self._velocity_m_s = enu_from_ned(snapshot.velocity_local_ned_m_s)
        if believed_enu_m is None:
            return
        x, y, z = believed_enu_m
        east, north, up = self._position_m
        found = east - x, north - y, up - z
        known, share = self._offset_m, min(1.0, dt_s / _LEARN_S)
        if known is None or math.dist(found, known) > _WRONG_M:  # PX4 has moved its origin
            self._offset_m = found
        else:
            a, b, c = known
            self._offset_m = a + share * (found[0] - a), b + share * (found[1] - b), c + share * (found[2] - c)
        self._learned_ns = now_ns

    def place(self, now_ns: int) -> tuple[Vec3, Vec3] | None:
        """Position and velocity in the fleet's frame; None while PX4 says nothing, or nothing that can be trusted."""
        if self._lies_m is not None:
            return self._lies_m, (0.0, 0.0, 0.0)
        age_s, blind_s = (now_ns - self._stamp_ns) * _NS, (now_ns - self._learned_ns) * _NS
        if not self._is_up or self._offset_m is None or age_s > _FRESH_S or blind_s > _TRUSTED_S:
            return None
        (x, y, z), (u, v, w), (a, b, c) = self._position_m, self._velocity_m_s, self._offset_m
        return (x + age_s * u - a, y + age_s * v - b, z + age_s * w - c), (u, v, w)

    def contradicts(self, position_enu_m: Vec3, now_ns: int) -> bool:
        """Whether PX4 believes to be somewhere else."""
        place = self.place(now_ns)
        blind_s = self._blind_s if self._lies_m is not None else (now_ns - self._learned_ns) * _NS
        wrong_m = _WRONG_M + _WORSE_M_S2 * blind_s * blind_s
        return place is not None and math.dist(place[0], position_enu_m) > wrong_m
