"""Facts in which the emulator differs from PX4, by name, and why; everything else has to agree."""

from __future__ import annotations

_VISION = "the estimate keeps the errors that vision was measured to leave in flight, also on the ground"
_YAW_DRIFT = "the compass's error drifts as fast on the ground as in flight, and during a step of yaw"
DIFFERENCES: dict[str, str] = {
    "pad.yaw-noise": _YAW_DRIFT,
    "step.yaw-170-overshoot": "large steps of yaw overshoot less: the rate limit holds the integral back",
    "vision.estimate": _VISION,
    "vision.jump": _VISION,
    "vision.height-jump": _VISION,
    "vision.odometry": _VISION,
}
