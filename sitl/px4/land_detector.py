"""PX4's land detector: from contact, thrust and mode to MAV_LANDED_STATE."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.px4.modes import LandedState, Mode
from sitl.px4.parameters import Parameters
from sitl.px4.signals import AutopilotInputs

# How long contact and low thrust have to last in PX4's own modes, which push down before they give
# up. Setpoints do not: for OFFBOARD the version says how long.
_PATIENCE_S = 4.3
_LOWEST_THRUST = 0.12  # MPC_THR_MIN
_LOW_SHARE = 0.3  # of the range between the lowest thrust and the hover thrust

# What a vehicle in the air is said to be doing, by mode; everything else is just in the air.
_IN_MODE: dict[Mode, LandedState] = {
    Mode.TAKEOFF: LandedState.TAKEOFF,
    Mode.LAND: LandedState.LANDING,
    Mode.DESCEND: LandedState.LANDING,
}


@dataclass(slots=True)
class LandDetector:
    """Memory of the detector."""

    state: LandedState = LandedState.ON_GROUND  # what is reported
    has_flown: bool = False  # whether there was a take-off since arming
    takeoff_time_s: float = math.inf  # when the first take-off since arming was detected
    landed_time_s: float = 0.0  # when the last landing was detected
    _contact_time_s: float = 0.0  # since when it has rested on the ground at low thrust

    def disarmed(self) -> None:
        """Take the vehicle for landed, as PX4 does with whatever is not armed."""
        self.state = LandedState.ON_GROUND
        self.has_flown = False
        self.takeoff_time_s = math.inf

    def step(
        self, inputs: AutopilotInputs, mode: Mode, thrust_frac: float, params: Parameters
    ) -> str | None:
        """Look again; the key of what PX4 says when the answer has changed, otherwise None."""
        now_s = inputs.time_s
        was_on_ground = self.state is LandedState.ON_GROUND

        if not inputs.on_ground:
            self._contact_time_s = now_s
            self.state = _IN_MODE.get(mode, LandedState.IN_AIR)
            if was_on_ground:
                self.has_flown = True
                self.takeoff_time_s = min(self.takeoff_time_s, now_s)
                return "takeoff"
            return None

        low_thrust_frac = _LOWEST_THRUST + _LOW_SHARE * (params["MPC_THR_HOVER"] - _LOWEST_THRUST)
        if thrust_frac > low_thrust_frac:
            self._contact_time_s = now_s
            return None

        patience_s = _PATIENCE_S
        if mode is Mode.OFFBOARD:
            patience_s = params.version.landed_offboard_s
        if was_on_ground or now_s - self._contact_time_s < patience_s:
            return None

        self.state = LandedState.ON_GROUND
        self.landed_time_s = now_s
        return "landed"
