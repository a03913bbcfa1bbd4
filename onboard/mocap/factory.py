"""Chooses the source of poses for an agent."""

from __future__ import annotations

from onboard.bus.protocol import Bus
from onboard.config.mocap import MocapConfig
from onboard.mocap.bus_source import BusMocap
from onboard.mocap.sdk_source import SdkMocap
from onboard.mocap.source import MocapSource, OnMalformed, OnPose


def source_of(
    mocap: MocapConfig, bus: Bus, body: str, on_pose: OnPose, on_malformed: OnMalformed
) -> MocapSource:
    """Return the source of an agent's poses.

    With ``mocap.direct`` the agent reads the motion-capture system itself. Otherwise it listens on
    the bus, where a relay or an emulator publishes.
    """
    if mocap.direct:
        return SdkMocap(mocap, body, on_pose, on_malformed)
    return BusMocap(bus, body, on_pose, on_malformed)
