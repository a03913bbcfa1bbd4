"""Publishes the poses of a motion capture system: each under its body's name, and all together.

A vehicle subscribes to the poses of its own body. It gets the mocap positions of the other vehicles
from the messages with all bodies, which are less frequent.
"""

from __future__ import annotations

from onboard.bus.protocol import Bus
from onboard.bus.schema import MocapPose, MocapPoses
from onboard.bus.topics import TOPICS, Topic

_PERIOD_NS = round(1e9 / TOPICS[Topic.ALL_POSES].rate_hz)  # of the messages with all bodies
_MAX_TOGETHER = 10  # poses that fit into one datagram


class PosePublisher:
    """Publishes the poses of one source.

    Args:
        bus: an open node.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        # body -> its newest pose since all bodies were last published together
        self._newest: dict[str, MocapPose] = {}
        self._due_ns = 0  # all bodies are published together again from this stamp on

    def publish(self, pose: MocapPose) -> None:
        """Publish one pose; never blocks.

        Args:
            pose: the pose as measured.
        """
        self._bus.publish(Topic.MOCAP, pose.body, pose)

        until_due_ns = self._due_ns - pose.stamp_ns
        is_due = until_due_ns < 0
        has_jumped_back = until_due_ns > _PERIOD_NS  # for instance because the source is new
        if is_due or has_jumped_back:
            self._due_ns = pose.stamp_ns + _PERIOD_NS
            self._publish_together()

        self._newest[pose.body] = pose

    def _publish_together(self) -> None:
        """Publish the newest poses of all bodies, in as few messages as possible."""
        poses = tuple(self._newest.values())
        for begin in range(0, len(poses), _MAX_TOGETHER):
            together = MocapPoses(poses=poses[begin : begin + _MAX_TOGETHER])
            self._bus.publish(Topic.ALL_POSES, "all", together)
        self._newest.clear()
