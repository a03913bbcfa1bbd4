"""Filter and order of the fleet table. Pure."""

from __future__ import annotations

import math
import re

from groundstation.console.widgets.fleet_columns import COLUMNS, VehicleRow


def is_match(row: VehicleRow | None, name: str, index: int, filter_text: str) -> bool:
    """Whether every word of a filter fits: part of the name, a range of indices, a state, mode, or
    a condition.

    ``silent``, ``waiting``, ``armed``, ``airborne``, ``unready`` and ``low`` are conditions; ``!``
    negates a word.
    """
    words = [name.lower()]
    if row is None:
        words.append("waiting")
    else:
        telemetry = row.telemetry
        holds = {
            "silent": row.is_stale,
            "armed": row.view.is_armed,
            "airborne": row.view.is_airborne,
            "unready": bool(telemetry.not_ready) and not telemetry.is_airborne,
            "low": telemetry.battery_frac * 100.0 <= row.fleet.fleet.battery_warning_pct,
        }
        words += [
            *telemetry.state.split(),
            telemetry.mode.lower(),
            *(word for word, is_so in holds.items() if is_so),
        ]
    return all(_fits(term, words, index) for term in filter_text.lower().split())


def sort_key(
    row: VehicleRow | None, name: str, index: int, sort: str, is_reversed: bool
) -> tuple[bool, float, str, int]:
    """Return the key that sorts the table; vehicles without a value stand last, in either
    direction.
    """
    turn = -1.0 if is_reversed else 1.0
    if sort == "place":
        return False, turn * index, "", index
    if sort == "name":
        return (
            False,
            0.0,
            "".join(chr(0x10FFFF - ord(char)) for char in name) if is_reversed else name,
            index,
        )
    column = next(column for column in COLUMNS if column.title == sort)
    value = math.nan if row is None or column.sort is None else column.sort(row)
    return math.isnan(value), 0.0 if math.isnan(value) else turn * value, "", index


def _fits(term: str, words: list[str], index: int) -> bool:
    if term.startswith("!") and len(term) > 1:
        return not _fits(term[1:], words, index)
    span = re.fullmatch(r"([0-9]{1,6})-([0-9]{1,6})", term)
    if span:
        return int(span[1]) <= index <= int(span[2])
    return term in words[0] or any(word.startswith(term) for word in words[1:])
