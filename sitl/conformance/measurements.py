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

_LOWEST_M = 0.5  # lowest height of a descent that counts
_SINKS_M_S = 0.2  # a vehicle that sinks more slowly stands


def mean(values: Iterable[float]) -> float:
    """Return the mean of measured values; NOT_MEASURED without values."""
    listed = list(values)
    if not listed:
        return NOT_MEASURED
    return statistics.fmean(listed)


def descent_speed_m_s(packets: Sequence[ReceivedPacket], ground_z: float, top_m: float) -> float:
    """Return the mean speed of a descent close to the ground; NOT_MEASURED without a descent.

    PX4's height by satellites drifts, so that a vehicle on the ground may read as high as in the
    descent. It does not sink, and does not count.

    Args:
        packets: LOCAL_POSITION_NED messages since the descent began.
        ground_z: z of the ground at the take-off, down [m].
        top_m: greatest height that counts [m].
    """
    messages = [packet.message for packet in packets]
    return mean(
        message.vz
        for message in messages
        if _LOWEST_M < ground_z - message.z < top_m and message.vz > _SINKS_M_S
    )


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
