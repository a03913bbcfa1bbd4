"""When a user's law is replaced because of what the vehicle does. Pure.

``onboard/avoidance/own_law.py`` judges each thrust alone. A law whose thrusts keep all limits can
still fly the vehicle out of the fence, into another vehicle or into the ground. It would also fly
the hold or the landing of the failsafe that follows.
"""

from __future__ import annotations

from collections.abc import Collection

from onboard.safety.failsafe_table import Condition
from onboard.safety.geofence import FenceBox

_BELOW_M = 0.3  # a vehicle less far below its trajectory sinks as it was told
_STOPS = 2.0  # Covey's law may need this many times the least height to stop
_CROSSED = (Condition.FENCE_BREACH, Condition.FENCE_BREACH_LONG)


def fault_of_law(
    conditions: Collection[Condition],
    fence: FenceBox,
    *,
    height_m: float,
    climb_m_s: float,
    below_m: float,
) -> str:
    """Return what a law has let the vehicle do, as the end of a sentence; empty: nothing wrong.

    Args:
        conditions: present conditions of the vehicle.
        fence: the fence, with the vehicle's braking.
        height_m: height above the ground.
        climb_m_s: vertical speed, positive upwards.
        below_m: how far the vehicle is below its trajectory.
    """
    if any(condition in conditions for condition in _CROSSED):
        return "let the vehicle cross the geofence"
    if Condition.SEPARATION_BREACHED in conditions:
        return "let the vehicle come nearer to another one or a person than the safety distance"
    is_sinking_off = climb_m_s < 0.0 and below_m > _BELOW_M
    if is_sinking_off and _STOPS * fence.stopping_height_m(-climb_m_s) > height_m:
        return "lets the vehicle sink too fast to stop above the ground"
    return ""
