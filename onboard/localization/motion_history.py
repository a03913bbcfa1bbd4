"""The motion of the last second, from which dead reckoning can begin.

A camera that contradicts PX4 is noticed some time after it has begun to be wrong. The estimate has
followed it until then: its velocity is wrong, and it takes the difference for a push of the wind.
So dead reckoning begins earlier, at a motion from before the camera was wrong, and repeats the
ticks since then by attitude and throttle alone. It begins no earlier than needed, because a gust
that is not known errs with the square of the time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from onboard.estimation import kalman
from onboard.estimation.kalman import KalmanMemory, KalmanParams
from onboard.vectors import Vec3

# Longer than the time until a camera that stands still is noticed, which is 0.7 s.
_REMEMBERED_NS = 1_000_000_000


class _Tick(NamedTuple):
    """The end of one tick."""

    time_ns: int
    memory: KalmanMemory
    mean_bias_m_s2: Vec3  # of the last seconds, see DeadReckoning
    driven_enu_m_s2: Vec3  # acceleration by attitude and throttle in this tick
    duration_s: float


@dataclass(slots=True)
class MotionHistory:
    """Motions of one vehicle at the ticks of the last second."""

    _ticks: deque[_Tick] = field(default_factory=deque)

    def note(
        self,
        now_ns: int,
        memory: KalmanMemory,
        mean_bias_m_s2: Vec3,
        driven_enu_m_s2: Vec3,
        dt_s: float,
    ) -> None:
        """Note the motion at the end of a tick.

        Args:
            now_ns: time of the tick.
            memory: memory of the filter.
            mean_bias_m_s2: mean bias of the last seconds, ENU.
            driven_enu_m_s2: acceleration by attitude and throttle in this tick, ENU.
            dt_s: length of the tick.
        """
        tick = _Tick(
            time_ns=now_ns,
            memory=memory,
            mean_bias_m_s2=mean_bias_m_s2,
            driven_enu_m_s2=driven_enu_m_s2,
            duration_s=dt_s,
        )
        self._ticks.append(tick)
        while now_ns - self._ticks[0].time_ns > _REMEMBERED_NS:
            self._ticks.popleft()

    def forget(self) -> None:
        """Forget all motions."""
        self._ticks.clear()

    def reckoned(self, since_ns: int, params: KalmanParams) -> KalmanMemory | None:
        """Return the present motion, reckoned from an earlier one; None if none is remembered.

        Its bias is the mean one that was known then. The ticks since then count as ticks without a
        sample.

        Args:
            since_ns: time of that motion; without one, the oldest one after it counts.
            params: noise and limits of the filter.
        """
        if not self._ticks:
            return None

        ticks = list(self._ticks)
        while len(ticks) > 1 and ticks[1].time_ns <= since_ns:
            del ticks[0]

        first = ticks[0]
        memory = first.memory._replace(bias_enu_m_s2=first.mean_bias_m_s2)
        for tick in ticks[1:]:
            memory = kalman.predict(memory, tick.driven_enu_m_s2, params, tick.duration_s)
        return memory._replace(thrust_m_s2=ticks[-1].memory.thrust_m_s2)
