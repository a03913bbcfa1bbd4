"""How much of the distance to keep counts for a pair, given the heights of the two vehicles.

Without ``vertical_separation_m`` every vehicle is an endless vertical cylinder. With it, two
vehicles do not constrain each other while their heights differ by more than this separation, now
and in the motion that both intend. As the difference falls to the separation, the distance to keep
grows from 0 to its full value. So a vehicle that climbs or sinks towards another is pushed aside in
time. DEVIATION D16.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.params import Spacing
from onboard.avoidance.prediction import known_std, lead_time, message_age
from onboard.types import Neighbour

# An intended vertical velocity is the remaining climb to the goal divided by this time, but at most
# the top climb speed.
INTENT_S = 2.0

# A climb is expected to continue for at least this time, which is longer than braking takes.
_MOTION_S = 0.4

# For a pair without vertical motion: height, on top of the vertical separation, over which the
# distance to keep grows from 0 to its full value.
TRANSITION_M = 0.2

# For a pair that closes in height: the distance grows over this share of the height that the two
# are about to lose. They fly the rest of that height at the full distance.
_GROWTH_SHARE = 0.5

# Deceleration with which a vehicle that sinks above others stops. It could brake harder.
_SINK_BRAKE_M_S2 = 1.0

HEIGHT_SIGMAS = 4.5  # standard deviations of the height difference that count as uncertain
_STALE_S = 0.25  # heights in messages older than this do not count


class Climb(NamedTuple):
    """Vertical motion of one vehicle; NaN: not known."""

    height_m: float  # height now
    ahead_m: float  # height at t + L, with the lead time L of this agent's own vehicle
    velocity_m_s: float
    intended_climb_m: float  # after t + L, within INTENT_S; negative: it descends
    position_std_m: float


def share_of(own: Climb, neighbour: Neighbour, own_lead_s: float, spacing: Spacing) -> float:
    """Return the share of the distance to a neighbour that counts.

    It goes from 0 (none) to 1 (as for cylinders).

    Args:
        own: this vehicle.
        neighbour: the neighbour as received. If it does not cooperate, it may land, fall or be
            silent, so the whole column below it counts. While its message is stale, or its motion
            or intent is not finite, the columns below and above it count.
        own_lead_s: time L from now to this vehicle's t + L.
        spacing: holds the vertical separation; if that is infinite, the share is always 1.
    Properties: the same for both vehicles of a pair that know the same; translation-invariant.
    """
    if math.isinf(spacing.vertical_separation_m):
        return 1.0

    other = climb_of(neighbour, own_lead_s)
    gap_now_m = own.height_m - other.height_m
    gap_ahead_m = own.ahead_m - other.ahead_m
    side = 1.0 if gap_ahead_m >= 0.0 else -1.0  # +1: this vehicle is above

    closing_m_s = -side * (own.velocity_m_s - other.velocity_m_s)
    intended_closing_m = -side * (own.intended_climb_m - other.intended_climb_m)

    # a sum is finite only if all of its terms are finite
    total = gap_now_m + gap_ahead_m + closing_m_s + own.intended_climb_m + other.intended_climb_m
    if not math.isfinite(total):
        return 1.0
    if message_age(neighbour) > _STALE_S:
        return 1.0
    if not neighbour.is_cooperative and side < 0.0:
        return 1.0  # the whole column below the neighbour counts

    own_std_m = known_std(own.position_std_m)
    other_std_m = known_std(other.position_std_m)
    sigma_m = HEIGHT_SIGMAS * math.hypot(own_std_m, other_std_m)
    near_m = spacing.vertical_separation_m + sigma_m
    towards_m = max(0.0, _MOTION_S * closing_m_s, intended_closing_m)
    smallest_gap_m = min(side * gap_now_m, abs(gap_ahead_m))

    # the distance starts to grow at the gap begin_m, and is full when the gap is growth_m smaller
    begin_m = near_m + TRANSITION_M + towards_m
    growth_m = TRANSITION_M + _GROWTH_SHARE * towards_m
    return min(max((begin_m - smallest_gap_m) / growth_m, 0.0), 1.0)


def is_ahead(own: Climb, neighbour: Neighbour, own_lead_s: float, spacing: Spacing) -> bool:
    """Return whether this vehicle intends to climb or sink towards a neighbour.

    False while their heights differ by less than the vertical separation.

    Args:
        own: this vehicle.
        neighbour: the neighbour as received.
        own_lead_s: time L from now to this vehicle's t + L.
        spacing: holds the vertical separation.
    """
    gap_m = own.ahead_m - climb_of(neighbour, own_lead_s).ahead_m
    towards_m = -own.intended_climb_m if gap_m >= 0.0 else own.intended_climb_m
    return abs(gap_m) >= spacing.vertical_separation_m and towards_m > TRANSITION_M


def sink_limit_m_s(own: Climb, neighbour: Neighbour, own_lead_s: float, spacing: Spacing) -> float:
    """Return the speed [m/s] at which this vehicle may sink above a neighbour.

    At this speed it can still stop at the vertical separation above the neighbour. The speed is
    infinite if this vehicle is not above the neighbour.

    Args:
        own: this vehicle.
        neighbour: the neighbour as received.
        own_lead_s: time L from now to this vehicle's t + L.
        spacing: holds the vertical separation.
    """
    other = climb_of(neighbour, own_lead_s)
    gap_m = own.ahead_m - other.ahead_m
    if not gap_m >= 0.0:  # also for NaN: a height that is not known
        return math.inf

    braking_m = max(0.0, gap_m - spacing.vertical_separation_m)
    return max(0.0, -other.velocity_m_s) + math.sqrt(2.0 * _SINK_BRAKE_M_S2 * braking_m)


def climb_of(neighbour: Neighbour, own_lead_s: float) -> Climb:
    """Return a neighbour's vertical motion, now and at this vehicle's t + L.

    A neighbour that does not cooperate is extrapolated at constant velocity from its plain
    estimate, because its predictions do not count.

    Args:
        neighbour: the neighbour as received.
        own_lead_s: time L from now to this vehicle's t + L.
    """
    age_s = message_age(neighbour)
    velocity_m_s = neighbour.velocity_enu_m_s.z
    now_m = neighbour.position_enu_m.z + age_s * velocity_m_s

    if not neighbour.is_cooperative:
        return Climb(
            height_m=now_m,
            ahead_m=now_m + own_lead_s * velocity_m_s,
            velocity_m_s=velocity_m_s,
            intended_climb_m=INTENT_S * velocity_m_s,
            position_std_m=neighbour.position_std_m,
        )

    predicted_m = neighbour.predicted_position_enu_m.z
    predicted_m_s = neighbour.predicted_velocity_enu_m_s.z
    # from the neighbour's predicted state to this vehicle's t + L
    ahead_s = age_s + own_lead_s - lead_time(neighbour.lead_time_s, own_lead_s)
    return Climb(
        height_m=now_m,
        ahead_m=predicted_m + ahead_s * predicted_m_s,
        velocity_m_s=predicted_m_s,
        intended_climb_m=INTENT_S * neighbour.intent_enu_m_s.z,
        position_std_m=neighbour.position_std_m,
    )
