"""Mocap poses from the bus, the source that every relay and the emulator speak."""

from __future__ import annotations

import time
from collections.abc import Callable

from onboard.bus.codec import Malformed
from onboard.bus.schema import Message, MocapPose
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic


class BusMocap:
    """One body's poses from topic ``mocap``; callbacks come on a bus thread.

    Args:
        on_pose: called with the pose and its arrival on the monotonic clock [ns].
        on_malformed: called for bytes that are no pose.
    """

    def __init__(
        self,
        bus: BusSession,
        body: str,
        on_pose: Callable[[MocapPose, int], None],
        on_malformed: Callable[[], None],
    ) -> None:
        self._bus, self._body = bus, body
        self._on_pose, self._on_malformed = on_pose, on_malformed

    def start(self) -> None:
        """Subscribe; the bus must be open."""
        self._bus.subscribe(Topic.MOCAP, self._body, self._receive)

    def _receive(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        if isinstance(message, MocapPose):
            self._on_pose(message, time.monotonic_ns())
        else:
            self._on_malformed()
