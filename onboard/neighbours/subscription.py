"""Whom to hear at full rate: the vehicles that could matter before the next slow message says so. Pure.

Everybody publishes its state twice: 50 times a second for those who follow it and 5 times a second for all. A vehicle
follows who is in reach, and the nearest few in any case; the rest is heard slowly, and nothing else is sent to it.
"""

from __future__ import annotations

from collections.abc import Mapping

from onboard.config.fleet import FleetConfig

FAR_PERIOD_TICKS = 10  # the slow messages: 5 Hz
FAR_SILENT_S = 0.75  # three of them missing
CHOOSE_TICKS = 10
ALWAYS_FOLLOWED = 4
_NOTICE_S = 0.8  # a slow message, the choice, the subscription, and the law's prediction over its lag
_STAY_FRAC = 1.15


def is_slow(sequence: int) -> bool:
    """Whether the state of this number is also one of the slow ones."""
    return sequence % FAR_PERIOD_TICKS == 0


def reach_m(fleet: FleetConfig, name: str) -> float:
    """Distance [m] from which a vehicle is followed.

    Two vehicles that fly at each other as fast as avoidance lets them are still so far apart when both have noticed
    that braking keeps the safety distance.
    """
    own = fleet.vehicles[name]
    others = [fleet.vehicles[other] for other in fleet.enabled_names if other != name] or [own]
    share = fleet.law.avoid_speed_frac
    speeds = [share * own.max_speed_m_s, share * max(other.max_speed_m_s for other in others)]
    brakes = [own.max_acceleration_m_s2, min(other.max_acceleration_m_s2 for other in others)]
    ways = [v * (_NOTICE_S + 0.5 * v / a) for v, a in zip(speeds, brakes, strict=True)]
    return min(fleet.law.range_m, fleet.fleet.safety_distance_m + sum(ways))


def chosen(
    distances_m: Mapping[str, float], unplaced: frozenset[str], followed: frozenset[str], reach_m: float
) -> frozenset[str]:
    """Whom to follow from now on.

    Args:
        distances_m: of all that ever told a position.
        unplaced: who is there and tells none: could be anywhere.
        followed: so far; who is in it leaves a little later than it came.
        reach_m: from :func:`reach_m`.
    """
    near = sorted(distances_m, key=distances_m.__getitem__)
    wide_m = _STAY_FRAC * reach_m
    inside = {name for name in near if distances_m[name] < (wide_m if name in followed else reach_m)}
    return frozenset(inside.union(near[:ALWAYS_FOLLOWED], unplaced))
