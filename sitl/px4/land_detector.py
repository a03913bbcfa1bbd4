"""PX4's land detector: from contact, thrust and mode to MAV_LANDED_STATE."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.px4.modes import LandedState, Mode
from sitl.px4.parameters import Parameters
from sitl.px4.signals import AutopilotInputs

# Time for which contact and low thrust have to last in PX4's own modes. These modes first push the
# vehicle against the ground, and the time includes this. OFFBOARD setpoints do not push, and there
# the time depends on the version.
_CONTACT_S = 4.3
_LOWEST_THRUST = 0.12  # MPC_THR_MIN
_LOW_SHARE = 0.3  # thrust that counts as low, from the lowest (0) to the hover thrust (1)

# State of a vehicle in the air by mode. In other modes it is IN_AIR.
_STATE_IN_AIR: dict[Mode, LandedState] = {
    Mode.TAKEOFF: LandedState.TAKEOFF,
    Mode.LAND: LandedState.LANDING,
    Mode.DESCEND: LandedState.LANDING,
}


@dataclass(slots=True)
class LandDetector:
    """State of the detector."""

    state: LandedState = LandedState.ON_GROUND  # reported state
    has_flown: bool = False  # whether there was a take-off since arming
    takeoff_time_s: float = math.inf  # detection of the first take-off since arming
    landed_time_s: float = 0.0  # detection of the last landing
    _contact_time_s: float = 0.0  # start of the present rest on the ground at low thrust

    def disarmed(self) -> None:
        """Report the vehicle as landed, as PX4 does while it is not armed."""
        self.state = LandedState.ON_GROUND
        self.has_flown = False
        self.takeoff_time_s = math.inf

    def step(
        self, inputs: AutopilotInputs, mode: Mode, thrust_frac: float, params: Parameters
    ) -> str | None:
        """Determine the state; return the key of PX4's text about a change, otherwise None."""
        now_s = inputs.time_s
        was_on_ground = self.state is LandedState.ON_GROUND

        if not inputs.on_ground:
            self._contact_time_s = now_s
            self.state = _STATE_IN_AIR.get(mode, LandedState.IN_AIR)
            if was_on_ground:
                self.has_flown = True
                self.takeoff_time_s = min(self.takeoff_time_s, now_s)
                return "takeoff"
            return None

        low_thrust_frac = _LOWEST_THRUST + _LOW_SHARE * (params["MPC_THR_HOVER"] - _LOWEST_THRUST)
        if thrust_frac > low_thrust_frac:
            self._contact_time_s = now_s
            return None

        required_contact_s = _CONTACT_S
        if mode is Mode.OFFBOARD:
            required_contact_s = params.version.landed_offboard_s
        if was_on_ground or now_s - self._contact_time_s < required_contact_s:
            return None

        self.state = LandedState.ON_GROUND
        self.landed_time_s = now_s
        return "landed"
