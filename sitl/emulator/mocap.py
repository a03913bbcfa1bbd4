"""A motion-capture system as its clients see it: poses at a fixed rate.

The poses have noise and latency, and some are lost.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

from sitl.faults.pose_faults import PoseFaults
from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.physics.random_streams import Stream

_ATTITUDE_NOISE_RAD = math.radians(0.15)
_TIME_TOLERANCE_S = 1e-9  # times that differ by less count as equal
_LARGEST_LAG_S = 0.1  # frames that are due for longer than this are skipped


@dataclass(frozen=True, slots=True)
class MocapSettings:
    """Quality of a motion-capture system."""

    rate_hz: float = 50.0  # frames per second
    noise_m: float = 0.003  # standard deviation of each coordinate
    latency_s: float = 0.02  # time from the exposure to the delivery
    dropout_per_s: float = 0.0  # how often a second a body's markers are lost
    dropout_s: float = 0.1  # duration of a loss


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of one body in one frame, fleet ENU."""

    index: int
    time_s: float
    is_tracked: bool  # False: position and quaternion are those last measured
    position_enu_m: tuple[float, float, float]
    quaternion_enu_flu_wxyz: tuple[float, float, float, float]


class Mocap:
    """Measurement of all bodies at the time of a frame, delivered after the latency.

    Args:
        count: number of bodies.
        settings: quality of the system.
        seed: seed of noise and losses.
        faults: faults of the poses of single bodies, which may change in flight; None: none.
    """

    def __init__(
        self,
        count: int,
        settings: MocapSettings | None = None,
        *,
        seed: int = 0,
        faults: PoseFaults | None = None,
    ) -> None:
        self.settings = MocapSettings() if settings is None else settings
        self._faults = PoseFaults(count) if faults is None else faults
        self._rng = np.random.default_rng([seed, Stream.MOCAP])
        self._lost_until_s = np.full(count, -math.inf)
        self._next_s = 0.0  # time of the next frame
        # Heap of arrival time, number and pose. The number orders poses with the same time.
        self._in_transit: list[tuple[float, int, Pose]] = []
        self._pose_count = 0  # number of poses so far
        self._last: list[Pose | None] = [None] * count  # newest tracked pose of each body

    def step(self, time_s: float, position_enu_m: Array, attitude_enu_flu: Array) -> list[Pose]:
        """Expose a frame if one is due; return the poses that arrive now, oldest first."""
        if time_s + _TIME_TOLERANCE_S >= self._next_s:
            due_s = max(self._next_s, time_s - _LARGEST_LAG_S)
            self._next_s = due_s + 1.0 / self.settings.rate_hz
            for pose in self._measure(time_s, position_enu_m, attitude_enu_flu):
                arrival_s = time_s + self.settings.latency_s + self._faults.delay_s(pose.index)
                self._pose_count += 1
                heapq.heappush(self._in_transit, (arrival_s, self._pose_count, pose))

        arrived: list[Pose] = []
        while self._in_transit:
            arrival_s, _, pose = self._in_transit[0]
            if arrival_s > time_s + _TIME_TOLERANCE_S:
                break
            heapq.heappop(self._in_transit)
            arrived.append(pose)
        return arrived

    def _measure(self, time_s: float, position_enu_m: Array, attitude_enu_flu: Array) -> list[Pose]:
        """Return the poses of one frame, with noise, losses and faults."""
        settings = self.settings
        count = position_enu_m.shape[0]

        loss_chance = settings.dropout_per_s / settings.rate_hz
        begins = self._rng.random(count) < loss_chance
        self._lost_until_s = np.where(begins, time_s + settings.dropout_s, self._lost_until_s)

        # Columns: position (3), quaternion (4), each with noise.
        measured = np.empty((count, 7))
        position_noise_m = settings.noise_m * self._rng.standard_normal((count, 3))
        measured[:, :3] = position_enu_m + position_noise_m

        turns = np.ones((count, 4))  # quaternions wxyz of small turns
        turns[:, 1:] = 0.5 * _ATTITUDE_NOISE_RAD * self._rng.standard_normal((count, 3))
        turns /= np.sqrt((turns * turns).sum(axis=1, keepdims=True))
        measured[:, 3:] = frames.multiply(attitude_enu_flu, turns)

        if not self._faults.is_clear:
            measured = self._faults.apply(measured, time_s)

        poses: list[Pose] = []
        are_markers_lost = (time_s < self._lost_until_s).tolist()
        for index, (x, y, z, qw, qx, qy, qz) in enumerate(measured.tolist()):
            if are_markers_lost[index] or self._faults.is_lost(index):
                untracked = self._untracked_pose(index, time_s)
                if untracked is not None:
                    poses.append(untracked)
                continue

            pose = Pose(
                index=index,
                time_s=time_s,
                is_tracked=True,
                position_enu_m=(x, y, z),
                quaternion_enu_flu_wxyz=(qw, qx, qy, qz),
            )
            self._last[index] = pose
            poses.append(pose)
        return poses

    def _untracked_pose(self, index: int, time_s: float) -> Pose | None:
        """Return the last pose of a body that is not seen; None before its first pose."""
        last = self._last[index]
        if last is None:
            return None
        return Pose(
            index=index,
            time_s=time_s,
            is_tracked=False,
            position_enu_m=last.position_enu_m,
            quaternion_enu_flu_wxyz=last.quaternion_enu_flu_wxyz,
        )
