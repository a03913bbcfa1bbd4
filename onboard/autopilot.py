"""The autopilot as the agent uses it: a snapshot of its newest messages, and a few commands.

When a command's method returns, the command is sent but not yet executed. Later snapshots show the
result. ``onboard/px4/mavsdk_link.py`` implements the interface for PX4.
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
    """The link cannot be opened. The message says what failed, where, and what to do."""


class EndpointAbsentError(LinkError):
    """The device or the address of the link is not there, or not for this user; it may come."""


Version = tuple[int, int]  # major and minor number of PX4, as PX4 reports them
# oldest and newest version that Covey was measured with
MEASURED_VERSIONS: tuple[Version, Version] = ((1, 16), (1, 18))
SIGNING_SINCE: Version = (1, 18)  # first version of PX4 that supports MAVLink signing
AUTOPILOT_COMPONENT = 1  # MAVLink's component id of an autopilot
_LARGEST_MAJOR = 9  # a larger major number is not plausible

# reports of PX4 older than this are not used
BATTERY_KNOWN_NS = 5_000_000_000  # PX4 reports the battery twice a second
ACCURACY_KNOWN_NS = 5_000_000_000
FIX_KNOWN_NS = 1_500_000_000  # PX4 reports the fix five times a second while a receiver works
# PX4 reports the sticks five times a second while it receives them
STICKS_KNOWN_NS = 1_000_000_000

# Modes of PX4 in which a pilot flies with sticks. The names are those of onboard/px4/modes.py.
PILOT_MODES = frozenset(
    {"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED", "RATTITUDE", "ALTITUDE_CRUISE"}
)


def plausible_version(version: Version | None) -> Version | None:
    """Return a reported version, or None if no PX4 can have that version."""
    if version is None:
        return None
    major, _ = version
    return version if 1 <= major <= _LARGEST_MAJOR else None


class Refused(Struct, frozen=True):
    """Numbers of the packets at the autopilot's endpoint that were refused, by reason."""

    malformed: int = 0  # not MAVLink, or a wrong checksum
    # from other systems and components, for instance a ground station's packets that PX4 forwards
    others: int = 0
    other_address: int = 0  # with the autopilot's ids, but not from its address
    unsigned: int = 0  # not signed, although this vehicle's packets must be signed
    forged: int = 0  # signed with another key
    old: int = 0  # signed, but replayed, or stamped by a clock that was set back

    # the newest refused packet, except those counted as ``others``
    newest: str = ""  # why it was refused
    source: str = ""  # its sender's address, if the transport knows it
    newest_ns: int = 0  # time of its arrival

    @property
    def count(self) -> int:
        """Number of refused packets, except those from other systems, which are harmless."""
        return self.malformed + self.other_address + self.unsigned + self.forged + self.old


NOTHING_REFUSED = Refused()


