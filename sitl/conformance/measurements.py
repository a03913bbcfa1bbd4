"""The numbers and words that the measuring groups make of what they received.

A number that could not be measured is NOT_MEASURED. Reports show it as "nothing", and it lies
within no bounds: it agrees only with a fact that allows the word "nothing".
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence

from sitl.conformance.endpoint import ReceivedPacket

NOT_MEASURED = math.nan


def mean(values: Iterable[float]) -> float:
    """Return the mean of what was measured; NOT_MEASURED of no values."""
    measured = list(values)
    if not measured:
        return NOT_MEASURED
    return statistics.fmean(measured)


def first_s(packets: Sequence[ReceivedPacket]) -> float:
    """Return when the first of some packets came; NOT_MEASURED when none did."""
    if not packets:
        return NOT_MEASURED
    return packets[0].at_s


def sent_or_not(received: object) -> str:
    """Return whether something was received, in the words of the facts."""
    return "sent" if received else "not sent"


def yes_or_no(answer: bool) -> str:
    """Return an answer in the words of the facts."""
    return "yes" if answer else "no"


def count_or_none(count: int, unit: str) -> str:
    """Return how many there were of what should not come; "none" when none did."""
    if not count:
        return "none"
    return f"{count} {unit}"
