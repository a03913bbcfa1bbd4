"""The autopilot as the agent uses it: a snapshot of its newest messages, and a few commands.

A command that returns is sent, not executed; later snapshots show the result.
"""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from msgspec import Struct

from onboard.tuples import Wxyz, Xyz
from onboard.types import AttitudeSetpoint


class Landed(Enum):
    """Landed state of EXTENDED_SYS_STATE."""

    UNKNOWN = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKING_OFF = 3
    LANDING = 4


class LinkError(RuntimeError):
    """The link cannot be opened: a sentence that says what failed, where, and what to do."""


Version = tuple[int, int]  # of PX4, as it reports it: major and minor number
# oldest and newest that Covey was measured with
MEASURED_VERSIONS: tuple[Version, Version] = ((1, 16), (1, 18))
SIGNING_SINCE: Version = (1, 18)  # PX4 takes a key for MAVLink from this version on
AUTOPILOT_COMPONENT = 1  # MAVLink's id of the autopilot in a vehicle
_LARGEST_MAJOR = 9
BATTERY_KNOWN_NS = 5_000_000_000  # PX4 sends it twice a second
ACCURACY_KNOWN_NS = 5_000_000_000
FIX_KNOWN_NS = 1_500_000_000  # PX4 tells of it five times a second, as long as a receiver does
STICKS_KNOWN_NS = 1_000_000_000  # PX4 tells of them five times a second, as long as it hears them

# Modes of PX4 in which a pilot's sticks fly. The names are those of onboard/px4/modes.py.
PILOT_MODES = frozenset(
    {"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED", "RATTITUDE", "ALTITUDE_CRUISE"}
)


def plausible_version(version: Version | None) -> Version | None:
    """Return a reported version, or None for one that no PX4 can have."""
    if version is None or not 1 <= version[0] <= _LARGEST_MAJOR:
        return None
    return version


class Refused(Struct, frozen=True):
    """Packets at the autopilot's endpoint that were not let in, by reason."""

    malformed: int = 0  # no MAVLink, or a wrong checksum
    # of other systems and components, for instance a ground station's that PX4 forwards
    others: int = 0
    other_address: int = 0  # under the autopilot's ids, but not from its address
    unsigned: int = 0  # not signed, where this vehicle signs
    forged: int = 0  # signed with another key
    old: int = 0  # signed, but replayed, or by a clock that went back
    newest: str = ""  # reason of the newest one, of others excepted
    source: str = ""  # where it came from, if the transport tells
    newest_ns: int = 0

    @property
    def count(self) -> int:
        """Number of all packets but those of others, which are no trouble."""
        return self.malformed + self.other_address + self.unsigned + self.forged + self.old


NOTHING_REFUSED = Refused()


