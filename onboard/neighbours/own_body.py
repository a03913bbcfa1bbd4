"""Finds out whether a mocap pose of a neighbour's body is a pose of our own body. Pure.

A motion capture may confuse two bodies. Then it sees a neighbour where our own vehicle is. If that
position were avoided, our vehicle would flee from itself, ever faster, as the body moves along.
A vehicle that flies by the motion capture notices the confusion in its own poses. A vehicle that
flies by vision or by satellites has none.

Two bodies cannot be nearer to each other than the diameter of a body. But a neighbour may come as
near as that, in a collision. It is seen, or heard, on its way. So a pose shows our own body if it
is there where the neighbour was not expected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from onboard.tuples import Xyz

_EXPECTED_M = 0.5  # a neighbour is within this distance of its expected position


@dataclass(slots=True)
class OwnBody:
    """Our own position, and the neighbours in whose poses our own body is seen.

    Attributes:
        position_enu_m: our own position [m] in fleet ENU; None while it is not known.
    """

    body_diameter_m: float
    separation_m: float  # smallest distance that vehicles keep
    position_enu_m: Xyz | None = None
    _confused: set[int] = field(default_factory=set)  # indices of these neighbours

    def is_seen_in(self, index: int, pose_enu_m: Xyz, expected_enu_m: Xyz | None) -> bool:
        """Return whether a pose of a neighbour's body shows our own body.

        Once it does, it does so until it is farther away than vehicles come, because our own
        position may drift from the mocap's.

        Args:
            index: index of the neighbour.
            pose_enu_m: where the mocap sees its body [m].
            expected_enu_m: where the neighbour is expected by its newest state [m]; None: unknown.
        """
        if self.position_enu_m is None:
            return False
        distance_m = math.dist(pose_enu_m, self.position_enu_m)

        if index in self._confused:
            if distance_m > self.separation_m:
                self._confused.discard(index)
            return distance_m <= self.separation_m

        is_expected = (
            expected_enu_m is not None and math.dist(pose_enu_m, expected_enu_m) < _EXPECTED_M
        )
        if is_expected or distance_m > self.body_diameter_m:
            return False
        self._confused.add(index)
        return True
