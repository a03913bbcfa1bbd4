"""Choice of the neighbours whose states are received at full rate. Pure.

Every vehicle publishes its state twice: 50 times a second for its followers and 5 times a second for all. A vehicle
follows the neighbours in reach, and in any case the nearest few. From all others it receives the slow messages only.
"""

from __future__ import annotations

from collections.abc import Mapping

from onboard.config.fleet import FleetConfig

FAR_PERIOD_TICKS = 10  # of the slow messages: 5 Hz
FAR_SILENT_S = 0.75  # three of them missing
SELECT_TICKS = 10  # between two choices
ALWAYS_FOLLOWED = 4
_NOTICE_S = 0.8  # a slow message, the choice, the subscription, and the law's prediction over its lag
_STAY_FRAC = 1.15


def is_slow(sequence: int) -> bool:
    """Whether the state message of this number is also sent to all."""
    return sequence % FAR_PERIOD_TICKS == 0


def reach_m(fleet: FleetConfig, name: str) -> float:
    """Return the distance from which a vehicle follows its neighbours.

    Two vehicles that fly at each other as fast as avoidance lets them are still so far apart when both have noticed
    that braking keeps the safety distance.
    """
    own = fleet.vehicles[name]
    others = [vehicle for other, vehicle in fleet.vehicles.items() if other != name] or [own]
    share = fleet.law.avoid_speed_frac
    speeds = [share * own.max_speed_m_s, share * max(other.max_speed_m_s for other in others)]
    brakes = [own.max_acceleration_m_s2, min(other.max_acceleration_m_s2 for other in others)]
    distances = [v * (_NOTICE_S + 0.5 * v / a) for v, a in zip(speeds, brakes, strict=True)]
    return min(fleet.law.range_m, fleet.fleet.safety_distance_m + sum(distances))


def select(
    distances_m: Mapping[str, float], unknown: frozenset[str], followed: frozenset[str], reach_m: float
) -> frozenset[str]:
    """Select the neighbours to follow from now on.

    Args:
        distances_m: neighbour -> distance, of all that ever published a position.
        unknown: neighbours that are there without a position: they could be anywhere.
        followed: so far; a neighbour that is followed is dropped a little farther away than it was added.
        reach_m: from :func:`reach_m`.
    Returns:
        their names.
    """
    near = sorted(distances_m, key=distances_m.__getitem__)
    wide_m = _STAY_FRAC * reach_m
    inside = {name for name in near if distances_m[name] < (wide_m if name in followed else reach_m)}
    return frozenset(inside.union(near[:ALWAYS_FOLLOWED], unknown))
