"""Finds out whether a camera's positions contradict the motion that PX4 measures itself. Pure.

A camera that has lost its view may go on to send its last position. PX4's estimate then follows it
for seconds, although its inertial sensors measure another motion: the vehicle flies away, because
it seems to stand. ESTIMATOR_STATUS.pos_horiz_ratio shows this early. It is the squared difference
between the camera's position and the estimate, as a share of the largest that PX4 fuses.

Its size alone says little, because it grows with the drift of a good camera, too: to 0.5 within
seconds in flights of PX4 v1.16.0 and v1.18.0-rc1. In these flights it rose by 0.18 at most within
0.6 s. When the cameras of three vehicles stood still in a crossing, it rose by 0.46 to 1.24.
"""

from __future__ import annotations

import math
from collections import deque

_RISE = 0.28  # ratios that are larger than earlier ones by this contradict
_RISING = 0.05  # a ratio that is larger by this has begun to rise
_RISEN_NS = 150_000_000  # time for which they do so before that counts: not a single one
_EARLIER_NS = 550_000_000  # ratios of at least this age are compared with
_HISTORY_NS = 1_650_000_000  # and of at most this age
_AGREES_RATIO = 0.15
_AGREES_NS = 1_000_000_000  # a contradiction ends with smaller ratios for this time


class OdometryCheck:
    """Whether the camera of one vehicle contradicts its PX4.

    Attributes:
        is_contradicted: whether it does so now; PX4's position must not be used then.
        rising_since_ns: time of the last ratio before those that rose until it did so.
    """

    def __init__(self) -> None:
        self.is_contradicted = False
        self.rising_since_ns = 0
        self._ratios: deque[tuple[int, float]] = deque()  # newest ratios with their stamps [ns]
        self._risen_since_ns = 0  # 0: the newest ratio has not risen
        self._agrees_since_ns = 0  # 0: it does not agree

    def update(self, ratio: float, stamp_ns: int) -> None:
        """Take the newest ratio.

        Args:
            ratio: ESTIMATOR_STATUS.pos_horiz_ratio; NaN while PX4 fuses no position.
            stamp_ns: time of its arrival [ns].
        """
        if self._ratios and stamp_ns == self._ratios[-1][0]:
            return
        self._ratios.append((stamp_ns, ratio))
        while stamp_ns - self._ratios[0][0] > _HISTORY_NS:
            self._ratios.popleft()

        if self.is_contradicted:
            self.is_contradicted = not self._has_agreed(ratio, stamp_ns)
        else:
            self.is_contradicted = self._has_risen(ratio, stamp_ns)

    def _has_risen(self, ratio: float, stamp_ns: int) -> bool:
        """Return whether the ratios have risen for long enough."""
        earlier = [
            earlier_ratio
            for earlier_ns, earlier_ratio in self._ratios
            if stamp_ns - earlier_ns >= _EARLIER_NS
        ]
        # after a gap PX4 corrects its estimate, and the ratios rise as well
        has_gap = any(math.isnan(each) for _, each in self._ratios)
        if not earlier or has_gap or ratio <= max(earlier) + _RISE:
            self._risen_since_ns = 0
            return False
        if self._risen_since_ns == 0:
            self._risen_since_ns = stamp_ns
            self.rising_since_ns = max(
                each_ns for each_ns, each in self._ratios if each <= max(earlier) + _RISING
            )
        return stamp_ns - self._risen_since_ns >= _RISEN_NS

    def _has_agreed(self, ratio: float, stamp_ns: int) -> bool:
        """Return whether the camera has agreed for long enough."""
        if math.isnan(ratio) or ratio >= _AGREES_RATIO:
            self._agrees_since_ns = 0
            return False
        if self._agrees_since_ns == 0:
            self._agrees_since_ns = stamp_ns
        return stamp_ns - self._agrees_since_ns >= _AGREES_NS
