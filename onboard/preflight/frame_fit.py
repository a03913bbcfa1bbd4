"""The turn and the shift of the frame, from where vehicles stand on their take-off spots. Pure.

Everybody measures positions in the fleet's frame: that of the motion capture, or of a point of the
Earth. A frame that is turned by a few degrees leaves each vehicle within arm's length of its spot,
and sends those that fly far from its origin through a wall. Only all vehicles together show it: the
turn and the shift that bring the spots of the fleet file onto the seen places best (least squares
in the plane; Arun, Huang and Blostein 1987) are compared with how exactly vehicles are put down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

XY = tuple[float, float]

_SIGMAS = 3.0


class FrameFit(NamedTuple):
    """The turn and the shift from the told spots to the seen ones."""

    turn_rad: float  # counterclockwise
    turn_std_rad: float  # as exactly as the spots show it
    shift_m: float  # of the spots' centre
    spot_std_m: float  # of one spot, along one axis
    far_m: float  # from the spots' centre to the fence's farthest corner

    @property
    def is_turned(self) -> bool:
        """Whether the turn is more than vehicles that were put down inexactly explain.

        It also has to move the fence's farthest corner by more than a vehicle may be off its spot.
        """
        turn_rad = abs(self.turn_rad)
        is_seen = turn_rad > _SIGMAS * self.turn_std_rad
        return is_seen and turn_rad * self.far_m > _SIGMAS * self.spot_std_m

    @property
    def is_shifted(self) -> bool:
        """Whether all spots together are further off than a single one may be."""
        return self.shift_m > _SIGMAS * self.spot_std_m

    @property
    def unseen_turn_rad(self) -> float:
        """The largest turn that these spots do not show [rad]."""
        return _SIGMAS * self.turn_std_rad


def fit_frame(
    told_m: Sequence[XY], seen_m: Sequence[XY], corners_m: Sequence[XY], std_m: float
) -> FrameFit | None:
    """Fit the told spots to the seen ones.

    Args:
        told_m: take-off spots of the fleet file, east and north [m].
        seen_m: where the vehicles of these spots are seen [m].
        corners_m: of the fence [m].
        std_m: how exactly a vehicle stands on its spot and is seen there, along one axis [m].

    Returns:
        The fit; None for fewer than two spots.
    """
    count = len(told_m)
    if count < 2:
        return None

    told_centre_m = _mean(told_m)
    seen_centre_m = _mean(seen_m)
    told_arms_m = [_minus(spot, told_centre_m) for spot in told_m]
    seen_arms_m = [_minus(spot, seen_centre_m) for spot in seen_m]

    along = 0.0
    across = 0.0
    arms_m2 = 0.0
    for (x, y), (seen_x, seen_y) in zip(told_arms_m, seen_arms_m, strict=True):
        along += x * seen_x + y * seen_y
        across += x * seen_y - y * seen_x
        arms_m2 += x * x + y * y
    turn_rad = math.atan2(across, along)

    residual_m2 = 0.0
    for (x, y), seen_arm_m in zip(told_arms_m, seen_arms_m, strict=True):
        turned_m = (
            math.cos(turn_rad) * x - math.sin(turn_rad) * y,
            math.sin(turn_rad) * x + math.cos(turn_rad) * y,
        )
        residual_m2 += math.dist(turned_m, seen_arm_m) ** 2

    # Vehicles that were put down less exactly than told show a turn less exactly, too. Two axes for
    # each spot, less the turn and the two axes of the shift.
    freedom = 2 * count - 3
    spot_std_m = max(std_m, math.sqrt(residual_m2 / freedom))
    return FrameFit(
        turn_rad=turn_rad,
        turn_std_rad=spot_std_m / math.sqrt(max(arms_m2, 1e-9)),
        shift_m=math.dist(told_centre_m, seen_centre_m),
        spot_std_m=spot_std_m,
        far_m=max(math.dist(told_centre_m, corner_m) for corner_m in corners_m),
    )


def _mean(points_m: Sequence[XY]) -> XY:
    count = len(points_m)
    return (sum(x for x, _ in points_m) / count, sum(y for _, y in points_m) / count)


def _minus(point_m: XY, centre_m: XY) -> XY:
    return (point_m[0] - centre_m[0], point_m[1] - centre_m[1])
