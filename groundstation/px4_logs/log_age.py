"""The order in which PX4's names put logs and their folders: by date and time.

PX4 names the folder of a flight by its date, or ``sess012`` if it does not know the date.
"""

from __future__ import annotations


def age_key(name: str) -> tuple[bool, str]:
    """Return a sort key of names, from the oldest to the newest; those without a date come first.

    Args:
        name: name of a folder or of a log, as PX4 gives it.
    """
    is_dated = name[:1].isdecimal()
    return is_dated, name
