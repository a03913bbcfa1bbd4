"""Filter and order of the fleet table. Pure."""

from __future__ import annotations

import math
import re

from groundstation.console.widgets.fleet_columns import COLUMNS, KILLED, VehicleRow

_LAST_CHARACTER = 0x10FFFF


def is_match(row: VehicleRow | None, name: str, label: str, filter_text: str) -> bool:
    """Whether every word of a filter matches a vehicle.

    A word of a filter is a part of the vehicle's name, a range of numbers such as ``0-3``, a state,
    a mode, or a condition: ``silent``, ``waiting``, ``armed``, ``airborne``, ``unready`` or
    ``low``. A ``!`` before a word negates it. A number means what it means in an order: ``label``.
    """
    words = [name.lower()]
    if row is None:
        words.append("waiting")
    else:
        words += row.state.split()
        words.append(row.telemetry.mode.lower())
        words += _conditions(row)
    return all(_fits(term, words, label) for term in filter_text.lower().split())


def _conditions(row: VehicleRow) -> list[str]:
    """Return the words of all conditions that are true for a vehicle."""
    telemetry = row.telemetry
    charge_pct = telemetry.battery_frac * 100.0
    is_refusing = bool(telemetry.not_ready) and not telemetry.is_airborne
    is_unready = is_refusing or row.state == KILLED
    conditions = {
        "silent": row.is_stale,
        "armed": row.view.is_armed,
        "airborne": row.view.is_airborne,
        "unready": is_unready,
        "low": charge_pct <= row.fleet.fleet.battery_warning_pct,
    }
    return [word for word, is_true in conditions.items() if is_true]


def _fits(term: str, words: list[str], label: str) -> bool:
    """Whether one word of a filter matches; the first of the vehicle's words is its name."""
    if term.startswith("!") and len(term) > 1:
        return not _fits(term[1:], words, label)

    span = re.fullmatch(r"([0-9]{1,6})-([0-9]{1,6})", term)
    if span:
        return label.isdecimal() and int(span[1]) <= int(label) <= int(span[2])

    name, *others = words
    return term in name or any(word.startswith(term) for word in others)


def sort_key(
    row: VehicleRow | None, *, name: str, index: int, sort: str, is_reversed: bool
) -> tuple[bool, float, str, int]:
    """Return the key that sorts the table by a column, by ``name`` or by ``place`` in the file.

    Vehicles without a value come last, in both directions.

    Returns:
        Whether the value is missing, the value, the name (if the table is sorted by it), and the
            index in the file, which decides between equal values.
    """
    direction = -1.0 if is_reversed else 1.0
    if sort == "place":
        return False, direction * index, "", index
    if sort == "name":
        text = _reversed_order(name) if is_reversed else name
        return False, 0.0, text, index

    column = next(column for column in COLUMNS if column.title == sort)
    value = math.nan
    if row is not None and column.sort is not None:
        value = column.sort(row)

    if math.isnan(value):
        return True, 0.0, "", index
    return False, direction * value, "", index


def _reversed_order(name: str) -> str:
    """Return a text that sorts in the opposite order."""
    return "".join(chr(_LAST_CHARACTER - ord(char)) for char in name)
