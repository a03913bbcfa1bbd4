"""How the pipeline controls a vehicle in each part of a flight."""

from __future__ import annotations

from enum import IntEnum


class ControlMode(IntEnum):
    """Mode of the pipeline's stages in one part of a flight."""

    GROUND = 0  # level without thrust; the memory of every stage is reset at each tick
    LIFTOFF = 1  # climbs off the ground, gently in the horizontal; observers are frozen
    FLYING = 2
    LANDING = 3  # like FLYING, but the hover thrust is not learned near the ground
    # descends without poses: nothing is learned, and the mean disturbance of the last seconds
    # is compensated
    DEAD_RECKONING = 4
