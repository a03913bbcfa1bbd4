"""The smallest distance of two vehicles that brake, and a neighbour's predictions checked.

Pure, in plain floats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Xy = tuple[float, float]

_HORIZON_S = 2.0  # of two vehicles that pass each other
_COMPARE_EVERY_S = 0.25  # a state that comes later than this is not of the predicted time
_MISS_SHARE = 0.35  # of the newest comparison in the low-passed miss
_MISS_M_S = 0.55  # low-passed, from which on predictions count as wrong
_LONGEST_LEAD_S = 1.0  # of a prediction that is compared


def smallest_distance_m(
    apart_m: Xy, closing_velocity_m_s: Xy, *, reaction_s: float, deceleration_m_s2: float
) -> float:
    """Return the distance that is left when both vehicles brake along their line of sight.

    They go on as they do now while they react, and then brake as hard as they can.

    Args:
        apart_m: from us to the other, horizontal.
        closing_velocity_m_s: our velocity minus the other's, horizontal.
        reaction_s: for so long both go on as they do now.
        deceleration_m_s2: of both together.
    Returns:
        distance [m]: the present one if they do not come nearer, or the one at which they pass each
        other without braking if that is larger than the distance left.
    """
    x, y = apart_m
    vx, vy = closing_velocity_m_s
    distance_m = math.hypot(x, y)
    if distance_m < 1e-6:
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
    """Compares a neighbour's velocity with the one that it had predicted for now.

    A vehicle's prediction contains the commands that it has sent already, so it comes true within
    noise and gusts. For a vehicle that does not follow its own commands it does not. The difference
    is low-passed over about a second.
    """

    miss_m_s: float = 0.0  # between velocity and prediction, low-passed
    _due_ns: int = 0  # when the prediction can be compared; 0 without one
    _predicted_m_s: Xy = (0.0, 0.0)  # horizontal velocity at that time

    @property
    def is_wrong(self) -> bool:
        """Whether the neighbour does not fly as it predicts."""
        return self.miss_m_s > _MISS_M_S

    def reset(self) -> None:
        """Begin anew: the neighbour predicts nothing."""
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
            if stamp_ns - self._due_ns < _COMPARE_EVERY_S * 1e9:
                vx, vy = velocity_m_s
                px, py = self._predicted_m_s
                self.miss_m_s += _MISS_SHARE * (math.hypot(vx - px, vy - py) - self.miss_m_s)
            self._due_ns = 0

        # one prediction at a time waits for its comparison
        if not self._due_ns and 0.0 < lead_s < _LONGEST_LEAD_S:
            self._due_ns = stamp_ns + round(lead_s * 1e9)
            self._predicted_m_s = predicted_m_s
