"""The tables of many vehicles as common arrays, and what they hear as arrays: one call where a loop
would make many.

For simulations of whole fleets in one process; a drone has one table, and hears message by message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.bus.schema import StateMessage
from onboard.neighbours import subscription
from onboard.neighbours.state_arrays import (
    COLUMNS,
    COLUMNS_1,
    COOPERATIVE,
    WIDTH,
    NeighbourArrays,
    is_usable,
    numbers_of,
)
from onboard.neighbours.table import NeighbourTable
from onboard.rollout.batch import NEIGHBOUR
from onboard.rollout.rows import Rows

_SHARED = tuple(field.name for field in fields(NeighbourArrays))


@dataclass(frozen=True, slots=True)
class Round:
    """State messages that arrive together, one of each vehicle at most, as arrays (N, ...) over the
    whole fleet.

    numbers (N, 25): all vectors and scalars of the messages. stamp_ns (N,). flags (6, N): is
    there a message, is it finite, is_valid, is_airborne, is_cooperative, is it one of the slow ones
    that all hear.
    """

    numbers: Array
    stamp_ns: IntArray
    flags: BoolArray

    @classmethod
    def of(cls, messages: Sequence[StateMessage], indices: Mapping[str, int]) -> Round:
        """Of messages of vehicles that stand in ``indices``."""
        count = len(indices)
        numbers, stamp_ns = np.zeros((count, WIDTH)), np.zeros(count, dtype=np.int64)
        flags = np.zeros((6, count), dtype=bool)
        at = [indices[m.vehicle] for m in messages]
        rows = [numbers_of(m) for m in messages]
        numbers[at] = rows
        stamp_ns[at] = [m.stamp_ns for m in messages]
        flags[:, at] = np.array(
            [
                (
                    True,
                    is_usable(m, row),
                    m.is_valid,
                    m.is_airborne,
                    m.is_cooperative,
                    subscription.is_slow(m.sequence),
                )
                for m, row in zip(messages, rows, strict=True)
            ]
        ).T
        return cls(numbers, stamp_ns, flags)


class Tables:
    """The tables of several vehicles of one fleet, kept as the rows of common arrays: what all hear
    is heard at once.

    A table stays what it is; only its arrays now lie here. Rows: tables (N), columns: their
    neighbours (K).
    """

    def __init__(self, tables: Sequence[NeighbourTable]) -> None:
        """At least one table, all of equally many neighbours."""
        self.tables = tuple(tables)
        self.all_listening = np.ones(len(tables), dtype=bool)
        self._others = np.array([table.fleet_indices for table in tables])
        self._is_successor = np.array([table.is_successor for table in tables])
        stacked = {
            name: np.array([getattr(table.arrays, name) for table in tables]) for name in _SHARED
        }
        self.arrays = NeighbourArrays(**stacked)
        for row, table in enumerate(tables):
            table.arrays = NeighbourArrays(**{name: array[row] for name, array in stacked.items()})

    def hear(self, arrived: Round, received_ns: int, is_listening: BoolArray) -> None:
        """:meth:`NeighbourTable.hear` of every message of a round but a vehicle's own, by all that
        follow its sender.

        Args:
            is_listening: which of the tables hear at all, (N,).
        """
        others = self._others
        is_here, is_usable, is_valid, is_airborne, is_cooperative, is_slow = arrived.flags
        is_heard = (
            is_here[others] & (self.arrays.is_followed | is_slow[others]) & is_listening[:, None]
        )
        stamps = np.minimum(arrived.stamp_ns, received_ns)[others]
        is_news = is_heard & is_usable[others] & (stamps > self.arrays.newest_ns)
        for row in np.flatnonzero(is_heard.any(axis=1)).tolist():
            table = self.tables[row]
            table.last_heard_ns = max(table.last_heard_ns, received_ns)
        if is_heard.sum() != is_news.sum():
            malformed = np.count_nonzero(is_heard & ~is_usable[others], axis=1).tolist()
            ignored = np.count_nonzero(is_heard & ~is_news, axis=1).tolist()
            for table, count, bad in zip(self.tables, ignored, malformed, strict=True):
                table.counts.malformed += bad
                table.counts.late += count - bad
        rows, columns = is_news.nonzero()
        senders = others[rows, columns]
        self.arrays.newest_ns[rows, columns] = stamps[rows, columns]
        self.arrays.is_lost[rows, columns] = ~is_valid[senders]
        if not is_valid.all():
            placed = is_valid[senders]
            rows, columns, senders = rows[placed], columns[placed], senders[placed]
        self.arrays.stamp_ns[rows, columns] = self.arrays.heard_ns[rows, columns] = stamps[
            rows, columns
        ]
        self.arrays.numbers[rows, columns] = arrived.numbers[senders]
        for kind, flag in enumerate((is_valid, is_airborne, is_cooperative, is_cooperative)):
            self.arrays.flags[rows, kind, columns] = flag[senders]
        for table in self.tables:
            table.forget_ages()
            if table.judged.not_cooperating:
                table.arrays.flags[COOPERATIVE, list(table.judged.not_cooperating)] = False

    def age(self, now_ns: int) -> None:
        """Let all tables know the ages at this time."""
        ages_s = np.maximum(now_ns - self.arrays.stamp_ns, 0) * 1e-9
        ages_s[~self.arrays.flags[:, 0]] = np.inf
        has_silent = np.asarray((ages_s > self.arrays.silent_after_s).any(axis=1)).tolist()
        for table, row, has_one in zip(self.tables, ages_s.tolist(), has_silent, strict=True):
            table.set_ages(row, now_ns, has_one)

    def snapshots(self, rows: Sequence[int], now_ns: int) -> tuple[Rows, BoolArray]:
        """Return the snapshots of some of the tables (n, K) as rows of Neighbour, and which of them
        are present.
        """
        at = np.asarray(rows)
        numbers, flags = self.arrays.numbers[at], self.arrays.flags[at]
        ages_s = np.array([self.tables[row].ages_s(now_ns) for row in rows]).reshape(
            flags[:, 0].shape
        )
        neighbours = NEIGHBOUR.rows(ages_s.shape)
        for name, columns in COLUMNS.items():
            neighbours[name] = numbers[:, :, columns]
        for name, column in COLUMNS_1.items():
            neighbours[name] = numbers[:, :, column]
        neighbours["age_s"] = ages_s
        neighbours["is_cooperative"] = flags[:, 2] & (ages_s <= self.arrays.silent_after_s[at])
        neighbours["is_paper_obstacle"] = self._is_successor[at]
        neighbours["table_index"] = np.arange(ages_s.shape[1])
        return neighbours, flags[:, 0]
