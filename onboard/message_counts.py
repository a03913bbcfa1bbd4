"""Counts of the messages that were not used.

A count each, and no line in a log: a flood must fill nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(slots=True)
class MessageCounts:
    """Messages that were not used, by the reason."""

    malformed: int = 0  # no message of its kind, or numbers that are not finite
    # in another's name, of a node that the fleet file lacks, or not believable; orders are counted
    # apart
    refused: int = 0
    # lost on the way, by the numbers that are missing, or pushed out of a full queue
    dropped: int = 0
    late: int = 0  # repeated, overtaken, or older than what is known


def total(counts: Iterable[MessageCounts]) -> MessageCounts:
    """Return the sum of several counts."""
    sums = MessageCounts()
    for one in counts:
        sums.malformed += one.malformed
        sums.refused += one.refused
        sums.dropped += one.dropped
        sums.late += one.late
    return sums


def in_words(malformed: int, refused: int, dropped: int, late: int) -> str:
    """Return counts of messages, without those that are 0; empty when all are."""
    counts = {"malformed": malformed, "refused": refused, "dropped": dropped, "late": late}
    return ", ".join(f"{count} {word}" for word, count in counts.items() if count)
