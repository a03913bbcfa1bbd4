"""Counts of the messages that were not used.

Unused messages are never logged individually, so that a flood of messages cannot fill a disk.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(slots=True)
class MessageCounts:
    """Numbers of unused messages, by reason."""

    malformed: int = 0  # bytes that do not form a message of their topic, or non-finite numbers
    # sent in another node's name, sent by a node that is not in the fleet file, or not plausible;
    # refused orders are counted elsewhere
    refused: int = 0
    # lost on the way (sequence numbers are missing), or removed from a full queue
    dropped: int = 0
    late: int = 0  # repeated, overtaken by a newer message, or older than what is known


def total(counts: Iterable[MessageCounts]) -> MessageCounts:
    """Return the sum of several counts."""
    sums = MessageCounts()
    for summand in counts:
        sums.malformed += summand.malformed
        sums.refused += summand.refused
        sums.dropped += summand.dropped
        sums.late += summand.late
    return sums


def in_words(malformed: int, refused: int, dropped: int, late: int) -> str:
    """Return the counts that are not 0, for example "3 malformed, 1 late"; empty if all are 0."""
    counts = {"malformed": malformed, "refused": refused, "dropped": dropped, "late": late}
    return ", ".join(f"{count} {word}" for word, count in counts.items() if count)
