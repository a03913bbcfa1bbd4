"""The motion of the last second, from which dead reckoning can begin.

A camera that contradicts PX4 is noticed some time after it has begun to be wrong. The estimate has
followed it until then: its velocity is wrong, and it takes the difference for a push of the wind.
So dead reckoning begins earlier, at a motion from before the camera was wrong, and repeats the
ticks since then by attitude and throttle alone.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from onboard.estimation import kalman
from onboard.estimation.kalman import KalmanMemory, KalmanParams
from onboard.vectors import Vec3

# Longer than the time until a camera that stands still is noticed, which is 0.7 s.
_REMEMBERED_S = 1.0


class _Tick(NamedTuple):
    """The end of one tick."""

    memory: KalmanMemory
    mean_bias_m_s2: Vec3  # of the last seconds, see DeadReckoning
    driven_enu_m_s2: Vec3  # acceleration by attitude and throttle in this tick
    duration_s: float


@dataclass(slots=True)
class MotionHistory:
    """Motions of one vehicle at the ticks of the last second."""

    _ticks: deque[_Tick] = field(default_factory=deque)
    _remembered_s: float = 0.0  # duration of all ticks but the oldest one

    def note(
        self, memory: KalmanMemory, mean_bias_m_s2: Vec3, params: KalmanParams, dt_s: float
    ) -> None:
        """Note the motion at the end of a tick.

        Args:
            memory: memory of the filter.
            mean_bias_m_s2: mean bias of the last seconds, ENU.
            params: noise and limits of the filter.
            dt_s: length of the tick.
        """
        driven_enu_m_s2 = kalman.driven_enu_m_s2(memory, params)
        self._ticks.append(_Tick(memory, mean_bias_m_s2, driven_enu_m_s2, dt_s))
        if len(self._ticks) > 1:
            self._remembered_s += dt_s

        while self._remembered_s > _REMEMBERED_S:
            self._ticks.popleft()
            self._remembered_s -= self._ticks[0].duration_s

    def reckoned(self, params: KalmanParams) -> KalmanMemory | None:
        """Return the present motion, reckoned from the oldest one; None if none is remembered.

        Its bias is the mean one that was known then. The ticks since then count as ticks without a
        sample.

        Args:
            params: noise and limits of the filter.
        """
        if not self._ticks:
            return None

        oldest = self._ticks[0]
        memory = oldest.memory._replace(bias_enu_m_s2=oldest.mean_bias_m_s2)
        for tick in list(self._ticks)[1:]:
            memory = kalman.predict(memory, tick.driven_enu_m_s2, params, tick.duration_s)
        return memory._replace(thrust_m_s2=self._ticks[-1].memory.thrust_m_s2)
