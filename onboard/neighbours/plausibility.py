"""Whether what a neighbour says of itself can be true. Pure.

A neighbour that publishes its state with a valid key may still lie, or be mistaken. So its state is
compared with physics, with its own prediction, and with the motion capture. One contradiction is an
estimator that began anew; several are none. Whatever accuracy a vehicle says of itself is granted,
because distances cover it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from onboard.tuples import Xyz

_JUMP_M = 0.35  # beyond what its velocity explains
_MISS_M = 0.4  # from where the motion capture sees it
_MOST_M_S2 = 30.0
_NOISE_M_S = 1.0
_STDS = 2.0
_LONGEST_S = 0.5  # between two states, or between a state and a pose, that are compared

# Contradictions until it counts as contradicted: by physics so many within some seconds, by the
# mocap so many in a row.
_JUMPS = 2
_MISSES = 3
_REMEMBERED_NS = 3_000_000_000


class Claim(NamedTuple):
    """State of a neighbour as its message says it, in fleet ENU."""

    stamp_ns: int
    position_enu_m: Xyz
    velocity_enu_m_s: Xyz
    predicted_position_enu_m: Xyz
    predicted_velocity_enu_m_s: Xyz
    lead_time_s: float  # from the stamp to the prediction
    position_std_m: float


class Seen(NamedTuple):
    """Position of a neighbour's body by the motion capture."""

    stamp_ns: int
    position_enu_m: Xyz


def physical_contradiction(before: Claim | None, claim: Claim, largest_m_s: float) -> str:
    """Return what is impossible in a neighbour's state; "" if nothing is.

    Args:
        before: an earlier state of it; None without one.
        claim: its newest state.
        largest_m_s: speed [m/s] that it never has.
    Returns:
        words that follow the vehicle's name.
    Properties: translation-invariant.
    """
    speed_m_s = math.hypot(*claim.velocity_enu_m_s)
    if speed_m_s > largest_m_s:
        return f"says that it flies {speed_m_s:.0f} m/s"

    slack_m = _JUMP_M + _STDS * claim.position_std_m
    lead_s = min(max(claim.lead_time_s, 0.0), 1.0)
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
    if change_m_s > _NOISE_M_S + _MOST_M_S2 * dt_s:
        return "changes its velocity faster than a vehicle can"
    return ""


def mocap_contradiction(claim: Claim, seen: Seen) -> str:
    """Return how a neighbour's state contradicts the motion capture; "" if it does not.

    Args:
        claim: its newest state.
        seen: its body.
    Returns:
        words that follow the vehicle's name.
    """
    dt_s = (seen.stamp_ns - claim.stamp_ns) * 1e-9
    if abs(dt_s) > _LONGEST_S:
        return ""

    x, y, z = claim.position_enu_m
    vx, vy, vz = claim.velocity_enu_m_s
    expected_enu_m = (x + dt_s * vx, y + dt_s * vy, z + dt_s * vz)
    miss_m = math.dist(expected_enu_m, seen.position_enu_m)

    explained_m = _MISS_M + _STDS * claim.position_std_m + 0.5 * _MOST_M_S2 * dt_s * dt_s
    if miss_m <= explained_m:
        return ""
    return f"says that it is {miss_m:.1f} m from where the mocap sees it"


def _miss_m(claim: Claim, position_enu_m: Xyz, velocity_enu_m_s: Xyz, after_s: float) -> float:
    """Return how far a later position is from where the mean of both velocities leads.

    What an acceleration within the limits may add to that is taken off.
    """
    px, py, pz = claim.position_enu_m
    vx, vy, vz = claim.velocity_enu_m_s
    wx, wy, wz = velocity_enu_m_s

    half_s = 0.5 * after_s
    expected_enu_m = (px + half_s * (vx + wx), py + half_s * (vy + wy), pz + half_s * (vz + wz))
    granted_m = 0.125 * _MOST_M_S2 * after_s * after_s
    return math.dist(expected_enu_m, position_enu_m) - granted_m


@dataclass(slots=True)
class PlausibilityMonitor:
    """Memory of what contradicts one neighbour."""

    largest_m_s: float  # speed that it never has
    reason: str = ""  # why it is contradicted, in words that follow its name; "" while it is not
    is_watched: bool = False  # something contradicts it, or did some seconds ago
    _before: Claim | None = None
    _seen_ns: int = 0  # stamp of the pose that was compared last
    _jumps: int = 0  # contradictions by physics, of the last seconds
    _misses: int = 0  # contradictions by the mocap, in a row
    _contradicted_ns: int = 0  # the last time

    def look(self, claim: Claim, seen: Seen | None, now_ns: int) -> None:
        """Compare a neighbour's newest state with what is known otherwise.

        Args:
            claim: its newest state.
            seen: newest position of its body; None where no motion capture sees one.
            now_ns: our clock.
        """
        if now_ns - self._contradicted_ns > _REMEMBERED_NS:
            self.reason = ""
            self.is_watched = False
            self._jumps = 0

        contradiction = ""
        if self._before is None or claim.stamp_ns > self._before.stamp_ns:
            contradiction = physical_contradiction(self._before, claim, self.largest_m_s)
            if contradiction:
                self._jumps += 1
            self._before = claim

        if seen is not None and seen.stamp_ns > self._seen_ns:
            self._seen_ns = seen.stamp_ns
            miss = mocap_contradiction(claim, seen)
            self._misses = self._misses + 1 if miss else 0
            contradiction = contradiction or miss

        if not contradiction:
            return
        self._contradicted_ns = now_ns
        self.is_watched = True
        is_several = self._jumps >= _JUMPS or self._misses >= _MISSES
        if is_several and not self.reason:
            self.reason = contradiction
