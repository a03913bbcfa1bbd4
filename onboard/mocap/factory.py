"""Which source of poses an agent listens to."""

from __future__ import annotations

from onboard.bus.protocol import Bus
from onboard.config.mocap import MocapConfig
from onboard.mocap.bus_source import BusMocap
from onboard.mocap.sdk_source import CapturedMocap
from onboard.mocap.source import MocapSource, OnMalformed, OnPose


def source_of(mocap: MocapConfig, bus: Bus, body: str, on_pose: OnPose, on_malformed: OnMalformed) -> MocapSource:
    """The system itself with ``mocap.direct``; else the bus, where a relay or an emulator publishes."""
    if mocap.direct:
        return CapturedMocap(mocap, body, on_pose, on_malformed)
    return BusMocap(bus, body, on_pose, on_malformed)
