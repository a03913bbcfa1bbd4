"""Who is shown in the fleet table, and in which order. Pure."""

from __future__ import annotations

import math
import re

from groundstation.console.widgets.fleet_columns import COLUMNS, Row


def is_wanted(row: Row | None, name: str, place: int, wish: str) -> bool:
    """Whether every word of a filter fits: part of the name, a range of places, a state, mode, or a condition.

    ``silent``, ``waiting``, ``armed``, ``airborne``, ``unready`` and ``low`` are conditions; ``!`` turns a word round.
    """
    words = [name.lower()]
    if row is None:
        words.append("waiting")
    else:
        told = row.told
        holds = {
            "silent": row.is_stale,
            "armed": row.view.is_armed,
            "airborne": row.view.is_airborne,
            "unready": bool(told.not_ready) and not told.is_airborne,
            "low": told.battery_frac * 100.0 <= row.fleet.fleet.battery_warning_pct,
        }
        words += [*told.state.split(), told.mode.lower(), *(word for word, is_so in holds.items() if is_so)]
    return all(_fits(term, words, place) for term in wish.lower().split())


def sort_key(row: Row | None, name: str, place: int, sort: str, is_reversed: bool) -> tuple[bool, float, str, int]:
    """Place of a vehicle among the others; whoever has no value stands last, in either direction."""
    turn = -1.0 if is_reversed else 1.0
    if sort == "place":
        return False, turn * place, "", place
    if sort == "name":
        return False, 0.0, "".join(chr(0x10FFFF - ord(char)) for char in name) if is_reversed else name, place
    column = next(column for column in COLUMNS if column.title == sort)
    value = math.nan if row is None or column.sort is None else column.sort(row)
    return math.isnan(value), 0.0 if math.isnan(value) else turn * value, "", place


def _fits(term: str, words: list[str], place: int) -> bool:
    if term.startswith("!") and len(term) > 1:
        return not _fits(term[1:], words, place)
    span = re.fullmatch(r"([0-9]{1,6})-([0-9]{1,6})", term)
    if span:
        return int(span[1]) <= place <= int(span[2])
    return term in words[0] or any(word.startswith(term) for word in words[1:])
