"""Values that pass between an emulated autopilot and the rest of the emulator.

`Setpoint` and `AutopilotInputs` are inputs of the autopilot. `Actuation` and `StatusText` are
outputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from msgspec import Struct

from sitl.physics.frames import Array
from sitl.px4.position_control import PositionGoal

# Body rates of a vehicle whose attitude PX4 does not control.
DRIFT_RAD_S = np.array([-0.12, 0.0, 0.0])


class SetpointKind(Enum):
    """Kind of the newest OFFBOARD setpoint."""

    ATTITUDE = "attitude"
    RATE = "rate"
    POSITION = "position"


class Setpoint(Struct, frozen=True):
    """A setpoint for OFFBOARD, as PX4 reads it from its message."""

    kind: SetpointKind
    time_s: float  # time of arrival
    attitude: Array | None = None  # (4,) NED <- FRD
    rate_rad_s: Array | None = None  # (3,) body rates
    thrust_frac: float = 0.0  # collective thrust, in [0, 1]
    goal: PositionGoal | None = None  # goal of a position setpoint
    is_rotation: bool = True  # whether the attitude is a rotation; zeros and NaN are not

    @property
    def needs_position(self) -> bool:
        """Whether PX4 needs a position estimate for the setpoint."""
        return self.kind is SetpointKind.POSITION


class AutopilotInputs(Struct, frozen=True):
    """Inputs of an autopilot at one tick, in its local NED frame."""

    time_s: float  # time of the autopilot's clock
    position_ned_m: Array  # (3,) estimated
    velocity_ned_m_s: Array  # (3,) estimated
    attitude: Array  # (4,) NED <- FRD, with the estimated heading
    yaw_rad: float  # estimated heading
    on_ground: bool
    has_global_position: bool
    has_local_position: bool
    wind_m_s: float = 0.0  # horizontal speed of the air


class Actuation(Struct, frozen=True):
    """Command to the vehicle at one tick."""

    attitude: Array  # (4,) NED <- FRD, with the heading as PX4 estimates it
    rate_rad_s: Array  # (3,) body rates
    is_rate: bool  # whether the rates are flown instead of the attitude
    thrust_frac: float  # collective thrust, in [0, 1]
    motors_on: bool


@dataclass(frozen=True, slots=True)
class StatusText:
    """One STATUSTEXT before it is cut into chunks."""

    time_s: float
    severity: int  # MAV_SEVERITY
    text: str
