"""Who takes which slot: such that the longest of all flights is as short as possible. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from onboard.arrays import Array
from onboard.tuples import Xyz

_FORBIDDEN = 1e9  # beyond every squared flight


def nearest_slots(
    slots: Mapping[str, Xyz], positions: Mapping[str, Xyz], centre: Xyz
) -> dict[str, str]:
    """Deal the slots of a formation out anew.

    The longest flight is as short as any assignment makes it; of those, the squares of all flights
    sum up to the least, so that straight ways hardly cross.

    Args:
        slots: offset of each vehicle, metres ENU.
        positions: positions of the vehicles that fly there, metres ENU; whoever has none keeps its
            slot.
        centre: position of the formation.

    Returns:
        For each vehicle the one whose slot it takes.
    """
    names = [name for name in slots if name in positions]
    if len(names) < 2:
        return {name: name for name in slots}

    goals = np.array([slots[name] for name in names]) + np.array(centre)
    starts = np.array([positions[name] for name in names])
    squares = ((starts[:, None] - goals[None]) ** 2).sum(-1)

    # no flight longer than the best assignment needs; among these the least sum
    is_allowed = squares <= least_longest(squares) + 1e-9
    columns = least_sum(np.where(is_allowed, squares, _FORBIDDEN))
    taken = {name: names[column] for name, column in zip(names, columns, strict=True)}
    return {name: taken.get(name, name) for name in slots}


def spots_without_crossing(
    spots: Mapping[str, Xyz], positions: Mapping[str, Xyz]
) -> dict[str, str]:
    """Deal spots out so that straight ways that take the same time do not cross.

    The sum of the squares of all ways is the least. Then no exchange of two spots makes it smaller,
    which says that no two vehicles come nearer on their ways than the smaller of their distances at
    the begin and at the end, over the square root of 2 (Turpin, Michael and Kumar, CAPT, 2014).
    Heights do not count: vehicles fly back at their own.

    Args:
        spots: spot of each vehicle [m], ENU.
        positions: positions of the vehicles that fly there, metres ENU.

    Returns:
        For each vehicle the one whose spot it takes.
    """
    names = [name for name in spots if name in positions]
    if len(names) < 2:
        return {name: name for name in names}

    goals = np.array([spots[name][:2] for name in names])
    starts = np.array([positions[name][:2] for name in names])
    squares = ((starts[:, None] - goals[None]) ** 2).sum(-1)
    return {name: names[column] for name, column in zip(names, least_sum(squares), strict=True)}


def least_longest(costs: Array) -> float:
    """Return the largest cost of the assignment whose largest cost is least.

    Each row in turn is taken in by the chain of exchanges whose worst cost is least.

    Args:
        costs: (N, N), of row i in column j.
    """
    count = len(costs)
    row_of = np.full(count, -1)  # of each column; -1: not taken
    largest = 0.0

    for row in range(count):
        reach = costs[row].copy()  # worst cost of the chain that ends at each column
        came_from = np.full(count, -1)  # the column before it in that chain
        is_open = np.ones(count, dtype=bool)

        # Dijkstra's search, with the worst cost of a chain in the place of its length
        while True:
            column = int(np.where(is_open, reach, np.inf).argmin())
            if row_of[column] < 0:
                break
            is_open[column] = False
            through = np.maximum(reach[column], costs[row_of[column]])
            is_better = is_open & (through < reach)
            reach[is_better] = through[is_better]
            came_from[is_better] = column

        largest = max(largest, float(reach[column]))

        # each column of the chain gets the row of the one before it; the first one gets this row
        while came_from[column] >= 0:
            before = int(came_from[column])
            row_of[column] = row_of[before]
            column = before
        row_of[column] = row
    return largest


def least_sum(costs: Array) -> list[int]:
    """Return the column of each row such that the sum of costs is least.

    The Hungarian method by shortest chains: rows and columns have prices, and costs less prices
    are never negative.

    Args:
        costs: (N, N), of row i in column j.
    """
    count = len(costs)
    start = count  # a column more, where the row that is taken in begins
    row_of = np.full(count + 1, -1)  # of each column; -1: not taken
    price_of_row = np.zeros(count)
    price_of_column = np.zeros(count + 1)

    for row in range(count):
        row_of[start] = row
        column = start
        reach = np.full(count, np.inf)  # length of the chain that ends at each column
        came_from = np.full(count, -1)  # the column before it in that chain
        is_open = np.ones(count + 1, dtype=bool)

        while row_of[column] >= 0:
            is_open[column] = False
            here = row_of[column]
            through = costs[here] - price_of_row[here] - price_of_column[:count]
            is_better = is_open[:count] & (through < reach)
            reach[is_better] = through[is_better]
            came_from[is_better] = column

            following = int(np.where(is_open[:count], reach, np.inf).argmin())
            step = reach[following]
            price_of_row[row_of[~is_open]] += step
            price_of_column[~is_open] -= step
            reach[is_open[:count]] -= step
            column = following

        # each column of the chain gets the row of the one before it
        while column != start:
            before = int(came_from[column])
            row_of[column] = row_of[before]
            column = before

    columns = np.empty(count, dtype=np.int64)
    columns[row_of[:count]] = np.arange(count)
    return [int(column) for column in columns]
