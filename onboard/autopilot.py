"""The autopilot as the agent sees it: a snapshot of what it said last, and the few things one can ask of it.

Nothing that is asked here counts as done because the call returned: what came of it is read from later snapshots.
"""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from msgspec import Struct

from onboard.types import AttitudeSetpoint

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]


class Landed(Enum):
    """What EXTENDED_SYS_STATE says."""

    UNKNOWN = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKING_OFF = 3
    LANDING = 4


class LinkError(RuntimeError):
    """The link cannot be opened: a sentence that says where and what to do."""


class Snapshot(Struct, frozen=True):
    """The newest value of everything, with the monotonic time [ns] at which it arrived; 0 = never.

    quaternion_enu_flu_wxyz: PX4's own attitude, so its heading may differ from the fleet's. position_local_ned_m and
    velocity_local_ned_m_s are in PX4's own local frame; global_origin is where that lies: latitude and longitude in
    degrees, altitude in metres; position_accuracy_m is what PX4 holds for the horizontal error of its own position, one
    standard deviation, 0 before it says so. px4_boot_ms: PX4's clock, to see it stand still. sensors_enabled,
    sensors_healthy: bits of SYS_STATUS.
    """

    last_packet_ns: int = 0
    system_id: int = 0
    quaternion_enu_flu_wxyz: Vec4 = (1.0, 0.0, 0.0, 0.0)
    attitude_ns: int = 0
    position_local_ned_m: Vec3 = (0.0, 0.0, 0.0)
    velocity_local_ned_m_s: Vec3 = (0.0, 0.0, 0.0)
    local_position_ns: int = 0
    position_accuracy_m: float = 0.0
    global_origin: Vec3 | None = None
    px4_boot_ms: int = 0
    heartbeat_ns: int = 0
    is_armed: bool = False
    mode: str = ""
    is_failsafe: bool = False
    landed: Landed = Landed.UNKNOWN
    landed_ns: int = 0
    battery_frac: float = float("nan")
    battery_voltage_v: float = float("nan")
    status_text: str = ""
    status_text_ns: int = 0
    sensors_enabled: int = 0
    sensors_healthy: int = 0
    sensors_ns: int = 0

    @property
    def is_offboard(self) -> bool:
        """Whether the last heartbeat said OFFBOARD."""
        return self.mode == "OFFBOARD"


class Autopilot(Protocol):
    """One connected autopilot. No method blocks for longer than it takes to hand bytes to a socket."""

    def snapshot(self) -> Snapshot:
        """The newest values; safe from any thread."""

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        """One setpoint on the wire, in PX4's heading; nothing is ever repeated by itself."""

    def set_offboard(self) -> None:
        """Ask for OFFBOARD."""

    def land(self) -> None:
        """Ask for PX4's own landing."""

    def arm(self) -> None:
        """Ask to arm."""

    def disarm(self) -> None:
        """Ask to disarm; PX4 refuses in the air."""

    def kill(self) -> None:
        """Stop the motors now, wherever the vehicle is."""

    def play_tune(self) -> None:
        """Let it play a tune; PX4 does not say whether it did."""

    def send_odometry(
        self, position_enu_m: Vec3, quaternion_enu_flu_wxyz: Vec4, std_m: float, reset_count: int = 0
    ) -> None:
        """Hand a mocap pose to PX4's estimator, so that its own hold and land work; another count: begin anew there."""
