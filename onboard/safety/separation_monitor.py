"""Predicts the smallest distance of two vehicles, and checks a neighbour's own predictions.

Pure, in plain floats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Vec2 = tuple[float, float]

_HORIZON_S = 2.0
_COMPARE_EVERY_S = 0.25
_MISS_SHARE = 0.35
_MISS_M_S = 0.55
_LONGEST_LEAD_S = 1.0


def smallest_distance_m(
    apart_m: Vec2, closing_velocity_m_s: Vec2, *, reaction_s: float, deceleration_m_s2: float
) -> float:
    """Predict the distance that is left when both vehicles brake along their line of sight as hard
    as they can.

    Args:
        apart_m: from us to the other, horizontal.
        closing_velocity_m_s: our velocity minus the other's, horizontal.
        reaction_s: for so long both go on as they do now.
        deceleration_m_s2: of both together.
    Returns:
        distance [m]: the present one if they do not come nearer, or the one at which they pass each
        other without braking if that is larger than the distance left.
    """
    (x, y), (vx, vy) = apart_m, closing_velocity_m_s
    distance = math.hypot(x, y)
    if distance < 1e-6:
        return distance
    closing = (x * vx + y * vy) / distance
    if closing <= 0.0:
        return distance
    left = distance - closing * reaction_s - closing * closing / (2.0 * deceleration_m_s2)
    time_s = min((x * vx + y * vy) / (vx * vx + vy * vy), _HORIZON_S)
    return max(left, math.hypot(x - time_s * vx, y - time_s * vy), 0.0)


@dataclass(slots=True)
class PredictionMonitor:
    """Compares a neighbour's velocity with the one that it had predicted for now, low-passed over
    about a second.

    A vehicle's prediction contains the commands that it has sent already, so it comes true within
    noise and gusts; for a vehicle that does not follow its own commands it does not.
    """

    miss_m_s: float = 0.0
    _due_ns: int = 0  # when the prediction can be compared; 0 without one
    _predicted_m_s: Vec2 = (0.0, 0.0)

    @property
    def is_wrong(self) -> bool:
        """Whether the neighbour does not fly as it predicts."""
        return self.miss_m_s > _MISS_M_S

    def reset(self) -> None:
        """Begin anew: the neighbour predicts nothing."""
        self.miss_m_s, self._due_ns = 0.0, 0

    def update(self, stamp_ns: int, velocity_m_s: Vec2, predicted_m_s: Vec2, lead_s: float) -> None:
        """Take one state of a neighbour that cooperates.

        Args:
            stamp_ns: time of the state.
            velocity_m_s: horizontal velocity at that time.
            predicted_m_s: horizontal velocity that it predicts for ``lead_s`` later.
            lead_s: lead time of the prediction.
        """
        if self._due_ns and stamp_ns >= self._due_ns:
            if stamp_ns - self._due_ns < _COMPARE_EVERY_S * 1e9:
                (vx, vy), (px, py) = velocity_m_s, self._predicted_m_s
                self.miss_m_s += _MISS_SHARE * (math.hypot(vx - px, vy - py) - self.miss_m_s)
            self._due_ns = 0
        if not self._due_ns and 0.0 < lead_s < _LONGEST_LEAD_S:
            self._due_ns, self._predicted_m_s = stamp_ns + round(lead_s * 1e9), predicted_m_s
