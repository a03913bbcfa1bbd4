"""Chooses the neighbours whose states this vehicle receives at full rate. Pure.

Every vehicle publishes its state twice: 50 times a second for its followers and 5 times a second
for all others. A vehicle follows the neighbours within reach, and always the nearest few. From all
other vehicles it receives only the slow messages.

Vehicles that are silent or have no position yet are not followed. Their first slow message will
give their position. Their messages may have been lost on a full radio channel, and following them
all would fill it further.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz

FAR_PERIOD_TICKS = 10  # period of the slow messages: 5 Hz
FAR_SILENT_S = 0.75  # a neighbour is silent after this time; three slow messages are then missing
FAR_UNSEEN_S = FAR_SILENT_S + 0.35  # after this time, poses of its body should have arrived
SELECT_TICKS = 10  # number of ticks between two choices
ALWAYS_FOLLOWED = 4  # number of nearest neighbours that are followed at any distance

# Time from when a vehicle comes within reach until it is avoided: a slow message, the choice, the
# subscription, and the law's prediction over its lag.
_NOTICE_S = 0.8
_STAY_FRAC = 1.15  # a followed neighbour is dropped only beyond this multiple of the reach


def is_slow(sequence: int) -> bool:
    """Return whether the state message of this sequence is also sent to all others."""
    return sequence % FAR_PERIOD_TICKS == 0


def reach_m(fleet: FleetConfig, name: str) -> float:
    """Return the distance [m] within which a vehicle follows its neighbours.

    Even if two vehicles fly at each other at the top speed of avoidance, they notice each other and
    brake before they reach the safety distance.
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
    """Return how far [m] a vehicle flies until it has noticed another vehicle and stopped."""
    return speed_m_s * (_NOTICE_S + 0.5 * speed_m_s / brake_m_s2)


def select(
    distances_m: Mapping[str, float], followed: frozenset[str], reach_m: float, most: int
) -> frozenset[str]:
    """Select the neighbours to follow from now on.

    Args:
        distances_m: neighbour -> distance, for all neighbours that have ever published a position.
        followed: neighbours followed now. They are dropped at a larger distance than new ones are
            added, so that the choice does not oscillate.
        reach_m: reach, from :func:`reach_m`.
        most: at most this many neighbours within reach are followed: the nearest. The law uses no
            more, and the radio may not carry more.
    Returns:
        Names of the selected neighbours.
    """
    by_distance = sorted(distances_m, key=distances_m.__getitem__)

    # distances, reduced for neighbours that are already followed
    reduced_m = {}
    for name, distance_m in distances_m.items():
        reduced_m[name] = distance_m
        if name in followed:
            reduced_m[name] = distance_m / _STAY_FRAC

    in_reach = [name for name in by_distance if reduced_m[name] < reach_m]
    nearest = sorted(in_reach, key=reduced_m.__getitem__)[:most]
    return frozenset(nearest).union(by_distance[:ALWAYS_FOLLOWED])


def most_near(fleet: FleetConfig, spots: Mapping[str, Xyz]) -> int:
    """Return the largest number of neighbours that a vehicle of a constellation follows.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU; at least two vehicles.
    """
    most = 0
    for name, position_enu_m in spots.items():
        dropped_beyond_m = _STAY_FRAC * reach_m(fleet, name)
        near_count = 0
        for other, other_enu_m in spots.items():
            distance_m = math.dist(position_enu_m[:2], other_enu_m[:2])
            if other != name and distance_m < dropped_beyond_m:
                near_count += 1
        most = max(most, near_count)

    followed = max(ALWAYS_FOLLOWED, min(most, int(fleet.law.max_neighbours)))
    return min(len(spots) - 1, followed)
