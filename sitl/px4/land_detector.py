"""PX4's land detector: from contact, thrust and mode to MAV_LANDED_STATE."""

from __future__ import annotations

from dataclasses import dataclass

from sitl.px4.modes import LandedState, Mode
from sitl.px4.parameters import Parameters
from sitl.px4.signals import AutopilotInputs

# How long contact and low thrust have to last. PX4's own modes push down before they give up,
# setpoints do not.
_PATIENCE_S = 4.3
_LOWEST_THRUST = 0.12
_LOW_SHARE = 0.3

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
    landed_time_s: float = 0.0  # when the last landing was detected
    _contact_time_s: float = 0.0

    def disarmed(self) -> None:
        """Whatever is not armed is taken for landed."""
        self.state = LandedState.ON_GROUND
        self.has_flown = False

    def step(
        self, inputs: AutopilotInputs, mode: Mode, thrust_frac: float, params: Parameters
    ) -> str | None:
        """Look again; the key of what PX4 says when it has changed its mind."""
        now = inputs.time_s
        was_on_ground = self.state is LandedState.ON_GROUND
        if not inputs.on_ground:
            self._contact_time_s = now
            self.state = _IN_MODE.get(mode, LandedState.IN_AIR)
            if was_on_ground:
                self.has_flown = True
                return "takeoff"
            return None
        low_thrust = _LOWEST_THRUST + _LOW_SHARE * (params["MPC_THR_HOVER"] - _LOWEST_THRUST)
        if thrust_frac > low_thrust:
            self._contact_time_s = now
            return None
        patience_s = params.version.landed_offboard_s if mode is Mode.OFFBOARD else _PATIENCE_S
        if was_on_ground or now - self._contact_time_s < patience_s:
            return None
        self.state = LandedState.ON_GROUND
        self.landed_time_s = now
        return "landed"
