"""A motion-capture system as its clients see it: poses at a fixed rate, a bit wrong, a bit late,
sometimes lost.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

from sitl.faults.pose_faults import PoseFaults
from sitl.physics import frames
from sitl.physics.frames import Array

_ATTITUDE_NOISE_RAD = math.radians(0.15)


@dataclass(frozen=True, slots=True)
class MocapSettings:
    """Quality of the system."""

    rate_hz: float = 50.0  # frames per second
    noise_m: float = 0.003  # standard deviation of each coordinate
    latency_s: float = 0.02  # from the exposure to the delivery
    dropout_per_s: float = 0.0  # how often, per body, the markers are lost
    dropout_s: float = 0.1  # for how long


@dataclass(frozen=True, slots=True)
class Pose:
    """One body in one frame, fleet ENU; not tracked means that the numbers are the last ones seen."""

    index: int
    time_s: float
    is_tracked: bool
    position_enu_m: tuple[float, float, float]
    quaternion_enu_flu_wxyz: tuple[float, float, float, float]


class Mocap:
    """Measures all bodies; `measure` on the frame's time, `deliver` when the latency has passed.

    Args:
        count: bodies. settings: quality. seed: of noise and losses.
        faults: what is wrong with the poses of single bodies; those of an emulator are in its
            `disturbances`.
    """

    def __init__(
        self,
        count: int,
        settings: MocapSettings | None = None,
        *,
        seed: int = 0,
        faults: PoseFaults | None = None,
    ) -> None:
        self.settings = settings or MocapSettings()
        self._faults = faults or PoseFaults(count)
        self._rng = np.random.default_rng([seed, 3])
        self._lost_until_s = np.full(count, -math.inf)
        self._next_s = 0.0
        self._in_transit: list[tuple[float, int, Pose]] = []
        self._sent = 0
        self._last: list[Pose | None] = [None] * count

    def step(self, time_s: float, position_enu_m: Array, attitude_enu_flu: Array) -> list[Pose]:
        """Expose a frame if one is due; return the poses that arrive now, oldest first."""
        if time_s + 1e-9 >= self._next_s:
            self._next_s = max(self._next_s, time_s - 0.1) + 1.0 / self.settings.rate_hz
            for pose in self._measure(time_s, position_enu_m, attitude_enu_flu):
                arrival_s = time_s + self.settings.latency_s + self._faults.delay_s(pose.index)
                self._sent += 1
                heapq.heappush(self._in_transit, (arrival_s, self._sent, pose))
        arrived: list[Pose] = []
        while self._in_transit and self._in_transit[0][0] <= time_s + 1e-9:
            arrived.append(heapq.heappop(self._in_transit)[2])
        return arrived

    def _measure(self, time_s: float, position_enu_m: Array, attitude_enu_flu: Array) -> list[Pose]:
        s = self.settings
        count = position_enu_m.shape[0]
        chance = s.dropout_per_s / s.rate_hz
        self._lost_until_s = np.where(
            self._rng.random(count) < chance, time_s + s.dropout_s, self._lost_until_s
        )
        measured, small = np.empty((count, 7)), np.ones((count, 4))
        measured[:, :3] = position_enu_m + s.noise_m * self._rng.standard_normal((count, 3))
        small[:, 1:] = 0.5 * _ATTITUDE_NOISE_RAD * self._rng.standard_normal((count, 3))
        small /= np.sqrt((small * small).sum(axis=1, keepdims=True))
        measured[:, 3:] = frames.multiply(attitude_enu_flu, small)
        if not self._faults.is_clear:
            measured = self._faults.apply(measured)
        poses: list[Pose] = []
        is_out = (time_s < self._lost_until_s).tolist()
        for index, (x, y, z, qw, qx, qy, qz) in enumerate(measured.tolist()):
            if is_out[index] or self._faults.is_lost(index):
                last = self._last[index]
                if last is not None:
                    lost = Pose(
                        index, time_s, False, last.position_enu_m, last.quaternion_enu_flu_wxyz
                    )
                    poses.append(lost)
                continue
            pose = Pose(index, time_s, True, (x, y, z), (qw, qx, qy, qz))
            self._last[index] = pose
            poses.append(pose)
        return poses
