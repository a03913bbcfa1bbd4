"""Assigns slots (places in a formation) to vehicles: flights are short, and do not cross. Pure.

Two assignment problems are solved: the bottleneck problem (the largest cost is least) and the
linear one (the sum of costs is least), both by shortest augmenting chains.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from onboard.arrays import Array
from onboard.tuples import Xyz

_FORBIDDEN = 1e9  # cost of a flight that is not allowed, above every squared distance [m²]
_ROUNDING_M2 = 1e-9  # allowance for rounding errors of squared distances


def nearest_slots(
    slots: Mapping[str, Xyz], positions: Mapping[str, Xyz], centre: Xyz
) -> dict[str, str]:
    """Reassign the slots of a formation.

    The longest flight is as short as possible. Among all such assignments, the sum of the squared
    flights is least, so that straight ways hardly cross.

    Args:
        slots: offset of each vehicle [m], ENU.
        positions: positions of the vehicles that fly there [m], ENU; a vehicle without a position
            keeps its slot.
        centre: position of the formation [m], ENU.

    Returns:
        vehicle -> the vehicle whose slot it takes.
    """
    names = [name for name in slots if name in positions]
    if len(names) < 2:
        return {name: name for name in slots}

    goals = np.array([slots[name] for name in names]) + np.array(centre)
    starts = np.array([positions[name] for name in names])
    squares_m2 = _squares_m2(starts, goals)

    # Forbid flights that are longer than the best assignment needs; then minimize the sum.
    is_allowed = squares_m2 <= least_longest(squares_m2) + _ROUNDING_M2
    columns = least_sum(np.where(is_allowed, squares_m2, _FORBIDDEN))
    slot_of = {name: names[column] for name, column in zip(names, columns, strict=True)}
    return {name: slot_of.get(name, name) for name in slots}


def spots_without_crossing(
    spots: Mapping[str, Xyz], positions: Mapping[str, Xyz]
) -> dict[str, str]:
    """Assign spots so that straight ways that take the same time do not cross.

    The sum of the squared ways is least, so no exchange of two spots makes it smaller. It follows
    that two vehicles never come nearer than d / sqrt(2), where d is the smaller of their distances
    at the start and at the end (Turpin, Michael and Kumar, CAPT, 2014). Heights do not count,
    because vehicles fly back at their own heights.

    Args:
        spots: spot of each vehicle [m], ENU.
        positions: positions of the vehicles that fly there [m], ENU.

    Returns:
        vehicle -> the vehicle whose spot it takes.
    """
    names = [name for name in spots if name in positions]
    if len(names) < 2:
        return {name: name for name in names}

    goals = np.array([spots[name][:2] for name in names])
    starts = np.array([positions[name][:2] for name in names])
    squares_m2 = _squares_m2(starts, goals)
    columns = least_sum(squares_m2)
    return {name: names[column] for name, column in zip(names, columns, strict=True)}


def _squares_m2(starts: Array, goals: Array) -> Array:
    """Return the squared flights from each start to each goal [m²], at most _FORBIDDEN.

    Without that bound, a flight that is not finite would keep the searches below from ending.

    Args:
        starts: positions (N, D) [m].
        goals: positions (N, D) [m].
    """
    with np.errstate(over="ignore", invalid="ignore"):
        squares_m2 = ((starts[:, None] - goals[None]) ** 2).sum(-1)
    bounded_m2: Array = np.nan_to_num(np.minimum(squares_m2, _FORBIDDEN), nan=_FORBIDDEN)
    return bounded_m2


def least_longest(costs: Array) -> float:
    """Return the largest cost of the assignment whose largest cost is least.

    Rows are assigned one after the other. A new row may take the column of an earlier one, which
    then takes another column, and so on. Of all such chains, the one whose largest cost is least
    is used.

    Args:
        costs: costs (N, N) of row i in column j.
    """
    count = len(costs)
    row_of = np.full(count, -1)  # row of each column; -1: none
    largest = 0.0

    for row in range(count):
        reach = costs[row].copy()  # largest cost of the best chain to each column
        came_from = np.full(count, -1)  # the column before each column in its chain; -1: none
        is_open = np.ones(count, dtype=bool)

        # Dijkstra's search, with the largest cost of a chain instead of its length. It ends at the
        # first column that no row has.
        while True:
            column = int(np.where(is_open, reach, np.inf).argmin())
            if row_of[column] < 0:
                break
            is_open[column] = False
            through = np.maximum(reach[column], costs[row_of[column]])  # by way of this column
            is_better = is_open & (through < reach)
            reach[is_better] = through[is_better]
            came_from[is_better] = column

        largest = max(largest, float(reach[column]))

        # Each column of the chain gets the row of the column before it. The first column gets the
        # new row.
        while came_from[column] >= 0:
            before = int(came_from[column])
            row_of[column] = row_of[before]
            column = before
        row_of[column] = row
    return largest


def least_sum(costs: Array) -> list[int]:
    """Return the column of each row such that the sum of costs is least.

    This is the Hungarian method with shortest augmenting chains. Rows and columns have prices; a
    cost minus the prices of its row and column is never negative.

    Args:
        costs: costs (N, N) of row i in column j.
    """
    count = len(costs)
    start = count  # an additional column, at which the chain of the new row begins
    row_of = np.full(count + 1, -1)  # row of each column; -1: none
    price_of_row = np.zeros(count)
    price_of_column = np.zeros(count + 1)

    for row in range(count):
        row_of[start] = row
        column = start
        reach = np.full(count, np.inf)  # length of the shortest chain to each column
        came_from = np.full(count, -1)  # the column before each column in its chain; -1: none
        is_open = np.ones(count + 1, dtype=bool)

        # The search ends at the first column that no row has.
        while row_of[column] >= 0:
            is_open[column] = False
            chain_row = row_of[column]
            # the reach by way of this column
            through = costs[chain_row] - price_of_row[chain_row] - price_of_column[:count]
            is_better = is_open[:count] & (through < reach)
            reach[is_better] = through[is_better]
            came_from[is_better] = column

            following = int(np.where(is_open[:count], reach, np.inf).argmin())
            step = reach[following]
            price_of_row[row_of[~is_open]] += step
            price_of_column[~is_open] -= step
            reach[is_open[:count]] -= step
            column = following

        # Each column of the chain gets the row of the column before it. The chain begins at the
        # additional column, which has the new row.
        while column != start:
            before = int(came_from[column])
            row_of[column] = row_of[before]
            column = before

    column_of = [0] * count
    for column in range(count):
        column_of[int(row_of[column])] = column
    return column_of
