"""Predicts the smallest distance of two vehicles that brake, and checks a neighbour's predictions.

Pure, in plain floats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Xy = tuple[float, float]

_HORIZON_S = 2.0  # how far ahead the passing of two vehicles is predicted
_COMPARE_WITHIN_S = 0.25  # longest time from the predicted time to the compared state
_MISS_SHARE = 0.35  # weight of the newest comparison in the low-passed miss
_MISS_M_S = 0.55  # predictions count as wrong from this low-passed miss
_LONGEST_LEAD_S = 1.0  # a prediction for a later time is not compared
_COINCIDENT_M = 1e-6  # two vehicles nearer than this have no line of sight


def smallest_distance_m(
    apart_m: Xy, closing_velocity_m_s: Xy, *, reaction_s: float, deceleration_m_s2: float
) -> float:
    """Return the smallest distance [m] of two vehicles that brake along their line of sight.

    Both keep their velocity while they react, and then brake as hard as they can.

    Args:
        apart_m: horizontal vector from this vehicle to the other.
        closing_velocity_m_s: horizontal velocity of this vehicle minus the other's.
        reaction_s: reaction time of both vehicles.
        deceleration_m_s2: sum of the decelerations of both vehicles.
    Returns:
        The present distance if they do not approach each other. Otherwise the larger of two: the
        distance after braking, and the distance at which they pass each other without braking.
    """
    x, y = apart_m
    vx, vy = closing_velocity_m_s
    distance_m = math.hypot(x, y)
    if distance_m < _COINCIDENT_M:
        return distance_m

    closing_m_s = (x * vx + y * vy) / distance_m
    if closing_m_s <= 0.0:
        return distance_m

    braking_m = closing_m_s * closing_m_s / (2.0 * deceleration_m_s2)
    left_m = distance_m - closing_m_s * reaction_s - braking_m

    # without braking they are nearest when the line between them is at right angles to the velocity
    passing_s = min((x * vx + y * vy) / (vx * vx + vy * vy), _HORIZON_S)
    passing_m = math.hypot(x - passing_s * vx, y - passing_s * vy)
    return max(left_m, passing_m, 0.0)


@dataclass(slots=True)
class PredictionMonitor:
    """Compares a neighbour's velocity with its earlier prediction for this time.

    A vehicle predicts its motion from the commands that it has already sent. So apart from noise
    and gusts, the prediction is correct if the vehicle follows its own commands. The difference is
    low-passed over about a second.
    """

    miss_m_s: float = 0.0  # difference of velocity and prediction, low-passed
    _due_ns: int = 0  # time that the waiting prediction is for; 0: none is waiting
    _predicted_m_s: Xy = (0.0, 0.0)  # horizontal velocity at that time

    @property
    def is_wrong(self) -> bool:
        """Whether the neighbour does not fly as it predicts."""
        return self.miss_m_s > _MISS_M_S

    def reset(self) -> None:
        """Start again, because the neighbour predicts nothing."""
        self.miss_m_s = 0.0
        self._due_ns = 0

    def update(self, stamp_ns: int, velocity_m_s: Xy, predicted_m_s: Xy, lead_s: float) -> None:
        """Take one state of a neighbour that cooperates.

        Args:
            stamp_ns: time of the state.
            velocity_m_s: horizontal velocity at that time.
            predicted_m_s: horizontal velocity that it predicts for ``lead_s`` later.
            lead_s: lead time of the prediction.
        """
        if self._due_ns and stamp_ns >= self._due_ns:
            if stamp_ns - self._due_ns < _COMPARE_WITHIN_S * 1e9:
                vx, vy = velocity_m_s
                px, py = self._predicted_m_s
                self.miss_m_s += _MISS_SHARE * (math.hypot(vx - px, vy - py) - self.miss_m_s)
            self._due_ns = 0

        # one prediction at a time waits for its comparison
        if not self._due_ns and 0.0 < lead_s < _LONGEST_LEAD_S:
            self._due_ns = stamp_ns + round(lead_s * 1e9)
            self._predicted_m_s = predicted_m_s
