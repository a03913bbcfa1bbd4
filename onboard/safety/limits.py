"""Limits that more than one judgement uses: the ages at which something counts as stale, silent or lost."""

from __future__ import annotations

POSITION_STALE_S = 0.2  # own position: setpoints are level, and no take-off
POSITION_LOST_S = 0.5
AUTOPILOT_SILENT_S = 0.3  # without any packet of PX4
