"""Commands of the agent's core. Its shell executes them in the order in which they are returned.

The core computes without I/O, and the shell does all I/O. Some commands go to PX4, some go to the
bus, and one ends the process. Executing a command only means sending it. The core learns its effect
from later inputs (``agent_inputs.py``).
"""

from __future__ import annotations

from msgspec import Struct

from onboard.bus.schema import Message, OrderReply
from onboard.bus.topics import Topic
from onboard.tuples import Wxyz, Xyz
from onboard.types import AttitudeSetpoint

# -- to PX4 ----------------------------------------------------------------------------------------


class SendAttitude(Struct, frozen=True):
    """Send one setpoint."""

    setpoint: AttitudeSetpoint  # already converted to PX4's heading


class SetOffboard(Struct, frozen=True):
    """Ask PX4 for OFFBOARD."""


class Px4Land(Struct, frozen=True):
    """Ask PX4 to land by itself."""


class Arm(Struct, frozen=True):
    """Ask PX4 to arm."""


class Disarm(Struct, frozen=True):
    """Ask PX4 to disarm; it refuses in the air."""


class Kill(Struct, frozen=True):
    """Stop the motors now."""


class RequestHeartbeat(Struct, frozen=True):
    """Ask PX4 for a heartbeat now, to confirm a doubtful report or to learn the mode."""


class RebootPx4(Struct, frozen=True):
    """Ask PX4 to reboot; it refuses while it is armed."""


class PlayTune(Struct, frozen=True):
    """Let PX4 play a tune, so that people hear which vehicle it is."""


class SendCorrections(Struct, frozen=True):
    """Give PX4's satellite receiver a fragment of an RTCM frame."""

    flags: int  # MAVLink's flags of GPS_RTCM_DATA
    data: bytes


class SendOdometry(Struct, frozen=True):
    """Forward a mocap pose to PX4's estimator."""

    position_enu_m: Xyz
    quaternion_enu_flu_wxyz: Wxyz
    std_m: float
    reset_count: int = 0  # a changed count makes the estimator restart at this pose


# -- to the bus ------------------------------------------------------------------------------------


class WatchBodies(Struct, frozen=True):
    """Receive the mocap poses of exactly these other bodies from now on."""

    bodies: tuple[str, ...]


class Publish(Struct, frozen=True):
    """Put a message on the bus under this vehicle's name."""

    topic: Topic
    message: Message


class Follow(Struct, frozen=True):
    """Receive the states of exactly these vehicles at full rate, and of all others slowly."""

    names: frozenset[str]


class Reply(Struct, frozen=True):
    """Answer an order."""

    reply: OrderReply


# -- to the process --------------------------------------------------------------------------------


class Exit(Struct, frozen=True):
    """End the process, because the shutdown was requested and the vehicle is on the ground."""


Command = (
    SendAttitude
    | SetOffboard
    | Px4Land
    | Arm
    | Disarm
    | Kill
    | RequestHeartbeat
    | RebootPx4
    | PlayTune
    | SendCorrections
    | SendOdometry
    | WatchBodies
    | Publish
    | Follow
    | Reply
    | Exit
)
