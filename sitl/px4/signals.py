"""Values that flow between an emulated autopilot and the rest of the emulator, one direction each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from msgspec import Struct

from sitl.physics.frames import Array
from sitl.px4.position_control import PositionGoal

# body rates of a vehicle whose attitude PX4 does not control
DRIFT_RAD_S = np.array([-0.12, 0.0, 0.0])


class SetpointKind(Enum):
    """Kind of the newest OFFBOARD setpoint."""

    ATTITUDE = "attitude"
    RATE = "rate"
    POSITION = "position"


class Setpoint(Struct, frozen=True):
    """Newest OFFBOARD setpoint, already reduced to what PX4 makes of it.

    Attributes:
        kind, time_s: what it asks for, and when it came.
        attitude: (4,) NED <- FRD. rate_rad_s: (3,) body rates. thrust_frac: collective, in [0, 1].
        goal: where to fly, for positions and velocities.
        is_rotation: whether its attitude is one; zeros and NaN are none.
        needs_position: whether PX4 needs a position estimate for it.
    """

    kind: SetpointKind
    time_s: float
    attitude: Array | None = None
    rate_rad_s: Array | None = None
    thrust_frac: float = 0.0
    goal: PositionGoal | None = None
    is_rotation: bool = True

    @property
    def needs_position(self) -> bool:
        """Whether PX4 needs a position estimate for it."""
        return self.kind is SetpointKind.POSITION


class AutopilotInputs(Struct, frozen=True):
    """Knowledge of the autopilot about its vehicle at one tick, in its own local NED frame."""

    time_s: float
    position_ned_m: Array
    velocity_ned_m_s: Array
    attitude: Array
    yaw_rad: float
    on_ground: bool
    has_global_position: bool
    has_local_position: bool


class Actuation(Struct, frozen=True):
    """Command to the vehicle at this tick; attitude in the frame that the autopilot believes in."""

    attitude: Array
    rate_rad_s: Array
    is_rate: bool
    thrust_frac: float
    motors_on: bool


@dataclass(frozen=True, slots=True)
class StatusText:
    """One STATUSTEXT before it is cut into chunks."""

    time_s: float
    severity: int
    text: str
