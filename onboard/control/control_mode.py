"""How the pipeline controls a vehicle in each part of a flight."""

from __future__ import annotations

from enum import IntEnum


class ControlMode(IntEnum):
    """What the pipeline does with its stages."""

    GROUND = 0  # level at no thrust; every memory is kept reset
    LIFTOFF = 1  # climbs off the ground: gentle horizontally, observers frozen
    FLYING = 2
    LANDING = 3  # as flying, but the hover thrust is not learned near the ground
    BLIND = 4  # dead reckoning: nothing is learned, and what was learned is replaced by its mean
