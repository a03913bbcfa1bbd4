"""``[radio]`` of a fleet file: the one channel that all share, for ``covey check`` and for flights in lockstep."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import msgspec

from onboard.config.toml_reading import bound_problems

BOUNDS: dict[str, tuple[float, float]] = {
    "rate_mbit_s": (6.0, 1000.0),
    "usable_frac": (0.05, 1.0),
    "loss_frac": (0.0, 0.9),
    "burst_packets": (1.0, 100.0),
    "jitter_s": (0.0, 1.0),
    "duplicate_frac": (0.0, 0.5),
    "reorder_frac": (0.0, 0.5),
}


class RadioConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[radio]``: docs/radio.md explains each key."""

    # "access point": what goes from one vehicle to another is sent twice; "direct": once, as in an ad-hoc network
    link: Literal["access point", "direct"] = "access point"
    rate_mbit_s: float = 65.0  # of a frame's data, as the slowest vehicle gets it: 65 is 802.11n, 20 MHz, one antenna
    states_hz: Literal[50, 25] = 50  # states of each vehicle to its near neighbours; 25 where the channel is full
    usable_frac: float = 0.6  # of the channel's time that the fleet may take; covey check warns beyond it
    loss_frac: float = 0.001  # of the packets, after the radio's own repetitions; lockstep only, as all that follow
    burst_packets: float = 3.0  # mean number of packets of 50 Hz lost in a row; 1: each loss by itself
    jitter_s: float = 0.0  # mean of a further delay, exponentially distributed
    duplicate_frac: float = 0.0  # of the packets that arrive twice
    reorder_frac: float = 0.0  # of the packets that others overtake


def problems(radio: RadioConfig | None) -> Iterator[str]:
    """Check the table.

    Args:
        radio: the table; None where the file has none.
    Yields:
        a sentence for each mistake.
    """
    for key, (low, high) in BOUNDS.items() if radio is not None else ():
        yield from bound_problems(f"radio.{key}", getattr(radio, key), low, high)
