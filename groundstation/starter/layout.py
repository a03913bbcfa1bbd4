"""The layout of a new fleet: take-off spots, a ring formation, and the size of the fence. Pure."""

from __future__ import annotations

import math

Plan = tuple[float, float]


def grid(count: int, spacing_m: float) -> list[Plan]:
    """Return take-off spots in rows about the origin, up to four in one row.

    Args:
        count: number of vehicles.
        spacing_m: distance of neighbours in a row, and of rows [m].

    Returns:
        East and north of each vehicle [m].
    """
    columns = count
    if count > 4:
        columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)

    spots = []
    for index in range(count):
        row, column = divmod(index, columns)
        in_row = min(columns, count - row * columns)
        x = (column - 0.5 * (in_row - 1)) * spacing_m
        y = (row - 0.5 * (rows - 1)) * spacing_m
        spots.append((round(x, 2), round(y, 2)))
    return spots


def ring(count: int, spacing_m: float, starts: list[Plan]) -> list[Plan]:
    """Return slots on a circle; each vehicle's slot is on the side on which it starts.

    Args:
        count: number of vehicles.
        spacing_m: least distance of two slots [m].
        starts: take-off spots [m].

    Returns:
        East and north of each vehicle's slot from the centre [m].
    """
    if count == 1:
        return [(0.0, 0.0)]

    # 0.01 m more, so that rounding below does not bring slots nearer
    radius_m = 0.5 * spacing_m / math.sin(math.pi / count) + 0.01
    slots = []
    for slot in range(count):
        angle_rad = 2.0 * math.pi * slot / count
        x = round(radius_m * math.cos(angle_rad), 2)
        y = round(radius_m * math.sin(angle_rad), 2)
        slots.append((x, y))

    # vehicles, sorted by their direction from the centre, get the slots in the order of the circle
    def direction_rad(index: int) -> float:
        x, y = starts[index]
        return math.atan2(y, x)

    in_turn = sorted(range(count), key=direction_rad)

    def sum_of_squares(offset: int) -> float:
        """Return the sum of squared distances if the slots are shifted by ``offset`` places."""
        return sum(
            math.dist(starts[index], slots[(position + offset) % count]) ** 2
            for position, index in enumerate(in_turn)
        )

    offset = min(range(count), key=sum_of_squares)
    result = [(0.0, 0.0)] * count
    for position, index in enumerate(in_turn):
        result[index] = slots[(position + offset) % count]
    return result


def half_width_m(points: list[Plan], room_m: float) -> float:
    """Return half the width of a square fence around the origin.

    Args:
        points: east and north of points inside the fence [m].
        room_m: least distance of the points from the fence [m].

    Returns:
        Half width [m], a multiple of half a metre.
    """
    farthest_m = max(max(abs(x), abs(y)) for x, y in points)
    return math.ceil(2.0 * (farthest_m + room_m)) / 2.0
