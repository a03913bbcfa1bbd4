"""Choice of the neighbours whose states are received at full rate. Pure.

Every vehicle publishes its state twice: 50 times a second for its followers and 5 times a second
for all. A vehicle follows the neighbours in reach, and in any case the nearest few. From all others
it receives the slow messages only, also from whoever is silent or has no position yet: the first
slow message that comes says where it is, and following them all would fill a radio channel that has
just lost their messages because it is full.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from onboard.config.fleet import FleetConfig, Vec3

FAR_PERIOD_TICKS = 10  # of the slow messages: 5 Hz
FAR_SILENT_S = 0.75  # three of them missing
# then its body is followed in the mocap, and should have been seen
FAR_UNSEEN_S = FAR_SILENT_S + 0.35
SELECT_TICKS = 10  # between two choices
ALWAYS_FOLLOWED = 4
# a slow message, the choice, the subscription, and the law's prediction over its lag
_NOTICE_S = 0.8
_STAY_FRAC = 1.15


def is_slow(sequence: int) -> bool:
    """Whether the state message of this number is also sent to all."""
    return sequence % FAR_PERIOD_TICKS == 0


def reach_m(fleet: FleetConfig, name: str) -> float:
    """Return the distance from which a vehicle follows its neighbours.

    Two vehicles that fly at each other as fast as avoidance lets them are still so far apart when
    both have noticed that braking keeps the safety distance.
    """
    own = fleet.vehicles[name]
    others = [vehicle for other, vehicle in fleet.vehicles.items() if other != name] or [own]
    share = fleet.law.avoid_speed_frac
    speeds = [share * own.max_speed_m_s, share * max(other.max_speed_m_s for other in others)]
    brakes = [own.max_acceleration_m_s2, min(other.max_acceleration_m_s2 for other in others)]
    distances = [v * (_NOTICE_S + 0.5 * v / a) for v, a in zip(speeds, brakes, strict=True)]
    return min(fleet.law.range_m, fleet.fleet.safety_distance_m + sum(distances))


def select(
    distances_m: Mapping[str, float], followed: frozenset[str], reach_m: float, most: int
) -> frozenset[str]:
    """Select the neighbours to follow from now on.

    Args:
        distances_m: neighbour -> distance, of all that ever published a position.
        followed: so far; a neighbour that is followed is dropped a little farther away than it was
            added.
        reach_m: from :func:`reach_m`.
        most: so many of those in reach, the nearest: the law uses no more, and the radio may not
            carry more.
    Returns:
        their names.
    """
    near = sorted(distances_m, key=distances_m.__getitem__)
    reduced_m = {
        name: far_m / _STAY_FRAC if name in followed else far_m
        for name, far_m in distances_m.items()
    }
    inside = sorted((name for name in near if reduced_m[name] < reach_m), key=reduced_m.__getitem__)
    return frozenset(inside[:most]).union(near[:ALWAYS_FOLLOWED])


def most_near(fleet: FleetConfig, spots: Mapping[str, Vec3]) -> int:
    """Return how many neighbours a vehicle of a constellation follows at most.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU; at least two.
    """
    counts = [
        sum(
            math.dist(spots[name][:2], spot[:2]) < _STAY_FRAC * reach_m(fleet, name)
            for spot in spots.values()
        )
        - 1
        for name in spots
    ]
    return min(
        len(spots) - 1, max(ALWAYS_FOLLOWED, min(max(counts), int(fleet.law.max_neighbours)))
    )
