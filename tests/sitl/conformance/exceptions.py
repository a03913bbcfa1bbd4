"""Facts in which the emulator differs from PX4, by name, and why; everything else has to agree."""

from __future__ import annotations

DIFFERENCES: dict[str, str] = {}
