"""How much of the distance to a neighbour counts, by the heights of the two: all of it, a part, or
none. Pure.

Unset, vehicles are endless vertical cylinders. With ``vertical_separation_m`` a pair that is
farther apart in height, now and in what both are about to do, does not constrain each other at all.
Before the heights come that near the distance to keep grows from 0 to its whole, so that a vehicle
that climbs or sinks towards another is pushed aside in time. DEVIATION D16.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.params import Spacing
from onboard.avoidance.prediction import lead_time, message_age
from onboard.types import Neighbour

INTENT_S = (
    # an intended vertical velocity times this is the way left to the goal, or as far as it goes in
    # that time
    2.0
)
# beyond the vertical separation, over which the distance grows where nobody moves
TRANSITION_M = 0.2
_MOTION_S = 0.4  # a climb goes on for so long, whatever is intended: longer than it takes to brake
# of the way that both go, over which the distance grows: the rest is flown at the whole of it
_GROWTH_SHARE = 0.5
HEIGHT_SIGMAS = 4.5  # of both positions
_LARGEST_STD_M = 1e3
_STALE_S = 0.25  # a message of this age says nothing about heights any more


class Climb(NamedTuple):
    """Vertical motion of one vehicle; NaN: not known."""

    height_m: float  # now
    ahead_m: float  # at the own t + L
    velocity_m_s: float
    way_m: float  # that it intends to go from there within INTENT_S, upwards
    position_std_m: float


def share_of(own: Climb, neighbour: Neighbour, own_lead_s: float, spacing: Spacing) -> float:
    """Return the share of the distance to a neighbour that counts, from 0 (none) to 1 (as for
    cylinders).

    Args:
        own: this vehicle.
        neighbour: as received. One that does not cooperate lands, falls or is silent: it claims all
            below itself, and also all above while it is silent or its intent is not known and it
            moves.
        own_lead_s: from now to the own t + L.
        spacing: holds the vertical separation; infinite: always 1.
    Properties: the same for both vehicles of a pair that know the same; translation-invariant.
    """
    if math.isinf(spacing.vertical_separation_m):
        return 1.0
    other = climb_of(neighbour, own_lead_s)
    gap_now, gap_ahead = own.height_m - other.height_m, own.ahead_m - other.ahead_m
    sigma_m = HEIGHT_SIGMAS * math.hypot(_known(own.position_std_m), _known(other.position_std_m))
    near = spacing.vertical_separation_m + sigma_m
    side = 1.0 if gap_ahead >= 0.0 else -1.0  # whether this vehicle is above
    closing_m_s = -side * (own.velocity_m_s - other.velocity_m_s)
    towards_m = max(0.0, _MOTION_S * closing_m_s, -side * (own.way_m - other.way_m))
    claims_column = not neighbour.is_cooperative and side < 0.0
    is_known = math.isfinite(gap_now + gap_ahead + closing_m_s + own.way_m + other.way_m)
    if claims_column or not is_known or message_age(neighbour) > _STALE_S:
        return 1.0
    smallest = min(side * gap_now, abs(gap_ahead))
    left = near + TRANSITION_M + towards_m - smallest
    return min(max(left / (TRANSITION_M + _GROWTH_SHARE * towards_m), 0.0), 1.0)


def is_ahead(own: Climb, neighbour: Neighbour, own_lead_s: float, spacing: Spacing) -> bool:
    """Whether this vehicle climbs or sinks towards a neighbour that is still a vertical separation
    away.

    Args:
        own: this vehicle.
        neighbour: as received.
        own_lead_s: from now to the own t + L.
        spacing: holds the vertical separation.
    """
    gap_m = own.ahead_m - climb_of(neighbour, own_lead_s).ahead_m
    towards_m = -own.way_m if gap_m >= 0.0 else own.way_m
    return abs(gap_m) >= spacing.vertical_separation_m and towards_m > TRANSITION_M


def climb_of(neighbour: Neighbour, own_lead_s: float) -> Climb:
    """Return a neighbour's vertical motion at the own time; straight on from its plain estimate if
    it tells no more.

    Args:
        neighbour: as received.
        own_lead_s: from now to the own t + L.
    """
    age_s = message_age(neighbour)
    z, v_z = neighbour.position_enu_m.z, neighbour.velocity_enu_m_s.z
    now_m, std_m = z + age_s * v_z, neighbour.position_std_m
    if not neighbour.is_cooperative:
        return Climb(now_m, now_m + own_lead_s * v_z, v_z, INTENT_S * v_z, std_m)
    ahead_s = age_s + own_lead_s - lead_time(neighbour.lead_time_s, own_lead_s)
    ahead_m = (
        neighbour.predicted_position_enu_m.z + ahead_s * neighbour.predicted_velocity_enu_m_s.z
    )
    return Climb(
        now_m,
        ahead_m,
        neighbour.predicted_velocity_enu_m_s.z,
        INTENT_S * neighbour.intent_enu_m_s.z,
        std_m,
    )


def _known(std_m: float) -> float:
    return min(abs(std_m), _LARGEST_STD_M) if math.isfinite(std_m) else 0.0
