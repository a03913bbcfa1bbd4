"""Can two vehicles still keep their distance, and does the other one do what it says? Pure, in plain floats."""

from __future__ import annotations

import math
from dataclasses import dataclass

Vec2 = tuple[float, float]

_HORIZON_S = 2.0
_PROMISE_EVERY_S = 0.25
_MISS_SHARE = 0.35
_MISS_M_S = 0.55
_LONGEST_LEAD_S = 1.0


def smallest_distance_m(
    apart_m: Vec2, closing_velocity_m_s: Vec2, *, reaction_s: float, deceleration_m_s2: float
) -> float:
    """Distance that is left when both vehicles brake along their line of sight as hard as they can.

    Args:
        apart_m: from us to the other, horizontal. closing_velocity_m_s: our velocity less the other's.
        reaction_s: for so long both go on as they do now. deceleration_m_s2: of both together.
    Returns:
        the present distance if they do not come nearer, or if even without braking they pass each other no nearer.
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
    """Compares a neighbour's velocity with the one that it had predicted for now, low-passed over about a second.

    A vehicle's prediction contains the commands that it has sent already, so it comes true within noise and gusts; for
    one that does not obey its own commands it does not.
    """

    miss_m_s: float = 0.0
    _due_ns: int = 0
    _promised_m_s: Vec2 = (0.0, 0.0)

    @property
    def is_broken(self) -> bool:
        """Whether it does not do what it says."""
        return self.miss_m_s > _MISS_M_S

    def rest(self) -> None:
        """It promises nothing."""
        self.miss_m_s, self._due_ns = 0.0, 0

    def look(self, stamp_ns: int, velocity_m_s: Vec2, predicted_m_s: Vec2, lead_s: float) -> None:
        """One state of a neighbour that promises to cooperate: how it moves now, and how it will after the lead."""
        if self._due_ns and stamp_ns >= self._due_ns:
            if stamp_ns - self._due_ns < _PROMISE_EVERY_S * 1e9:
                (vx, vy), (px, py) = velocity_m_s, self._promised_m_s
                self.miss_m_s += _MISS_SHARE * (math.hypot(vx - px, vy - py) - self.miss_m_s)
            self._due_ns = 0
        if not self._due_ns and 0.0 < lead_s < _LONGEST_LEAD_S:
            self._due_ns, self._promised_m_s = stamp_ns + round(lead_s * 1e9), predicted_m_s
