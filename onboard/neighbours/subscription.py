"""Choice of the neighbours whose states are received at full rate. Pure.

Every vehicle publishes its state twice: 50 times a second for its followers and 5 times a second
for all. A vehicle follows the neighbours in reach, and in any case the nearest few.

From all others it receives the slow messages only. That holds also for vehicles that are silent or
have no position yet: the first slow message that comes says where such a vehicle is. To follow them
all would fill a radio channel that has just lost their messages because it is full.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz

FAR_PERIOD_TICKS = 10  # of the slow messages: 5 Hz
FAR_SILENT_S = 0.75  # three of them missing
FAR_UNSEEN_S = FAR_SILENT_S + 0.35  # by then poses of its body should have come
SELECT_TICKS = 10  # between two choices
ALWAYS_FOLLOWED = 4

# Time until a vehicle that comes into reach is avoided: a slow message, the choice, the
# subscription, and the law's prediction over its lag.
_NOTICE_S = 0.8
_STAY_FRAC = 1.15  # a neighbour that is followed stays so up to this much farther away


def is_slow(sequence: int) -> bool:
    """Return whether the state message of this number is also sent to all."""
    return sequence % FAR_PERIOD_TICKS == 0


def reach_m(fleet: FleetConfig, name: str) -> float:
    """Return the distance from which a vehicle follows its neighbours.

    Two vehicles that fly at each other as fast as avoidance lets them are still so far apart when
    both have noticed that braking keeps the safety distance.
    """
    own = fleet.vehicles[name]
    others = [vehicle for other, vehicle in fleet.vehicles.items() if other != name]
    if not others:
        others = [own]

    share = fleet.law.avoid_speed_frac
    own_m = _noticed_and_braked_m(share * own.max_speed_m_s, own.max_acceleration_m_s2)
    other_m = _noticed_and_braked_m(
        share * max(other.max_speed_m_s for other in others),
        min(other.max_acceleration_m_s2 for other in others),
    )
    return min(fleet.law.range_m, fleet.fleet.safety_distance_m + (own_m + other_m))


def _noticed_and_braked_m(speed_m_s: float, brake_m_s2: float) -> float:
    """Return how far a vehicle flies until it has noticed another one and stands."""
    return speed_m_s * (_NOTICE_S + 0.5 * speed_m_s / brake_m_s2)


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
    by_distance = sorted(distances_m, key=distances_m.__getitem__)

    reduced_m = {}
    for name, distance_m in distances_m.items():
        is_followed = name in followed
        reduced_m[name] = distance_m / _STAY_FRAC if is_followed else distance_m

    in_reach = [name for name in by_distance if reduced_m[name] < reach_m]
    nearest = sorted(in_reach, key=reduced_m.__getitem__)[:most]
    return frozenset(nearest).union(by_distance[:ALWAYS_FOLLOWED])


def most_near(fleet: FleetConfig, spots: Mapping[str, Xyz]) -> int:
    """Return how many neighbours a vehicle of a constellation follows at most.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU; at least two.
    """
    most = 0
    for name, position_enu_m in spots.items():
        follows_m = _STAY_FRAC * reach_m(fleet, name)
        near = 0
        for other, other_enu_m in spots.items():
            distance_m = math.dist(position_enu_m[:2], other_enu_m[:2])
            if other != name and distance_m < follows_m:
                near += 1
        most = max(most, near)

    followed = max(ALWAYS_FOLLOWED, min(most, int(fleet.law.max_neighbours)))
    return min(len(spots) - 1, followed)