class Snapshot(Struct, frozen=True):
    """Newest value of every message, with the monotonic time [ns] of its arrival; 0 = never."""

    last_packet_ns: int = 0
    system_id: int = 0
    # PX4's own attitude: its heading may differ from the fleet's
    quaternion_enu_flu_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)
    attitude_ns: int = 0
    position_local_ned_m: Xyz = (0.0, 0.0, 0.0)  # in PX4's own local frame
    velocity_local_ned_m_s: Xyz = (0.0, 0.0, 0.0)
    local_position_ns: int = 0
    # std of PX4's horizontal position; 0 before it tells, inf for nonsense
    position_accuracy_m: float = 0.0
    height_accuracy_m: float = 0.0  # std of PX4's height; 0 before it tells, inf for nonsense
    position_accuracy_ns: int = 0  # of both
    has_fix: bool = False  # of satellites, three-dimensional
    fix_ns: int = 0
    fix_type: int = 0  # of the receiver: MAVLink's GPS_FIX_TYPE
    satellites: int = -1  # that the receiver uses; -1: not told
    fix_accuracy_m: float = 0.0  # std of the receiver's horizontal position; 0: not told
    # of PX4's local frame: latitude [deg], longitude [deg], altitude [m]
    global_origin: Xyz | None = None
    px4_version: Version | None = None
    is_simulated: bool = False  # by PX4's own identity
    px4_boot_ms: int = 0  # PX4's clock, which shows whether it stands still
    heartbeat_ns: int = 0
    is_armed: bool = False
    mode: str = ""
    is_failsafe: bool = False
    sticks_ns: int = 0  # PX4 repeats the positions of a pilot's sticks while it hears them
    sticks_before_ns: int = 0  # the message of that kind before the newest one
    landed: Landed = Landed.UNKNOWN
    landed_ns: int = 0
    battery_frac: float = float("nan")
    battery_voltage_v: float = float("nan")
    battery_ns: int = 0
    status_text: str = ""
    status_text_ns: int = 0
    sensors_enabled: int = 0  # bits of SYS_STATUS
    sensors_healthy: int = 0
    sensors_ns: int = 0
    refused: Refused = NOTHING_REFUSED
    is_signed: bool = False  # PX4 signs what it sends: it has a key
    has_wrong_clock: bool = False  # this computer's is a minute behind another one that signs

    def battery(self, now_ns: int) -> tuple[float, float]:
        """Return charge [0 to 1] and voltage [V]; NaN once PX4's report is 5 s old."""
        if self.battery_ns and now_ns - self.battery_ns > BATTERY_KNOWN_NS:
            return float("nan"), float("nan")
        return self.battery_frac, self.battery_voltage_v

    def accuracy_m(self, now_ns: int) -> float:
        """Return PX4's accuracy; 0 before the first report, and once that is 5 s old."""
        if now_ns - self.position_accuracy_ns > ACCURACY_KNOWN_NS:
            return 0.0
        return self.position_accuracy_m

    def sees_satellites(self, now_ns: int) -> bool:
        """Return whether PX4 has reported a fix lately."""
        return self.has_fix and now_ns - self.fix_ns <= FIX_KNOWN_NS

    def hears_sticks(self, now_ns: int) -> bool:
        """Return whether PX4 hears a pilot's sticks, of a radio control or of a joystick.

        One message alone is none: PX4 sends one when the stream begins, also without sticks.
        """
        is_recent = now_ns - self.sticks_ns < STICKS_KNOWN_NS
        is_repeated = self.sticks_ns - self.sticks_before_ns < STICKS_KNOWN_NS
        return self.sticks_before_ns > 0 and is_recent and is_repeated

    def is_flown_by_hand(self, now_ns: int) -> bool:
        """Return whether a pilot flies: an armed PX4 in a pilot's mode that hears his sticks."""
        return self.is_armed and self.mode in PILOT_MODES and self.hears_sticks(now_ns)

    @property
    def is_offboard(self) -> bool:
        """Whether the last heartbeat said OFFBOARD."""
        return self.mode == "OFFBOARD"


class Autopilot(Protocol):
    """One connected autopilot.

    No method blocks for longer than it takes to hand bytes to a socket.
    """

    def snapshot(self) -> Snapshot:
        """Return the newest values; safe from any thread."""

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        """Send one setpoint, in PX4's heading; it is not repeated by itself."""

    def set_offboard(self) -> None:
        """Command OFFBOARD."""

    def land(self) -> None:
        """Command PX4's own landing."""

    def arm(self) -> None:
        """Command to arm."""

    def disarm(self) -> None:
        """Command to disarm; PX4 refuses in the air."""

    def kill(self) -> None:
        """Stop the motors now, wherever the vehicle is."""

    def request_heartbeat(self) -> None:
        """Ask for a heartbeat now; one comes every second by itself."""

    def reboot(self) -> None:
        """Command to start anew; PX4 refuses while it is armed."""

    def play_tune(self) -> None:
        """Play a tune; PX4 does not acknowledge it."""

    def send_corrections(self, flags: int, data: bytes) -> None:
        """Give PX4's satellite receiver a fragment of an RTCM frame."""

    def send_odometry(
        self,
        position_enu_m: Xyz,
        quaternion_enu_flu_wxyz: Wxyz,
        std_m: float,
        reset_count: int = 0,
    ) -> None:
        """Send a mocap pose to PX4's estimator, for its own hold and land.

        A new count lets the estimator begin anew at this pose.
        """
