"""Converts PX4's local positions to the fleet frame, for vehicles that fly without a mocap.

The local frame of each PX4 has its origin where PX4's estimator started. An offset converts local
positions to the fleet frame. Outdoors, PX4 sends the latitude and longitude of its origin, and the
fleet file contains those of the fleet's origin. Their difference is the horizontal offset. Heights
are measured from the ground under the vehicle, since satellite heights differ by metres.

If the fleet file has no origin, the vehicle is assumed to stand on its take-off spot before its
first flight, and PX4's local frame to begin there. A PX4 or an agent that restarts elsewhere does
not know where the vehicle stands. It then has no position until it has been put on its spot, and
PX4 and the agent have been restarted.

PX4's estimate may jump ("reset"). In the air the offset absorbs a jump, so that the position in the
fleet frame stays continuous. With an origin on Earth the true horizontal offset is known, and the
offset slowly returns to it. A jump in height stays absorbed.

A camera that has lost its track may begin its frame anew. PX4's position then comes back after a
gap, somewhere else. Where it fits the agent's own dead reckoning, the offset stays as it was;
otherwise the vehicle continues at its dead-reckoned position. The height has no gap, because PX4
goes on measuring it, so its jumps are absorbed all the time.

PX4 may also move the origin of its local frame in flight, for instance when a ground station sets
it. Then local position and origin jump together. A new origin counts in the air only if it fits the
jump; one that does not fit may be a packet of somebody else, and suspends the return.

After a landing the vehicle stands on the ground of its take-off spot again, or on the ground that
the fleet file tells where it stands, if that is nearer to the height of its flight. If it stands
elsewhere at a height that PX4's errors do not explain, it keeps the height of its flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from onboard.autopilot import Landed, Snapshot
from onboard.config.earth import east_north_m
from onboard.config.fleet import Origin
from onboard.frames import enu_from_ned
from onboard.localization.dead_reckoning import VerticalMotion
from onboard.safety.limits import LOCAL_POSITION_FRESH_S
from onboard.tuples import Xyz

# A position has jumped if its distance from the expected position exceeds _JUMP_M plus the distance
# that an acceleration of _JUMP_M_S2 may add.
_JUMP_M = 0.3
_JUMP_M_S2 = 3.0

# PX4's local frame has begun on the take-off spot if an agent that starts finds the vehicle within
# this distance of the frame's origin, plus some standard deviations of PX4's position.
_BEGAN_WITHIN_M = 1.0
_BEGAN_SIGMAS = 3.0
_LEAST_DISPLACED_M = 0.01  # of a vehicle whose place is lost although it stands near its spot
# A vehicle as near to its spot when PX4 restarts, and some standard deviations, counts as standing
# on it.
_ON_SPOT_M = 0.5

# After a gap of t, PX4's position fits dead reckoning if the two differ by at most _FITS_M plus
# _FITS_M_S times t plus a share of the distance that the wind's push would move the vehicle.
# In emulation dead reckoning was wrong by 0.31 m after two seconds and 0.72 m after three in calm
# air, in a wind of 3.6 m/s (push of 1.1 m/s^2) by 0.78 and 1.53 m, and in one of 6.7 m/s by 1.28
# and 2.49 m (the worst of four to eight flights each).
_FITS_M = 0.3
_FITS_M_S = 0.15
_FITS_OF_PUSH = 0.2
_LONGEST_GAP_S = 4.0  # in a longer one the vehicle lands, and then stands where it is
# standard deviation of a position that continues dead reckoning, per second of the gap
_RECKONED_STD_M_S = 0.1
# A camera whose heading differs from PX4's for this time (in two reports) has begun its frame anew,
# turned. PX4 may follow such a heading later.
_TURNED_NS = 250_000_000
_WITHOUT_HEADING_NS = 1_000_000_000  # the same without a heading, as PX4 is for a while in any gap
# PX4 aligns its heading at the latest so long after its first position.
_ALIGNING_NS = 1_000_000_000
# After a landing, a position that continues dead reckoning with a larger one is not used.
_STANDS_STD_M = 0.15

_SAME_ORIGIN_M = 1.0  # a new origin fits a jump if the two differ by less

# Farther from its spot, a vehicle that has landed may stand on other ground. PX4's height may be
# wrong by some standard deviations, within these bounds: a barometer drifts by a metre or two in a
# flight.
_SAME_GROUND_WITHIN_M = 2.0
_HEIGHT_SIGMAS = 3.0
_MIN_HEIGHT_ERROR_M = 2.5
_MAX_HEIGHT_ERROR_M = 6.0

_RETURN_M_S = 0.2  # speed at which the offset returns to the true one after a horizontal jump


class _LocalPosition(NamedTuple):
    """A local position as PX4 sent it, in its own frame, ENU."""

    stamp_ns: int
    position_m: Xyz
    velocity_m_s: Xyz


class ReckonedPosition(NamedTuple):
    """Position by the agent's dead reckoning."""

    position_enu_m: Xyz  # in the fleet frame
    push_m_s2: float  # of the wind, horizontally


