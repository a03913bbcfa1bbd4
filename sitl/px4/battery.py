"""PX4's simulated battery: it empties while armed, down to a floor, and fills when disarmed.

SIM_BAT_DRAIN is the time in which a whole charge is used up; PX4's simulator was measured to take
half of it for half a charge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from sitl.px4.parameters import Parameters

FULL_MV = 16200
EMPTY_MV = 14400
_REFILL_S = 4.0  # for a whole charge


class ChargeState(Enum):
    """Charge of a battery, with the numbers of BATTERY_STATUS.charge_state."""

    OK = 1
    LOW = 2
    CRITICAL = 3
    EMERGENCY = 4


# From the emptiest: parameter of the threshold, and the state below it.
_THRESHOLDS: tuple[tuple[str, ChargeState], ...] = (
    ("BAT_EMERGEN_THR", ChargeState.EMERGENCY),
    ("BAT_CRIT_THR", ChargeState.CRITICAL),
    ("BAT_LOW_THR", ChargeState.LOW),
)


def charge_state_of(charge_frac: float, params: Parameters) -> ChargeState:
    """Return how empty a battery with this charge is."""
    for parameter, charge_state in _THRESHOLDS:
        if charge_frac <= params[parameter]:
            return charge_state
    return ChargeState.OK


@dataclass(slots=True)
class Battery:
    """State of charge of one vehicle."""

    remaining_frac: float = 1.0

    def step(self, dt_s: float, *, is_armed: bool, drain_s: float, floor_pct: float) -> None:
        """Advance by `dt_s`.

        Args:
            dt_s: time since the last step.
            is_armed: an armed vehicle uses its charge, a disarmed one gets it back.
            drain_s: time in which a whole charge is used.
            floor_pct: below which the charge does not fall.
        """
        if not is_armed:
            self.remaining_frac = min(1.0, self.remaining_frac + dt_s / _REFILL_S)
            return

        # A charge that is below the floor already stays where it is.
        floor_frac = min(1.0, max(0.0, floor_pct / 100.0))
        if self.remaining_frac > floor_frac:
            used_frac = dt_s / max(drain_s, 1e-3)
            self.remaining_frac = max(floor_frac, self.remaining_frac - used_frac)

    def left_s(self, params: Parameters) -> float:
        """Return how long the charge lasts [s]; infinite where PX4 cannot know its capacity."""
        if params["BAT1_CAPACITY"] <= 0.0:
            return math.inf
        return self.remaining_frac * params["SIM_BAT_DRAIN"]

    @property
    def voltage_mv(self) -> int:
        """Voltage of the whole pack [mV], linear in the charge."""
        return round(EMPTY_MV + (FULL_MV - EMPTY_MV) * self.remaining_frac)

    @property
    def remaining_pct(self) -> int:
        """Charge in whole percent."""
        return round(100.0 * self.remaining_frac)
