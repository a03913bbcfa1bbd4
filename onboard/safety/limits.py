"""Limits that several checks share.

They define the ages at which something is stale, silent or lost, and the accepted accuracies.
"""

from __future__ import annotations

import math

# own position
POSITION_STALE_S = 0.2  # without poses for longer, a vehicle uses dead reckoning
POSITION_KNOWN_S = 0.5  # without poses for longer, and without dead reckoning, no position is known
POSITION_LOST_S = 0.6  # without poses for longer, a vehicle lands
# If poses come and go, the times without poses add up, and the sum shrinks by this share of the
# time with poses. Above this sum, a vehicle lands.
FLICKER_S = 0.6
FLICKER_FORGOTTEN_SHARE = 0.2
LARGEST_FLICKER_S = 1.5  # the sum does not grow beyond this
NEIGHBOUR_BLIND_S = 0.25  # a neighbour that reports no poses for longer counts as blind
RECKONING_S = 6.0  # after this time of dead reckoning PX4 lands
RECKONING_AMONG_OTHERS_S = 12.0  # the same near other vehicles, because PX4 does not avoid them
AMONG_OTHERS_M = 5.0  # a vehicle nearer than this to another one is among others

# A flying vehicle that stays lower above the lowest ground may lie on it.
DOWN_HEIGHT_M = 0.12

# PX4
AUTOPILOT_SILENT_S = 0.3  # PX4 is silent if no packet has arrived for longer
LOCAL_POSITION_FRESH_S = 0.25  # PX4's local position arrives at 10 Hz

# Largest standard deviations that are published and accepted. A margin for larger ones would push
# the other vehicles out of the fence.
LARGEST_POSITION_STD_M = 0.5
LARGEST_VELOCITY_STD_M_S = 0.5
# PX4 reports the deviation of both horizontal axes together
LARGEST_PX4_ACCURACY_M = math.sqrt(2.0) * LARGEST_POSITION_STD_M
