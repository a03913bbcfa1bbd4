"""The geofence, with positions and velocities that were judged by hand."""

from __future__ import annotations

import math

from onboard.safety.geofence import Fence, FenceStatus

ROOM = Fence((-4.0, -4.0, 0.0), (4.0, 4.0, 3.0), (2.0, 2.0, 4.0), reaction_s=0.2)
INSIDE, NEAR = FenceStatus(False, False, False), FenceStatus(True, False, False)
OUTSIDE, ABOVE = FenceStatus(False, True, False), FenceStatus(False, False, True)


CASES = [
    ((0.0, 0.0, 1.0), (1.0, 1.0, 0.0), INSIDE),
    ((4.0, -4.0, 3.0), (0.0, 0.0, 0.0), INSIDE),  # on the wall
    ((4.01, 0.0, 1.0), (0.0, 0.0, 0.0), OUTSIDE),
    ((0.0, -4.3, 1.0), (0.0, 1.0, 0.0), OUTSIDE),
    ((0.0, 0.0, 3.1), (0.0, 0.0, -1.0), ABOVE),
    ((4.1, 0.0, 3.1), (0.0, 0.0, 0.0), FenceStatus(False, True, True)),
    ((0.0, 0.0, -0.4), (0.0, 0.0, -1.0), INSIDE),  # landed, a bit below where it is measured
    ((0.0, 0.0, -0.6), (0.0, 0.0, 0.0), OUTSIDE),
    ((3.5, 0.0, 1.0), (1.0, 0.0, 0.0), INSIDE),  # stops within 0.45 m
    ((3.6, 0.0, 1.0), (1.0, 0.0, 0.0), NEAR),
    ((-3.6, 0.0, 1.0), (1.0, 0.0, 0.0), INSIDE),  # flies away from that wall
    ((0.0, -3.6, 1.0), (0.0, -1.0, 0.0), NEAR),
    ((0.0, 0.0, 2.8), (0.0, 0.0, 1.0), NEAR),
    ((0.0, 0.0, 0.1), (0.0, 0.0, -2.0), INSIDE),  # sinking ends on the floor
    ((math.nan, 0.0, 1.0), (0.0, 0.0, 0.0), OUTSIDE),
    ((0.0, 0.0, math.inf), (0.0, 0.0, 0.0), OUTSIDE),
]


def test_a_vehicle_is_inside_near_outside_or_above() -> None:
    for position, velocity, expected in CASES:
        assert ROOM.status(position, velocity) == expected, f"{position} {velocity}"
