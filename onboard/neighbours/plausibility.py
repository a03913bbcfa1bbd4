"""Checks whether a neighbour's published state can be true. Pure.

A neighbour with a valid key may still lie, or be mistaken. So its state is compared with physics,
with its own prediction, and with the motion capture. A single contradiction may come from a reset
of its estimator, but several cannot. The published accuracy is not checked. If it is worse than the
truth, others only keep a larger distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from onboard.tuples import Xyz

_JUMP_M = 0.35  # allowed difference between a position and the position that velocities explain
_MISS_M = 0.4  # allowed difference between a position and the mocap's
_MAX_M_S2 = 30.0  # largest acceleration of a vehicle
# A vehicle may accelerate sideways by this for half of the time between two states, and back for
# the other half.
_ASIDE_M_S2 = 15.0
_NOISE_M_S = 1.0  # allowed error of a change of velocity
_STDS = 2.0  # this many published standard deviations are allowed on top
_LONGEST_LEAD_S = 1.0  # a larger lead in a message is clipped to this
_LONGEST_S = 0.5  # states and poses farther apart in time are not compared

# A neighbour counts as contradicted after _JUMPS contradictions by physics within _REMEMBERED_NS,
# or _MISSES contradictions by the mocap in a row.
_JUMPS = 2
_MISSES = 3
_REMEMBERED_NS = 3_000_000_000


class Claim(NamedTuple):
    """State of a neighbour from its own message, in fleet ENU."""

    stamp_ns: int
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    predicted_position_enu_m: Xyz
    predicted_velocity_enu_m_s: Xyz
    lead_time_s: float  # from the stamp to the prediction
    position_std_m: float


class MocapPosition(NamedTuple):
    """Position of a neighbour's body from the motion capture."""

    stamp_ns: int
    position_enu_m: Xyz


def physical_contradiction(before: Claim | None, claim: Claim, largest_m_s: float) -> str:
    """Return what is impossible in a neighbour's state; empty if nothing is impossible.

    Args:
        before: its previous state; None if there is none.
        claim: its newest state.
        largest_m_s: largest possible speed [m/s].
    Returns:
        Words that follow the vehicle's name in a sentence.
    Properties: translation-invariant.
    """
    speed_m_s = math.hypot(*claim.velocity_enu_m_s)
    if speed_m_s > largest_m_s:
        return f"says that it flies {speed_m_s:.0f} m/s"

    slack_m = _JUMP_M + _STDS * claim.position_std_m
    lead_s = min(max(claim.lead_time_s, 0.0), _LONGEST_LEAD_S)
    predicted_miss_m = _miss_m(
        claim, claim.predicted_position_enu_m, claim.predicted_velocity_enu_m_s, lead_s
    )
    if predicted_miss_m > slack_m:
        return "predicts another place than its velocity leads to"

    if before is None:
        return ""
    dt_s = (claim.stamp_ns - before.stamp_ns) * 1e-9
    if not 0.0 < dt_s < _LONGEST_S:
        return ""

    miss_m = _miss_m(before, claim.position_enu_m, claim.velocity_enu_m_s, dt_s)
    if miss_m > slack_m:
        moved_m = math.dist(before.position_enu_m, claim.position_enu_m)
        return (
            f"says that it moved {moved_m:.1f} m in {dt_s:.1f} s, "
            "which its velocity does not explain"
        )

    change_m_s = math.dist(before.velocity_enu_m_s, claim.velocity_enu_m_s)
    if change_m_s > _NOISE_M_S + _MAX_M_S2 * dt_s:
        return "changes its velocity faster than a vehicle can"
    return ""


def mocap_contradiction(claim: Claim, mocap: MocapPosition) -> str:
    """Return how a neighbour's state contradicts the motion capture; empty if it does not.

    Args:
        claim: its newest state.
        mocap: newest mocap position of its body.
    Returns:
        Words that follow the vehicle's name in a sentence.
    """
    dt_s = (mocap.stamp_ns - claim.stamp_ns) * 1e-9
    if abs(dt_s) > _LONGEST_S:
        return ""

    x, y, z = claim.position_enu_m
    vx, vy, vz = claim.velocity_enu_m_s
    expected_enu_m = (x + dt_s * vx, y + dt_s * vy, z + dt_s * vz)
    miss_m = math.dist(expected_enu_m, mocap.position_enu_m)

    explained_m = _MISS_M + _STDS * claim.position_std_m + 0.5 * _MAX_M_S2 * dt_s * dt_s
    if miss_m <= explained_m:
        return ""
    return f"says that it is {miss_m:.1f} m from where the mocap sees it"


def _miss_m(claim: Claim, position_enu_m: Xyz, velocity_enu_m_s: Xyz, after_s: float) -> float:
    """Return the distance [m] of a later position from the position expected from both velocities.

    The expected position follows from the mean of both velocities. An acceleration to one side and
    back leaves both velocities unchanged. It moves the vehicle by a * t^2 / 4, which is subtracted.
    """
    px, py, pz = claim.position_enu_m
    vx, vy, vz = claim.velocity_enu_m_s
    wx, wy, wz = velocity_enu_m_s

    half_s = 0.5 * after_s
    expected_enu_m = (px + half_s * (vx + wx), py + half_s * (vy + wy), pz + half_s * (vz + wz))
    aside_m = 0.25 * _ASIDE_M_S2 * after_s * after_s
    return math.dist(expected_enu_m, position_enu_m) - aside_m


@dataclass(slots=True)
class PlausibilityMonitor:
    """Memory of what contradicts one neighbour."""

    largest_m_s: float  # largest possible speed
    reason: str = ""  # why it is contradicted, in words that follow its name; empty if it is not
    is_watched: bool = False  # whether there was a contradiction within the last seconds
    _before: Claim | None = None  # its previous state
    _compared_ns: int = 0  # stamp of the last compared pose
    # number of contradictions by physics (position, speed or prediction) within the last seconds
    _jumps: int = 0
    _misses: int = 0  # number of contradictions by the mocap in a row
    _contradicted_ns: int = 0  # time of the last contradiction

    def update(self, claim: Claim, mocap: MocapPosition | None, now_ns: int) -> None:
        """Compare a neighbour's newest state with physics and the motion capture.

        Args:
            claim: its newest state.
            mocap: newest mocap position of its body; None if there is none.
            now_ns: our clock.
        """
        if now_ns - self._contradicted_ns > _REMEMBERED_NS:
            self.reason = ""
            self.is_watched = False
            self._jumps = 0
            self._misses = 0

        contradiction = ""
        if self._before is None or claim.stamp_ns > self._before.stamp_ns:
            contradiction = physical_contradiction(self._before, claim, self.largest_m_s)
            if contradiction:
                self._jumps += 1
            self._before = claim

        if mocap is not None and mocap.stamp_ns > self._compared_ns:
            self._compared_ns = mocap.stamp_ns
            miss = mocap_contradiction(claim, mocap)
            if miss:
                self._misses += 1
            else:
                self._misses = 0
            if not contradiction:
                contradiction = miss

        if not contradiction:
            return
        self._contradicted_ns = now_ns
        self.is_watched = True
        is_several = self._jumps >= _JUMPS or self._misses >= _MISSES
        if is_several and not self.reason:
            self.reason = contradiction
