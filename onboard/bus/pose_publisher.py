"""Publishes the poses of a motion capture: each under its body's name, and all of them together,
less often.

A vehicle subscribes to its own body. From the poses that come together it learns where the others
really are.
"""

from __future__ import annotations

from onboard.bus.protocol import Bus
from onboard.bus.schema import MocapPose, MocapPoses
from onboard.bus.topics import TOPICS, Topic

_PERIOD_NS = round(1e9 / TOPICS[Topic.ALL_POSES].rate_hz)
_MOST_TOGETHER = 10  # so many fit into one datagram


class PosePublisher:
    """Publishes the poses of one source.

    Args:
        bus: an open node.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._newest: dict[str, MocapPose] = {}  # since they were published together
        self._due_ns = 0

    def publish(self, pose: MocapPose) -> None:
        """Publish one pose; never blocks.

        Args:
            pose: as measured.
        """
        self._bus.publish(Topic.MOCAP, pose.body, pose)
        if not 0 <= self._due_ns - pose.stamp_ns <= _PERIOD_NS:
            self._due_ns = pose.stamp_ns + _PERIOD_NS
            poses = tuple(self._newest.values())
            for begin in range(0, len(poses), _MOST_TOGETHER):
                together = MocapPoses(poses=poses[begin : begin + _MOST_TOGETHER])
                self._bus.publish(Topic.ALL_POSES, "all", together)
            self._newest.clear()
        self._newest[pose.body] = pose
