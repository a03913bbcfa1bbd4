"""Who takes which slot: such that the longest of all flights is as short as possible. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from onboard.arrays import Array
from onboard.config.fleet import Vec3

_FORBIDDEN = 1e9  # beyond every squared flight


def nearest_slots(
    slots: Mapping[str, Vec3], positions: Mapping[str, Vec3], centre: Vec3
) -> dict[str, str]:
    """Deal the slots of a formation out anew.

    The longest flight is as short as any assignment makes it; of those, the squares of all flights
    sum up to the least, so that straight ways hardly cross.

    Args:
        slots: offset of each vehicle, metres ENU.
        positions: of the vehicles that fly there, metres ENU; whoever has none keeps its slot.
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
    places = least_sum(np.where(squares <= least_longest(squares) + 1e-9, squares, _FORBIDDEN))
    taken = {name: names[place] for name, place in zip(names, places, strict=True)}
    return {name: taken.get(name, name) for name in slots}


def least_longest(costs: Array) -> float:
    """Return the largest cost of the assignment whose largest cost is least.

    Each row in turn is taken in by the chain of exchanges whose worst cost is least.

    Args:
        costs: (N, N), of row i in column j.
    """
    count = len(costs)
    row_of = np.full(count, -1)
    largest = 0.0
    for row in range(count):
        reach, came_from, is_open = (
            costs[row].copy(),
            np.full(count, -1),
            np.ones(count, dtype=bool),
        )
        while True:
            column = int(np.where(is_open, reach, np.inf).argmin())
            if row_of[column] < 0:
                break
            is_open[column] = False
            through = np.maximum(reach[column], costs[row_of[column]])
            is_better = is_open & (through < reach)
            reach[is_better], came_from[is_better] = through[is_better], column
        largest = max(largest, float(reach[column]))
        while came_from[column] >= 0:
            row_of[column], column = row_of[came_from[column]], int(came_from[column])
        row_of[column] = row
    return largest


def least_sum(costs: Array) -> list[int]:
    """Return the column of each row such that the sum of costs is least: the Hungarian method by
    shortest chains.

    Args:
        costs: (N, N), of row i in column j.
    """
    count = len(costs)
    row_of = np.full(count + 1, -1)  # the last column is where the row that is taken in begins
    price_of_row, price_of_column = np.zeros(count), np.zeros(count + 1)
    for row in range(count):
        row_of[count], column = row, count
        reach, came_from, is_open = (
            np.full(count, np.inf),
            np.full(count, -1),
            np.ones(count + 1, dtype=bool),
        )
        while row_of[column] >= 0:
            is_open[column] = False
            here = row_of[column]
            through = costs[here] - price_of_row[here] - price_of_column[:count]
            is_better = is_open[:count] & (through < reach)
            reach[is_better], came_from[is_better] = through[is_better], column
            following = int(np.where(is_open[:count], reach, np.inf).argmin())
            step = reach[following]
            price_of_row[row_of[~is_open]] += step
            price_of_column[~is_open] -= step
            reach[is_open[:count]] -= step
            column = following
        while column != count:
            row_of[column], column = row_of[came_from[column]], int(came_from[column])
    columns = np.empty(count, dtype=np.int64)
    columns[row_of[:count]] = np.arange(count)
    return [int(column) for column in columns]
