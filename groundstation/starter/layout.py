"""Where the vehicles of a new fleet stand, how they form up, and how large the fence must be.

Pure.
"""

from __future__ import annotations

import math

Plan = tuple[float, float]


def grid(count: int, spacing_m: float) -> list[Plan]:
    """Return take-off spots in rows about the origin, up to four in one row.

    Args:
        count: how many vehicles.
        spacing_m: distance of neighbours in a row and of rows [m].
    Returns:
        east and north of each vehicle [m].
    """
    columns = count if count <= 4 else math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    spots = []
    for index in range(count):
        row, column = divmod(index, columns)
        in_row = min(columns, count - row * columns)
        x = (column - 0.5 * (in_row - 1)) * spacing_m
        spots.append((round(x, 2), round((row - 0.5 * (rows - 1)) * spacing_m, 2)))
    return spots


def ring(count: int, spacing_m: float, starts: list[Plan]) -> list[Plan]:
    """Return slots on a circle, each vehicle's towards the side on which it starts.

    Args:
        count: how many vehicles.
        spacing_m: least distance of two slots [m].
        starts: take-off spots [m].
    Returns:
        east and north of each vehicle's slot from the centre [m].
    """
    if count == 1:
        return [(0.0, 0.0)]
    # the rounding below must not bring them nearer
    radius_m = 0.5 * spacing_m / math.sin(math.pi / count) + 0.01
    angles = [2.0 * math.pi * slot / count for slot in range(count)]
    slots = [(round(radius_m * math.cos(a), 2), round(radius_m * math.sin(a), 2)) for a in angles]
    in_turn = sorted(range(count), key=lambda index: math.atan2(starts[index][1], starts[index][0]))

    def way_2(turn: int) -> float:
        pairs = (
            (starts[index], slots[(place + turn) % count]) for place, index in enumerate(in_turn)
        )
        return sum(math.dist(start, slot) ** 2 for start, slot in pairs)

    turn = min(range(count), key=way_2)
    result = [(0.0, 0.0)] * count
    for place, index in enumerate(in_turn):
        result[index] = slots[(place + turn) % count]
    return result


def half_width_m(points: list[Plan], room_m: float) -> float:
    """Return half the width of a square fence around the origin that holds all points with room
    beside them.

    Args:
        points: east and north [m].
        room_m: between the points and the fence [m].
    Returns:
        half width [m], a multiple of half a metre.
    """
    return math.ceil(2.0 * (max(max(abs(x), abs(y)) for x, y in points) + room_m)) / 2.0
