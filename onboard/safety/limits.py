"""Limits that more than one judgement uses.

They say from which age something is stale, silent or lost, and which accuracy is believed.
"""

from __future__ import annotations

import math

# own position
POSITION_STALE_S = 0.2  # from here on the vehicle flies by dead reckoning; no take-off
POSITION_LOST_S = 0.5
NEIGHBOUR_BLIND_S = 0.25  # the others go by it when it has lasted, for telemetry is that late
RECKONING_S = 6.0  # from here on dead reckoning is worth no more than PX4's own landing
RECKONING_AMONG_OTHERS_S = 12.0  # near others it is: PX4 avoids nobody, and reckons worse
AMONG_OTHERS_M = 5.0  # nearer than this a vehicle is among others

# PX4
AUTOPILOT_SILENT_S = 0.3  # without any packet
LOCAL_POSITION_FRESH_S = 0.25  # its local position arrives at 10 Hz

# Standard deviations that are published, and believed. A margin for more would push the other
# vehicles out of the fence.
LARGEST_POSITION_STD_M = 0.5
LARGEST_VELOCITY_STD_M_S = 0.5
LARGEST_PX4_ACCURACY_M = math.sqrt(2.0) * LARGEST_POSITION_STD_M  # as PX4 tells it, of two axes
