"""``[radio]`` of a fleet file: the radio channel that all nodes share.

``covey check`` and flights in lockstep use it. The agents use its expected delay and loss.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import msgspec

from onboard.config.toml_reading import bound_problems

_STATES_S = 0.02  # period of the states for the lateness; a lower states_hz does not change it
_RARE_LOSS = 0.01  # a series of lost messages with a smaller probability is ignored
_USUAL_AGE_S = 0.08  # age of a state with the defaults; neighbours then count as silent at 0.25 s
_MAX_LATENESS_S = 0.45  # most that is added to the age at which a neighbour counts as silent

BOUNDS: dict[str, tuple[float, float]] = {
    "rate_mbit_s": (6.0, 1000.0),
    "usable_frac": (0.05, 1.0),
    "loss_frac": (0.0, 0.9),
    "burst_packets": (1.0, 100.0),
    "jitter_s": (0.0, 1.0),
    "duplicate_frac": (0.0, 0.5),
    "reorder_frac": (0.0, 0.5),
    "expected_delay_s": (0.0, 2.0),
    "expected_loss_frac": (0.0, 0.9),
}


class RadioConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[radio]``: docs/network.md explains each key."""

    # "access point": a message from one vehicle to another is sent twice; "direct": once, as in an
    # ad-hoc network
    link: Literal["access point", "direct"] = "access point"
    # data rate of the slowest vehicle: 65 is 802.11n, 20 MHz, one antenna
    rate_mbit_s: float = 65.0
    # rate of each vehicle's states to its near neighbours; use 25 if the channel is full
    states_hz: Literal[50, 25] = 50
    # share of the channel's time that the fleet may use; covey check warns beyond it
    usable_frac: float = 0.6
    # share of the packets that are lost despite the radio's retries; this key and the four below
    # are for lockstep only
    loss_frac: float = 0.001
    # mean number of 50 Hz packets lost in a row; 1: losses are independent
    burst_packets: float = 3.0
    jitter_s: float = 0.0  # mean of a further delay, exponentially distributed
    duplicate_frac: float = 0.0  # share of the packets that arrive twice
    reorder_frac: float = 0.0  # share of the packets that are overtaken
    # delay from one agent to another; covey check looks it up in the map of the law, and preflight
    # measures it on the ground
    expected_delay_s: float = 0.04
    # share of the states between two agents that are lost; used like expected_delay_s
    expected_loss_frac: float = 0.10

    def state_age_s(self, period_s: float) -> float:
        """Return the age that a neighbour's newest state reaches.

        The age is the delay, plus one period for each state that may be lost in a row.

        Args:
            period_s: time between two states.
        Returns:
            The age [s] that is exceeded in one case of a hundred.
        """
        loss = self.expected_loss_frac
        periods = 1.0
        if loss > 0.0:  # the number of periods with loss**periods = _RARE_LOSS
            periods = math.log(_RARE_LOSS) / math.log(loss)
        # 1e-9 keeps a rounding error from adding a period to a whole number
        return self.expected_delay_s + period_s * max(1, math.ceil(periods - 1e-9))

    @property
    def lateness_s(self) -> float:
        """Time [s] that is added to the age at which a neighbour counts as silent; 0 with the
        defaults.
        """
        older_s = self.state_age_s(_STATES_S) - _USUAL_AGE_S
        return min(max(older_s, 0.0), _MAX_LATENESS_S)


def problems(radio: RadioConfig | None) -> Iterator[str]:
    """Check the table.

    Args:
        radio: the table; None where the file has none.
    Yields:
        a sentence for each mistake.
    """
    if radio is None:
        return
    for key, (low, high) in BOUNDS.items():
        yield from bound_problems(f"radio.{key}", getattr(radio, key), low, high)
