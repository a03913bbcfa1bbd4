"""Chooses the mocap poses that are sent to PX4's estimator. Pure.

PX4 gets poses so that its own hold and land modes work indoors. It follows any pose, so only poses
that the pose validator accepts are sent, 33 times a second.

Without accepted poses nothing is sent, and PX4's estimator reports that it has lost its position.
When poses return, PX4's estimate has drifted too far, so PX4 rejects them. A changed reset counter
makes PX4 restart its estimate at the pose. In the air the counter changes only if the pose is near
PX4's own position, because a wrong pose may belong to another body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.agent_commands import SendOdometry
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import MocapPose
from onboard.frames import enu_from_ned
from onboard.tuples import Xyz

_PERIOD_NS = 30_000_000  # PX4 requires 30 to 50 Hz
_EARLY_NS = 6_000_000  # a pose may be sent this early

_STD_M = 0.01  # standard deviation of a pose

# After a longer gap, PX4 must restart its estimate. PX4 notices missing poses only after a second,
# during which the estimate drifts by a few decimetres.
_GAP_NS = 300_000_000

# Between two poses, a vehicle moves by at most _STEP_M, plus _STEP_M_S for each second.
_STEP_M = 0.2
_STEP_M_S = 6.0

# PX4 may restart its estimate at a pose within this distance of PX4's own position: _NEAR_M, plus
# _DRIFT_M_S for each second without poses, and at most _FAR_M. Without poses PX4 drifts by 0.5 to
# 1.3 m in six seconds. _FAR_M excludes the position of another vehicle.
_NEAR_M = 0.3
_DRIFT_M_S = 0.15
_FAR_M = 0.7
# The first pose of an agent that starts in the air restarts PX4's estimate, whose counter is from
# before. Until then PX4 had no poses for some seconds, and has drifted by less than this.
_FIRST_FAR_M = 1.5
_FRESH_NS = 300_000_000  # an older position of PX4 is not used


@dataclass(slots=True)
class OdometryForwarder:
    """Memory of the last pose sent."""

    resets: int = 0  # reset counter; MAVLink has eight bits for it
    _sent_ns: int = 0  # time at which the last pose was sent
    _due_ns: int = 0  # time at which the next pose is due
    _stamp_ns: int = 0  # stamp of the last pose
    _position_enu_m: Xyz | None = None  # position of the last pose; None before the first

    def take(self, pose: MocapPose, snapshot: Snapshot, now_ns: int) -> list[SendOdometry]:
        """Return the command that sends an accepted pose; empty if it must not be sent now."""
        if self._position_enu_m is not None:
            if now_ns < self._due_ns - _EARLY_NS:
                return []

            if not self._continues(pose, self._position_enu_m):
                silent_ns = now_ns - self._sent_ns
                if not _may_restart(pose.position_enu_m, snapshot, now_ns, silent_ns):
                    return []
                self.resets = (self.resets + 1) % 256
        elif _is_elsewhere(pose.position_enu_m, snapshot, now_ns):
            return []

        self._sent_ns = now_ns
        self._stamp_ns = pose.stamp_ns
        self._position_enu_m = pose.position_enu_m
        self._due_ns = max(self._due_ns, now_ns - _PERIOD_NS) + _PERIOD_NS
        return [
            SendOdometry(
                position_enu_m=pose.position_enu_m,
                quaternion_enu_flu_wxyz=pose.quaternion_enu_flu_wxyz,
                std_m=_STD_M,
                reset_count=self.resets,
            )
        ]

    def _continues(self, pose: MocapPose, last_enu_m: Xyz) -> bool:
        """Whether PX4's estimator can follow from the last sent pose to this one."""
        gap_ns = pose.stamp_ns - self._stamp_ns
        if not 0 <= gap_ns <= _GAP_NS:
            return False
        reach_m = _STEP_M + _STEP_M_S * gap_ns * 1e-9
        return math.dist(pose.position_enu_m, last_enu_m) <= reach_m


def _is_elsewhere(position_enu_m: Xyz, snapshot: Snapshot, now_ns: int) -> bool:
    """Whether PX4 flies so far from a first pose that the pose must be of another body.

    Args:
        position_enu_m: position of the pose.
        snapshot: newest snapshot of PX4.
        now_ns: time of the tick.
    """
    if not snapshot.is_armed or snapshot.landed is Landed.ON_GROUND:
        return False
    if now_ns - snapshot.local_position_ns > _FRESH_NS:
        return False  # PX4 does not know where it is, and needs the pose
    return _px4_distance_m(position_enu_m, snapshot) > _FIRST_FAR_M


def _may_restart(position_enu_m: Xyz, snapshot: Snapshot, now_ns: int, silent_ns: int) -> bool:
    """Whether PX4 may restart its estimate at a pose.

    Args:
        position_enu_m: position of the pose.
        snapshot: newest snapshot of PX4.
        now_ns: time of the tick.
        silent_ns: time since the last pose was sent.
    """
    if not snapshot.is_armed or snapshot.landed is Landed.ON_GROUND:
        return True
    if now_ns - snapshot.local_position_ns > _FRESH_NS:
        return False

    near_m = min(_NEAR_M + _DRIFT_M_S * silent_ns * 1e-9, _FAR_M)
    return _px4_distance_m(position_enu_m, snapshot) <= near_m


def _px4_distance_m(position_enu_m: Xyz, snapshot: Snapshot) -> float:
    """Return the distance of a position from PX4's own.

    PX4's local frame is the fleet frame, because PX4 gets its position from these poses.
    """
    return math.dist(position_enu_m, enu_from_ned(snapshot.position_local_ned_m))
