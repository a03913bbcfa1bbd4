"""Facts in which the emulator differs from PX4, by name, and why; everything else has to agree."""

from __future__ import annotations

_VISION = "the estimate keeps the errors that vision was measured to leave in flight, also on the ground"
DIFFERENCES: dict[str, str] = {
    "step.yaw-170-overshoot": "the emulated heading overshoots about half as much after large steps",
    "vision.estimate": _VISION,
    "vision.jump": _VISION,
    "vision.height-jump": _VISION,
    "vision.odometry": _VISION,
}
