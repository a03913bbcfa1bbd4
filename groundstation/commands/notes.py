"""Prints what a record lacks, beside what was made of it."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path


def print_notes(record: Path, notes: Iterable[str]) -> None:
    """Print sentences about a record on stderr, each once, so that stdout has only the files.

    Args:
        record: the flight folder, or its MCAP file, as it was given.
        notes: sentences about what is damaged or missing.
    """
    for note in dict.fromkeys(notes):
        print(f"covey: {record}: {note}", file=sys.stderr)
