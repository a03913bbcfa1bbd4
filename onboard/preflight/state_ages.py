"""Measures delay and loss of the neighbours' states on the ground, from the states' ages."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from onboard.preflight.preflight_facts import RadioMeasured

# number of samples kept for each neighbour; there are eleven a second
_SAMPLES = 120
_MIN_SAMPLES = 60  # delay and loss are known from this number of samples on
_MISSING_S = 1.0  # a neighbour that is silent for longer is missing and does not count here
# if an age exceeds the delay by this many periods, a state was lost or is late
_LATE_PERIODS = 0.99


class StateAges:
    """Ages of the newest state of each neighbour, sampled while the vehicle stands."""

    def __init__(self, period_s: float) -> None:
        """Start without samples. ``period_s`` is the time between two states of a neighbour."""
        self._period_s = period_s
        self._ages_s: dict[str, deque[float]] = {}

    def update(self, ages_s: Mapping[str, float]) -> None:
        """Take a sample of the ages of the followed neighbours."""
        self._ages_s = {name: self._ages_s.get(name, deque(maxlen=_SAMPLES)) for name in ages_s}
        for name, age_s in ages_s.items():
            if age_s < _MISSING_S:
                self._ages_s[name].append(age_s)

    @property
    def measured(self) -> RadioMeasured | None:
        """The largest delay and loss of all neighbours; None until there are enough samples.

        The smallest age of a neighbour is its delay. If a sample's age exceeds the delay by a
        period, a state was lost or is late.
        """
        delays_s: dict[str, float] = {}
        losses: dict[str, float] = {}
        for name, ages_s in self._ages_s.items():
            if len(ages_s) < _MIN_SAMPLES:
                continue
            delay_s = min(ages_s)
            late_age_s = delay_s + _LATE_PERIODS * self._period_s
            late_count = sum(1 for age_s in ages_s if age_s > late_age_s)
            delays_s[name] = delay_s
            losses[name] = late_count / len(ages_s)

        if not delays_s:
            return None
        delayed = max(delays_s, key=delays_s.__getitem__)
        lossy = max(losses, key=losses.__getitem__)
        return RadioMeasured(
            delay_s=delays_s[delayed], delayed=delayed, loss_frac=losses[lossy], lossy=lossy
        )
