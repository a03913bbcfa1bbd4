"""Finds a turned or shifted frame from the positions of vehicles on their take-off spots. Pure.

All positions are measured in the fleet frame, which belongs to the motion capture or to a point on
Earth. If this frame is turned by a few degrees, each vehicle is still seen near its spot, but a
vehicle that flies far from the origin may hit a wall. Only all vehicles together reveal such an
error. The fit gives the turn and the shift that map the spots of the fleet file to the seen
positions (least squares in the plane; Arun, Huang and Blostein 1987). Turn and shift are compared
with how accurately people place vehicles on their spots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

XY = tuple[float, float]

_SIGMAS = 3.0  # a turn or a shift counts if it exceeds this many standard deviations


class FrameFit(NamedTuple):
    """Turn and shift from the take-off spots of the fleet file to the seen positions."""

    turn_rad: float  # counterclockwise
    turn_std_rad: float  # standard deviation of the turn
    shift_m: float  # shift of the spots' centre
    spot_std_m: float  # standard deviation of one spot, along one axis
    far_m: float  # distance from the spots' centre to the fence's farthest corner

    @property
    def is_turned(self) -> bool:
        """Whether the turn is too large to be explained by inaccurate placing.

        It must also move the fence's farthest corner by more than a vehicle may be off its spot.
        """
        turn_rad = abs(self.turn_rad)
        is_certain = turn_rad > _SIGMAS * self.turn_std_rad
        return is_certain and turn_rad * self.far_m > _SIGMAS * self.spot_std_m

    @property
    def is_shifted(self) -> bool:
        """Whether the centre of all spots is farther off than a single spot may be."""
        return self.shift_m > _SIGMAS * self.spot_std_m

    @property
    def unseen_turn_rad(self) -> float:
        """The largest turn that cannot be detected with these spots [rad]."""
        return _SIGMAS * self.turn_std_rad


def fit_frame(
    planned_m: Sequence[XY], seen_m: Sequence[XY], corners_m: Sequence[XY], std_m: float
) -> FrameFit | None:
    """Fit the take-off spots of the fleet file to the seen positions.

    Args:
        planned_m: take-off spots of the fleet file, east and north [m].
        seen_m: seen positions of the vehicles on these spots, in the same order [m].
        corners_m: corners of the fence [m].
        std_m: standard deviation of placing a vehicle on its spot and measuring it, per axis [m].

    Returns:
        The fit; None for fewer than two spots.
    """
    count = len(planned_m)
    if count < 2:
        return None

    planned_centre_m = _mean(planned_m)
    seen_centre_m = _mean(seen_m)
    planned_from_centre_m = [_minus(spot, planned_centre_m) for spot in planned_m]
    seen_from_centre_m = [_minus(spot, seen_centre_m) for spot in seen_m]

    # sums of the scalar and the vector products; their ratio is the tangent of the turn
    scalar_products = 0.0
    vector_products = 0.0
    squares_m2 = 0.0  # sum of the squared distances of the spots from their centre
    for (x, y), (seen_x, seen_y) in zip(planned_from_centre_m, seen_from_centre_m, strict=True):
        scalar_products += x * seen_x + y * seen_y
        vector_products += x * seen_y - y * seen_x
        squares_m2 += x * x + y * y
    turn_rad = math.atan2(vector_products, scalar_products)

    residual_m2 = 0.0
    for (x, y), seen_xy_m in zip(planned_from_centre_m, seen_from_centre_m, strict=True):
        turned_m = (
            math.cos(turn_rad) * x - math.sin(turn_rad) * y,
            math.sin(turn_rad) * x + math.cos(turn_rad) * y,
        )
        residual_m2 += math.dist(turned_m, seen_xy_m) ** 2

    # If the residuals show that the vehicles were placed less accurately than std_m, the residuals
    # are used instead of std_m. The degrees of freedom are two per spot, minus one for the turn and
    # two for the shift.
    freedom = 2 * count - 3
    spot_std_m = max(std_m, math.sqrt(residual_m2 / freedom))
    return FrameFit(
        turn_rad=turn_rad,
        turn_std_rad=spot_std_m / math.sqrt(max(squares_m2, 1e-9)),
        shift_m=math.dist(planned_centre_m, seen_centre_m),
        spot_std_m=spot_std_m,
        far_m=max(math.dist(planned_centre_m, corner_m) for corner_m in corners_m),
    )


def _mean(points_m: Sequence[XY]) -> XY:
    count = len(points_m)
    return (sum(x for x, _ in points_m) / count, sum(y for _, y in points_m) / count)


def _minus(point_m: XY, centre_m: XY) -> XY:
    x, y = point_m
    centre_x, centre_y = centre_m
    return (x - centre_x, y - centre_y)