class Snapshot(Struct, frozen=True):
    """Newest value of every message, with the monotonic time [ns] of its arrival; 0: never."""

    last_packet_ns: int = 0
    system_id: int = 0
    # PX4's own attitude: its heading may differ from the fleet's
    quaternion_enu_flu_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)
    attitude_ns: int = 0
    position_local_ned_m: Xyz = (0.0, 0.0, 0.0)  # in PX4's own local frame
    velocity_local_ned_m_s: Xyz = (0.0, 0.0, 0.0)
    local_position_ns: int = 0
    # Whether PX4's estimator has a horizontal position, and a source that corrects it. PX4 also
    # sends a local position without any: on the ground, and for seconds after its source was lost.
    is_position_known: bool = True
    # squared difference of the horizontal position's source from PX4's position, as a share of the
    # largest that PX4 fuses; NaN while PX4 fuses none
    position_ratio: float = 0.0
    # difference of the heading's source from PX4's heading, as a share of the largest that PX4
    # fuses; NaN while nothing corrects the heading
    heading_ratio: float = 0.0
    # std of PX4's horizontal position; 0 before the first report, inf if PX4 reports nonsense
    position_accuracy_m: float = 0.0
    # std of PX4's height; 0 before the first report, inf if PX4 reports nonsense
    height_accuracy_m: float = 0.0
    position_accuracy_ns: int = 0  # time of both accuracies
    has_fix: bool = False  # whether the satellite receiver has a three-dimensional fix
    fix_ns: int = 0
    fix_type: int = 0  # MAVLink's GPS_FIX_TYPE of the receiver
    satellites: int = -1  # number of satellites that the receiver uses; -1: not reported
    fix_accuracy_m: float = 0.0  # std of the receiver's horizontal position; 0: not reported
    # origin of PX4's local frame: latitude [deg], longitude [deg], altitude [m]
    global_origin: Xyz | None = None
    px4_version: Version | None = None
    is_simulated: bool = False  # whether PX4's own identity says that it is a simulation
    px4_boot_ms: int = 0  # PX4's clock, which stands still if PX4 hangs
    restarts: int = 0  # how often PX4's clock has restarted
    returns: int = 0  # how often PX4's messages came back after a silence
    heartbeat_ns: int = 0
    is_armed: bool = False
    mode: str = ""
    is_failsafe: bool = False
    sticks_ns: int = 0  # arrival of the newest message with the positions of a pilot's sticks
    sticks_before_ns: int = 0  # arrival of the previous message with these positions
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
    is_signed: bool = False  # whether PX4 signs its packets
    # whether this computer's clock is a minute behind the clock of another sender of signed packets
    has_wrong_clock: bool = False

    def battery(self, now_ns: int) -> tuple[float, float]:
        """Return charge [0 to 1] and voltage [V]; NaN once PX4's report is 5 s old."""
        if self.battery_ns and now_ns - self.battery_ns > BATTERY_KNOWN_NS:
            return float("nan"), float("nan")
        return self.battery_frac, self.battery_voltage_v

    def accuracy_m(self, now_ns: int) -> float:
        """Return the accuracy of PX4's position; 0 if PX4 has not reported it for 5 s."""
        if now_ns - self.position_accuracy_ns > ACCURACY_KNOWN_NS:
            return 0.0
        return self.position_accuracy_m

    def sees_satellites(self, now_ns: int) -> bool:
        """Return whether PX4 has reported a fix within the last 1.5 s."""
        return self.has_fix and now_ns - self.fix_ns <= FIX_KNOWN_NS

    def hears_sticks(self, now_ns: int) -> bool:
        """Return whether PX4 receives a pilot's sticks, from a radio control or from a joystick.

        Two messages in a row are needed: when the stream begins, PX4 sends one message even without
        sticks. While PX4 is silent, its last word counts.
        """
        heard_ns = now_ns
        if self.last_packet_ns >= self.sticks_ns:
            heard_ns = min(now_ns, self.last_packet_ns)
        is_recent = heard_ns - self.sticks_ns < STICKS_KNOWN_NS
        is_repeated = self.sticks_ns - self.sticks_before_ns < STICKS_KNOWN_NS
        return self.sticks_before_ns > 0 and is_recent and is_repeated

    def is_flown_by_hand(self, now_ns: int) -> bool:
        """Return whether a pilot flies: PX4 is armed, in a pilot's mode, and receives sticks."""
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
        """Send one setpoint, in PX4's heading. The link does not repeat it."""

    def set_offboard(self) -> None:
        """Command PX4 to switch to OFFBOARD."""

    def land(self) -> None:
        """Command PX4 to land by itself."""

    def arm(self) -> None:
        """Command PX4 to arm."""

    def disarm(self) -> None:
        """Command PX4 to disarm; it refuses in the air."""

    def kill(self) -> None:
        """Stop the motors now, wherever the vehicle is."""

    def request_heartbeat(self) -> None:
        """Ask for a heartbeat now; PX4 sends a heartbeat every second anyway."""

    def reboot(self) -> None:
        """Command PX4 to reboot; it refuses while it is armed."""

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
        """Send a mocap pose to PX4's estimator, for PX4's own hold and land modes.

        A changed ``reset_count`` makes the estimator restart at this pose.
        """