@dataclass(slots=True)
class LocalFrame:
    """One vehicle's local frame. Call :meth:`take` with each new local position."""

    start_enu_m: Xyz  # the vehicle's take-off spot in the fleet file
    origin: Origin | None  # fleet's origin on Earth; None if only take-off spots are known
    # Height of the ground by the fleet file at a point of the fleet frame [m]; None: level.
    ground_at: Callable[[float, float], float] | None = None
    jumps: int = 0  # number of absorbed jumps
    # Distance from the take-off spot at a restart after which it is not known where the vehicle
    # stands; 0: it is known.
    displaced_m: float = 0.0
    # Standard deviation of the offset, after a gap at which it was found by dead reckoning [m].
    offset_std_m: float = 0.0
    _offset_enu_m: Xyz | None = None  # fleet frame minus local frame; None while not known
    _last: _LocalPosition | None = None  # newest local position that was taken
    _newest: _LocalPosition | None = None  # newest local position
    _has_gap: bool = False  # whether positions were skipped since the last one that was taken
    # since when PX4 has sent positions that were taken, without a restart of it; 0: not yet
    _began_ns: int = 0
    _turned_since_ns: int = 0  # since when the camera's heading differs from PX4's; 0: not now
    _is_doubted: bool = False  # whether a position was believed that only the wind explained
    _is_turned: bool = False  # whether the camera has begun its frame anew, turned
    _has_flown: bool = False
    # Height of the ground on which it has stood since its last flight [m]; None: it has not yet.
    _stands_on_m: float | None = None
    # PX4's origin on Earth that counts: latitude, longitude [deg], altitude [m]
    _px4_origin: Xyz | None = None
    _restarts: int = 0  # how often PX4 had restarted at the newest local position
    _has_px4_lost_it: bool = False  # whether PX4 has restarted away from the take-off spot

    def take(self, snapshot: Snapshot, reckoned: ReckonedPosition | None = None) -> Xyz | None:
        """Return the newest local position in the fleet frame; None if no offset is known.

        An offset is found on the ground only.

        Args:
            snapshot: newest snapshot of PX4, with a new local position.
            reckoned: position by the agent's dead reckoning; None if it is not known.
        """
        self._follow_height(snapshot)
        local = _local_position(snapshot)
        last = self._last
        gap_s = 0.0  # time without positions, if the last one was taken before a gap
        if self._has_gap and last is not None:
            gap_s = (local.stamp_ns - last.stamp_ns) * 1e-9
        self._has_gap = False
        self._turned_since_ns = 0
        self._last = local

        self._notice_restart(snapshot, last, local)
        anchored_m = self._anchored_offset_m(local.position_m, snapshot.global_origin)
        if self.displaced_m > 0.0 or anchored_m is None:
            return None

        if snapshot.is_armed:
            self._has_flown = True
            self._stands_on_m = None
        is_parked = not snapshot.is_armed and snapshot.landed is Landed.ON_GROUND
        if is_parked:
            self._look_where_it_stands(local, reckoned, gap_s)
            if self.displaced_m > 0.0:
                return None
            self._offset_enu_m = self._parked_offset_m(anchored_m, local, snapshot)
            self._px4_origin = snapshot.global_origin
            return self._fleet_position_m(local)

        if self._is_turned:
            return None
        if self._offset_enu_m is None or last is None:
            return None  # an agent that starts in the air cannot know the height of the ground

        # with an origin on Earth PX4 knows itself where it is after a gap
        if gap_s > 0.0 and reckoned is not None and self.origin is None:
            self._continue_after_gap(local, reckoned, gap_s)
        else:
            offset_m = self._absorbed_m(self._offset_enu_m, last, local)
            if self._is_origin_right(offset_m, anchored_m, snapshot):
                self._px4_origin = snapshot.global_origin
                offset_m = _returned_m(offset_m, anchored_m, last, local)
            self._offset_enu_m = offset_m
        return self._fleet_position_m(local)

    def skip(self, snapshot: Snapshot, *, is_turned: bool = False) -> None:
        """Note a local position that is not used; only its height is followed.

        Args:
            snapshot: newest snapshot of PX4.
            is_turned: whether a camera corrects it whose heading differs from PX4's.
        """
        self._has_gap = True
        self._follow_height(snapshot)

        if not is_turned or self._offset_enu_m is None:  # before the first heading
            self._turned_since_ns = 0
        elif self._turned_since_ns == 0:
            self._turned_since_ns = snapshot.local_position_ns
        else:
            turned_ns = snapshot.local_position_ns - self._turned_since_ns
            has_no_heading = math.isnan(snapshot.heading_ratio)
            longest_ns = _WITHOUT_HEADING_NS if has_no_heading else _TURNED_NS
            self._is_turned |= turned_ns > longest_ns

    def turn(self, snapshot: Snapshot) -> None:
        """Note that PX4's heading has jumped: it follows a camera that has begun its frame anew.

        While PX4 aligns its heading, after its start, it jumps by itself.

        Args:
            snapshot: newest snapshot of PX4.
        """
        has_restarted = snapshot.restarts != self._restarts
        if self._began_ns == 0 or has_restarted:
            return
        if snapshot.local_position_ns - self._began_ns > _ALIGNING_NS:
            self._is_turned = True

    def _follow_height(self, snapshot: Snapshot) -> None:
        """Absorb a jump of PX4's height, also while its positions are not taken."""
        newest = self._newest
        if newest is not None and snapshot.local_position_ns <= newest.stamp_ns:
            return
        local = _local_position(snapshot)
        self._newest = local
        if newest is None or self._offset_enu_m is None:
            return

        _, _, jump_z = _difference_m(newest, local)
        if abs(jump_z) > _reach_m(newest, local):
            x, y, z = self._offset_enu_m
            self._offset_enu_m = (x, y, z - jump_z)

    def vertical(self, snapshot: Snapshot, now_ns: int) -> VerticalMotion | None:
        """Return the present height in the fleet frame, and the vertical speed.

        Both stay valid when satellites are lost, because PX4 also measures them with accelerometers
        and a barometer. None while the offset is unknown, or while PX4 sends no local position.

        Args:
            snapshot: newest snapshot of PX4.
            now_ns: time of the tick.
        """
        age_s = (now_ns - snapshot.local_position_ns) * 1e-9
        if self._offset_enu_m is None or age_s > LOCAL_POSITION_FRESH_S:
            return None

        climbing_m_s = enu_from_ned(snapshot.velocity_local_ned_m_s).z
        local_m = enu_from_ned(snapshot.position_local_ned_m).z
        _, _, offset_m = self._offset_enu_m
        return VerticalMotion(
            height_m=local_m + age_s * climbing_m_s + offset_m,
            climbing_m_s=climbing_m_s,
        )

    def _continue_after_gap(
        self, local: _LocalPosition, reckoned: ReckonedPosition, gap_s: float
    ) -> None:
        """Keep the offset if it fits dead reckoning; otherwise continue at the reckoned position.

        A position that only the wind explains is used in the air, where dead reckoning is worse
        then, but not after the landing.

        Args:
            local: first local position after the gap.
            reckoned: position by the agent's dead reckoning.
            gap_s: time since the last local position that was taken.
        """
        assert self._offset_enu_m is not None
        if self._fits(local, reckoned, gap_s):
            return
        if self._fits(local, reckoned, gap_s, push_m_s2=reckoned.push_m_s2):
            self._is_doubted = True
            return

        self.jumps += 1
        _, _, z = self._offset_enu_m
        local_x, local_y, _ = local.position_m
        reckoned_x, reckoned_y, _ = reckoned.position_enu_m
        self.offset_std_m = math.hypot(self.offset_std_m, _RECKONED_STD_M_S * gap_s)
        self._offset_enu_m = (reckoned_x - local_x, reckoned_y - local_y, z)

    def _look_where_it_stands(
        self, local: _LocalPosition, reckoned: ReckonedPosition | None, gap_s: float
    ) -> None:
        """Find out whether the place of a parked vehicle is lost.

        It is if PX4's local frame has moved until it had landed, or has been turned, or if it has
        landed by a position that continued dead reckoning for long or that only the wind explained.
        On the ground nothing has to be believed, so the wind explains nothing here.

        Args:
            local: newest local position.
            reckoned: where it has landed by the agent's dead reckoning; None if it is not known.
            gap_s: time since the last local position that was taken, if there is a gap between the
                two; else 0.
        """
        if self.origin is not None or self._offset_enu_m is None:
            return
        if self._is_place_vague:
            self._lose_place(self._fleet_position_m(local))
            return

        is_back = gap_s > 0.0 and self._has_flown
        if is_back and reckoned is not None and not self._fits(local, reckoned, gap_s):
            self._lose_place(reckoned.position_enu_m)

    @property
    def _is_place_vague(self) -> bool:
        """Whether the place of this flight is not good enough for another one."""
        return self._is_turned or self._is_doubted or self.offset_std_m > _STANDS_STD_M

    def _lose_place(self, likely_enu_m: Xyz) -> None:
        """Give up the place of a vehicle that stands, until it is put on its spot.

        Args:
            likely_enu_m: where it likely stands, in the fleet frame.
        """
        away_m = math.dist(likely_enu_m[:2], self.start_enu_m[:2])
        self.displaced_m = max(away_m, _LEAST_DISPLACED_M)
        self._has_px4_lost_it = True
        self._forget_offset()

    def _fits(
        self,
        local: _LocalPosition,
        reckoned: ReckonedPosition,
        gap_s: float,
        *,
        push_m_s2: float = 0.0,
    ) -> bool:
        """Return whether a position after a gap is where dead reckoning expects it.

        Args:
            local: first local position after the gap.
            reckoned: position by the agent's dead reckoning.
            gap_s: time since the last local position that was taken.
            push_m_s2: push of the wind that may explain a difference.
        """
        here_m = self._fleet_position_m(local)
        miss_m = math.dist(here_m[:2], reckoned.position_enu_m[:2])

        reckoned_s = min(gap_s, _LONGEST_GAP_S)
        pushed_m = 0.5 * push_m_s2 * reckoned_s * reckoned_s
        return miss_m <= _FITS_M + _FITS_M_S * reckoned_s + _FITS_OF_PUSH * pushed_m

    def _fleet_position_m(self, local: _LocalPosition) -> Xyz:
        """Return a local position in the fleet frame; the offset must be known."""
        assert self._offset_enu_m is not None
        x, y, z = self._offset_enu_m
        local_x, local_y, local_z = local.position_m
        return local_x + x, local_y + y, local_z + z

    def _forget_offset(self) -> None:
        self._offset_enu_m = None
        self.offset_std_m = 0.0
        self._is_doubted = False

    def _notice_restart(
        self, snapshot: Snapshot, last: _LocalPosition | None, local: _LocalPosition
    ) -> None:
        """Begin anew, or give the place up, where PX4 or this agent has restarted.

        Args:
            snapshot: newest snapshot of PX4.
            last: previous local position.
            local: newest local position.
        """
        has_restarted = snapshot.restarts != self._restarts
        self._restarts = snapshot.restarts
        if has_restarted or self._began_ns == 0:
            self._began_ns = local.stamp_ns

        if self.origin is None:
            self._look_where_it_began(snapshot, last, local, has_restarted=has_restarted)
        elif has_restarted:
            self._forget_offset()  # it belonged to the earlier local frame
            self._has_flown = False

    def _look_where_it_began(
        self,
        snapshot: Snapshot,
        last: _LocalPosition | None,
        local: _LocalPosition,
        *,
        has_restarted: bool,
    ) -> None:
        """Find out whether PX4's local frame begins on the take-off spot.

        Args:
            snapshot: newest snapshot of PX4.
            last: previous local position.
            local: newest local position.
            has_restarted: whether PX4 has restarted since the previous local position.
        """
        if self._has_px4_lost_it:
            return

        wandered_m = _BEGAN_SIGMAS * snapshot.position_accuracy_m
        if self._offset_enu_m is None:
            # This agent has just started; PX4 may have flown before. Poses of another program may
            # also be in the fleet's frame; then the local position is the spot itself.
            local_m = local.position_m[:2]
            away_m = math.hypot(*local_m)
            nearest_m = min(away_m, math.dist(local_m, self.start_enu_m[:2]))
            self.displaced_m = 0.0
            if nearest_m > _BEGAN_WITHIN_M + wandered_m:
                self.displaced_m = away_m
            return

        if not has_restarted or not self._has_flown or last is None:
            return
        stood_enu_m = self._fleet_position_m(last)
        away_m = math.dist(stood_enu_m[:2], self.start_enu_m[:2])
        if away_m > _ON_SPOT_M + wandered_m or self._is_place_vague:
            self._lose_place(stood_enu_m)
        else:
            self._forget_offset()
            self._has_flown = False

    def _parked_offset_m(self, anchored_m: Xyz, local: _LocalPosition, snapshot: Snapshot) -> Xyz:
        """Return the offset of a vehicle that is parked.

        Args:
            anchored_m: offset from the origins on Earth or the take-off spot.
            local: newest local position.
            snapshot: newest snapshot of PX4.
        """
        x, y, z = anchored_m
        if self._offset_enu_m is None or not self._has_flown:
            return anchored_m

        flown_x, flown_y, flown_z = self._offset_enu_m
        if self.origin is None:
            # the anchored offset is correct only before the first flight
            x, y = flown_x, flown_y

        local_x, local_y, local_z = local.position_m
        at_m = (local_x + x, local_y + y)
        flown_m = local_z + flown_z
        if self._stands_on_m is None:
            self._stands_on_m = self._likely_ground_m(at_m, flown_m)
        _, _, start_m = self.start_enu_m
        z += self._stands_on_m - start_m

        away_m = math.dist(at_m, self.start_enu_m[:2])
        reported_m = _HEIGHT_SIGMAS * snapshot.height_accuracy_m
        error_m = min(max(reported_m, _MIN_HEIGHT_ERROR_M), _MAX_HEIGHT_ERROR_M)
        higher_m = abs(flown_m - self._stands_on_m)
        if away_m > _SAME_GROUND_WITHIN_M and higher_m > error_m:
            z = flown_z
        return x, y, z

    def _likely_ground_m(self, at_m: tuple[float, float], flown_m: float) -> float:
        """Return the height [m] of the ground that a vehicle has landed on.

        Args:
            at_m: where it stands, in the fleet frame.
            flown_m: height at which its flight has ended.
        """
        _, _, start_m = self.start_enu_m
        if self.ground_at is None:
            return start_m
        here_m = self.ground_at(*at_m)
        return min((start_m, here_m), key=lambda ground_m: abs(flown_m - ground_m))

    def _is_origin_right(self, offset_m: Xyz, anchored_m: Xyz, snapshot: Snapshot) -> bool:
        """Return whether the offset may return to the one from PX4's present origin, in the air.

        Args:
            offset_m: present offset, which has absorbed the newest jump.
            anchored_m: offset from the origins on Earth.
            snapshot: newest snapshot of PX4.
        """
        if self.origin is None:
            return False
        if snapshot.global_origin == self._px4_origin:
            return True
        return math.dist(offset_m[:2], anchored_m[:2]) < _SAME_ORIGIN_M

    def _anchored_offset_m(self, local_m: Xyz, px4_origin: Xyz | None) -> Xyz | None:
        """Return the offset from the origins on Earth, or without them from the take-off spot.

        The height always assumes a vehicle on the ground at its take-off spot. The result is None
        if the fleet has an origin on Earth and PX4 has not sent its origin yet.
        """
        x, y, z = (start - here for start, here in zip(self.start_enu_m, local_m, strict=True))
        if self.origin is None:
            return x, y, z

        if px4_origin is None:
            return None
        latitude_deg, longitude_deg, _ = px4_origin
        east_m, north_m = east_north_m(self.origin, latitude_deg, longitude_deg)
        return east_m, north_m, z

    def _absorbed_m(self, offset_m: Xyz, last: _LocalPosition, local: _LocalPosition) -> Xyz:
        """Return the offset in the air, after a horizontal jump of PX4's position if there was one.

        Args:
            offset_m: present offset.
            last: previous local position.
            local: newest local position.
        """
        jump_x, jump_y, _ = _difference_m(last, local)
        if math.hypot(jump_x, jump_y) <= _reach_m(last, local):
            return offset_m

        self.jumps += 1
        x, y, z = offset_m
        return x - jump_x, y - jump_y, z


