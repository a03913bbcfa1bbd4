"""Limits that more than one judgement uses: ages of what is stale, silent or lost, and what
accuracy is believed.
"""

from __future__ import annotations

import math

POSITION_STALE_S = 0.2  # own position: from here on by dead reckoning, and no take-off
POSITION_LOST_S = 0.5
RECKONING_S = 6.0  # without a position; then dead reckoning is worth no more than PX4's own landing
AUTOPILOT_SILENT_S = 0.3  # without any packet of PX4
# standard deviations that are published, and believed: a margin for more would push the other
# vehicles out of the fence
LARGEST_POSITION_STD_M, LARGEST_VELOCITY_STD_M_S = 0.5, 0.5
# as PX4 tells it, of two axes together
LARGEST_PX4_ACCURACY_M = math.sqrt(2.0) * LARGEST_POSITION_STD_M
