"""Limits that several checks share.

They say at which age something is stale, silent or lost, and which accuracies are accepted.
"""

from __future__ import annotations

import math

# own position
POSITION_STALE_S = 0.2  # without poses for longer, a vehicle flies by dead reckoning
POSITION_KNOWN_S = 0.5  # without poses for longer, and without dead reckoning, it is not known
POSITION_LOST_S = 0.6  # without poses for longer, a vehicle lands
# Poses that come and go: the times without them add up, and shrink by this share while poses come.
# Above this sum a vehicle lands.
FLICKER_S = 0.6
FLICKER_FORGOTTEN_SHARE = 0.2
NEIGHBOUR_BLIND_S = 0.25  # a neighbour is blind without poses for longer, as its telemetry says
RECKONING_S = 6.0  # for longer, PX4's own landing is as good as dead reckoning
# Near others dead reckoning is better for longer: PX4 avoids nobody, and its reckoning is worse.
RECKONING_AMONG_OTHERS_S = 12.0
AMONG_OTHERS_M = 5.0  # a vehicle nearer than this to another one is among others

# PX4
AUTOPILOT_SILENT_S = 0.3  # PX4 is silent if no packet has come for longer
LOCAL_POSITION_FRESH_S = 0.25  # PX4's local position arrives at 10 Hz

# Largest standard deviations that are published and accepted. A margin for larger ones would push
# the other vehicles out of the fence.
LARGEST_POSITION_STD_M = 0.5
LARGEST_VELOCITY_STD_M_S = 0.5
LARGEST_PX4_ACCURACY_M = math.sqrt(2.0) * LARGEST_POSITION_STD_M  # PX4 reports that of two axes