def _difference_m(last: _LocalPosition, local: _LocalPosition) -> Xyz:
    """Return how far a local position is from where the last one's velocity leads [m].

    Args:
        last: previous local position.
        local: newest local position.
    """
    dt_s = (local.stamp_ns - last.stamp_ns) * 1e-9
    x, y, z = (
        here - before - speed * dt_s
        for here, before, speed in zip(
            local.position_m, last.position_m, last.velocity_m_s, strict=True
        )
    )
    return x, y, z


def _reach_m(last: _LocalPosition, local: _LocalPosition) -> float:
    """Return the largest such difference [m] that is a motion; a larger one is a jump.

    An acceleration a moves the vehicle by 0.5 a t^2. The bound is more generous: a t^2, and a t
    within less than a second.
    """
    dt_s = (local.stamp_ns - last.stamp_ns) * 1e-9
    return _JUMP_M + _JUMP_M_S2 * dt_s * max(1.0, dt_s)


def _local_position(snapshot: Snapshot) -> _LocalPosition:
    return _LocalPosition(
        stamp_ns=snapshot.local_position_ns,
        position_m=enu_from_ned(snapshot.position_local_ned_m),
        velocity_m_s=enu_from_ned(snapshot.velocity_local_ned_m_s),
    )


def _returned_m(offset_m: Xyz, anchored_m: Xyz, last: _LocalPosition, local: _LocalPosition) -> Xyz:
    """Return the offset after a slow return towards the true one; the height stays.

    Args:
        offset_m: present offset.
        anchored_m: true offset from the origins on Earth.
        last: previous local position.
        local: newest local position.
    """
    x, y, z = offset_m
    true_x, true_y, _ = anchored_m
    remaining_m = math.hypot(true_x - x, true_y - y)
    if remaining_m == 0.0:
        return offset_m

    dt_s = (local.stamp_ns - last.stamp_ns) * 1e-9
    moved_share = min(1.0, _RETURN_M_S * dt_s / remaining_m)
    return x + moved_share * (true_x - x), y + moved_share * (true_y - y), z
