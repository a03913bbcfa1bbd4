"""PX4's simulated battery: it empties while armed, down to a floor, and fills while disarmed.

SIM_BAT_DRAIN is the time to empty a full battery. Measurements of PX4's simulator show half of this
time for half a charge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from sitl.px4.parameters import Parameters

FULL_MV = 16200
EMPTY_MV = 14400
_REFILL_S = 4.0  # time to fill an empty battery
_MIN_DRAIN_S = 1e-3  # lower limit of the time in which a whole charge is used


class ChargeState(Enum):
    """Charge of a battery, with the numbers of BATTERY_STATUS.charge_state."""

    OK = 1
    LOW = 2
    CRITICAL = 3
    EMERGENCY = 4


# Parameter of the threshold, and the charge state below it. The lowest threshold comes first.
_THRESHOLDS: tuple[tuple[str, ChargeState], ...] = (
    ("BAT_EMERGEN_THR", ChargeState.EMERGENCY),
    ("BAT_CRIT_THR", ChargeState.CRITICAL),
    ("BAT_LOW_THR", ChargeState.LOW),
)


def charge_state_of(charge_frac: float, params: Parameters) -> ChargeState:
    """Return the charge state of a battery with this charge."""
    for parameter, charge_state in _THRESHOLDS:
        if charge_frac <= params[parameter]:
            return charge_state
    return ChargeState.OK


@dataclass(slots=True)
class Battery:
    """State of charge of one vehicle."""

    remaining_frac: float = 1.0
    full_frac: float = 1.0  # charge to which it fills; less after a cell has failed

    def lose(self, lost_frac: float) -> None:
        """Lose a part of a whole battery for good: this charge, and the room for it."""
        self.remaining_frac = max(0.0, self.remaining_frac - lost_frac)
        self.full_frac = max(0.0, self.full_frac - lost_frac)

    def step(self, dt_s: float, *, is_armed: bool, drain_s: float, floor_pct: float) -> None:
        """Advance by `dt_s`.

        Args:
            dt_s: time since the last step.
            is_armed: whether the vehicle is armed and uses charge; otherwise the battery fills.
            drain_s: time in which a whole charge is used.
            floor_pct: charge at which the battery stops emptying.
        """
        if not is_armed:
            self.remaining_frac = min(self.full_frac, self.remaining_frac + dt_s / _REFILL_S)
            return

        # A charge that is already below the floor does not change.
        floor_frac = min(1.0, max(0.0, floor_pct / 100.0))
        if self.remaining_frac > floor_frac:
            used_frac = dt_s / max(drain_s, _MIN_DRAIN_S)
            self.remaining_frac = max(floor_frac, self.remaining_frac - used_frac)

    def left_s(self, params: Parameters) -> float:
        """Return how long the charge lasts [s]; infinite if PX4 does not know the capacity."""
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
