"""Numbers and words of the facts, computed from received messages.

A number that could not be measured is NOT_MEASURED, which reports show as "nothing". It agrees only
with a fact that allows the word "nothing".
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence

from sitl.conformance.endpoint import ReceivedPacket

NOT_MEASURED = math.nan


def mean(values: Iterable[float]) -> float:
    """Return the mean of measured values; NOT_MEASURED without values."""
    listed = list(values)
    if not listed:
        return NOT_MEASURED
    return statistics.fmean(listed)


def first_s(packets: Sequence[ReceivedPacket]) -> float:
    """Return the time of the first packet; NOT_MEASURED without packets."""
    if not packets:
        return NOT_MEASURED
    return packets[0].at_s


def sent_or_not(received: object) -> str:
    """Return the word of the facts for whether packets or texts were received."""
    if received:
        return "sent"
    return "not sent"


def yes_or_no(answer: bool) -> str:
    """Return the word of the facts for an answer."""
    if answer:
        return "yes"
    return "no"


def count_or_none(count: int, unit: str) -> str:
    """Return the number of unexpected messages as text, or "none"."""
    if not count:
        return "none"
    return f"{count} {unit}"
