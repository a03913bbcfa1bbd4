"""Mocap poses from the bus. A relay or the emulator publishes them there."""

from __future__ import annotations

import time

from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import Message, MocapPose
from onboard.bus.topics import Topic
from onboard.mocap.source import OnMalformed, OnPose


class BusMocap:
    """Poses from topic ``mocap``. They are delivered when the owner calls :meth:`Bus.deliver`.

    Args:
        bus: bus on which the poses arrive.
        body: name of the body; ``*`` for all bodies.
        on_pose: called with the pose and the monotonic time [ns] of its delivery.
        on_malformed: called for bytes that are not a pose.
    """

    problem = ""  # always empty, because the relay reports its own problems

    def __init__(self, bus: Bus, body: str, on_pose: OnPose, on_malformed: OnMalformed) -> None:
        self._bus = bus
        self._body = body
        self._on_pose = on_pose
        self._on_malformed = on_malformed

    def start(self) -> None:
        """Subscribe; the bus must be open."""
        self._bus.collect(Topic.MOCAP, self._body, self.receive)

    def stop(self) -> None:
        """Do nothing, because the subscription ends with the bus."""

    def receive(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        """Pass on a message that the bus delivers, if it is a pose."""
        if isinstance(message, MocapPose):
            self._on_pose(message, time.monotonic_ns())
        else:
            self._on_malformed()
