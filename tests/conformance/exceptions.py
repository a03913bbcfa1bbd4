"""Facts in which the emulator differs from PX4, by name, and why; everything else has to agree."""

from __future__ import annotations

DIFFERENCES: dict[str, str] = {
    "step.yaw-170-overshoot": "the emulated heading overshoots about half as much after large steps",
}
