"""A law of your own: neighbours push harder the nearer they are, and all pass on the right.

docs/own-law.md of Covey says what comes in, what has to go out, and what a law may not do.
"""

from __future__ import annotations

import math

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust

REACH = 1.5  # neighbours farther away than this multiple of the distance to keep do not count
PUSH_1_S2 = 12.0  # push for each metre that a neighbour is too near
TURN_FRAC = 0.4  # share of the push that is added to the right
DAMPING_1_S = 1.5  # push for each m/s of the speed at which two come nearer


def law(memory: int | None, inputs: LawInputs) -> tuple[int, Thrust]:
    """Return the memory for the next tick, here a count of ticks, and the thrust to fly."""
    x, y, _ = inputs.baseline.thrust_enu_m_s2  # what the vehicle would fly if it were alone
    for near in inputs.neighbours:
        distance_m = max(math.hypot(*near.e_m), 1e-3)
        room_m = REACH * near.d_m - distance_m
        if room_m <= 0.0:
            continue

        # away from the neighbour, as a vector of length 1
        away_x = near.e_m.x / distance_m
        away_y = near.e_m.y / distance_m
        closing_m_s = -(away_x * near.w_m_s.x + away_y * near.w_m_s.y)
        push = PUSH_1_S2 * room_m + DAMPING_1_S * max(0.0, closing_m_s)
        turn = TURN_FRAC * PUSH_1_S2 * room_m
        x += push * away_x - turn * away_y
        y += push * away_y + turn * away_x

    return (memory or 0) + 1, inputs.limited(x, y)
