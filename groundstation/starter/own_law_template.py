"""A law of your own: what is near pushes harder the nearer it is, and all pass on the right.

docs/own-law.md of Covey says what comes in, what has to go out, and what a law may not do.
"""

from __future__ import annotations

import math

from onboard.avoidance.own_law import LawInputs
from onboard.avoidance.params import Capsule
from onboard.types import Thrust
from onboard.vectors import Vec2

REACH = 1.5  # what is farther away than this multiple of the distance to keep does not count
PUSH_1_S2 = 12.0  # push for each metre that something is too near
TURN_FRAC = 0.4  # share of a neighbour's push that is added to the right
DAMPING_1_S = 1.5  # push for each m/s of the speed at which two come nearer


def law(memory: int | None, inputs: LawInputs) -> tuple[int, Thrust]:
    """Return the memory for the next tick, here a count of ticks, and the thrust to fly."""
    x, y, _ = inputs.baseline.thrust_enu_m_s2  # what the vehicle would fly if it were alone
    for near in inputs.neighbours:
        push = pushed(near.e_m, near.w_m_s, near.d_m)
        x += push.x - TURN_FRAC * push.y
        y += push.y + TURN_FRAC * push.x

    # The trajectory leads around obstacles, but neighbours may push the vehicle towards one.
    velocity_x, velocity_y, _ = inputs.predicted.velocity_enu_m_s
    for obstacle in inputs.obstacles:
        keep_m = obstacle.radius_m + inputs.vehicle.spacing.clearance_m
        push = pushed(away_from(obstacle, inputs), Vec2(velocity_x, velocity_y), keep_m)
        x += push.x
        y += push.y

    return (memory or 0) + 1, inputs.limited(x, y)


def pushed(e_m: Vec2, w_m_s: Vec2, d_m: float) -> Vec2:
    """Return the push away from something, given as in the inputs; none beyond its reach."""
    distance_m = max(math.hypot(*e_m), 1e-3)
    room_m = REACH * d_m - distance_m
    if room_m <= 0.0:
        return Vec2(0.0, 0.0)

    # away from it, as a vector of length 1
    away = Vec2(e_m.x / distance_m, e_m.y / distance_m)
    closing_m_s = -(away.x * w_m_s.x + away.y * w_m_s.y)
    push = PUSH_1_S2 * room_m + DAMPING_1_S * max(0.0, closing_m_s)
    return Vec2(push * away.x, push * away.y)


def away_from(obstacle: Capsule, inputs: LawInputs) -> Vec2:
    """Return own position minus the nearest point of an obstacle's axis."""
    x, y, _ = inputs.predicted.position_enu_m
    begin, end = obstacle.begin_enu_m, obstacle.end_enu_m
    along = Vec2(end.x - begin.x, end.y - begin.y)
    length_squared_m2 = along.x**2 + along.y**2

    share = 0.0  # a pillar's axis is a point
    if length_squared_m2 > 0.0:
        share = ((x - begin.x) * along.x + (y - begin.y) * along.y) / length_squared_m2
        share = min(1.0, max(0.0, share))
    return Vec2(x - begin.x - share * along.x, y - begin.y - share * along.y)
