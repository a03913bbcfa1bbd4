"""Facts about a vehicle on the ground, which the preflight rules check. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from onboard.autopilot import NOTHING_REFUSED, Refused, Version
from onboard.corrections.status import CorrectionsStatus
from onboard.safety.failsafe_table import Condition
from onboard.safety.limits import AUTOPILOT_SILENT_S, POSITION_STALE_S
from onboard.tuples import Xyz

HEARTBEAT_SILENT_S = 3.0  # without a heartbeat for this time, PX4 counts as silent
REFUSED_LATELY_S = 5.0  # a refused packet counts for this time

# Bounds of a mocap sample's delay, from its stamp to its arrival. A delay outside these bounds
# means that two clocks differ.
OLDEST_SAMPLE_S = 0.5
FUTURE_S = 0.005


class RadioMeasured(NamedTuple):
    """The largest delay and the largest loss of the neighbours' states."""

    delay_s: float
    delayed: str  # the vehicle with that delay
    loss_frac: float
    lossy: str  # the vehicle with that loss


@dataclass(frozen=True, slots=True)
class PreflightFacts:
    """Facts about one vehicle at one tick.

    Ages are in seconds and infinite before the first message.
    """

    # the facts without a default are needed for every flight
    autopilot_age_s: float  # age of PX4's newest packet
    heartbeat_age_s: float
    position_age_s: float
    position_enu_m: Xyz
    battery_frac: float  # NaN while PX4 has not published it
    missing_neighbours: tuple[str, ...]  # required vehicles that are not heard on the bus
    lost_neighbours: tuple[str, ...]  # required vehicles that are heard, but know no position
    other_hashes: Mapping[str, str]  # vehicle -> its configuration hash, if that differs
    config_hash: str
    # sentences about wrong parameters of PX4; None until they are read
    param_problems: tuple[str, ...] | None
    is_law_warm: bool  # whether the control pipeline has run once
    is_airborne: bool

    # PX4
    battery_voltage_v: float = math.nan
    px4_version: Version | None = None
    px4_nonsense: str = ""  # sentence about impossible numbers of PX4; empty: there are none
    attitude_hz: float | None = None  # rate of PX4's attitude; None in the first second
    refused: Refused = NOTHING_REFUSED  # refused packets at PX4's endpoint
    refused_age_s: float = math.inf  # age of the newest refused packet
    is_signed: bool = False  # whether PX4 signs its packets
    # whether this computer's clock is behind that of another sender of signed packets
    has_signing_clock_behind: bool = False
    is_armed: bool = False
    has_landed_report: bool = True  # whether PX4's last report of its landed state is recent
    is_failsafe: bool = False
    # sensors that PX4 reports as unhealthy, and whether this flight requires them
    unhealthy: tuple[tuple[str, bool], ...] = ()
    has_rc: bool | None = None  # whether PX4 hears a radio control; None: not known
    px4_position_enu_m: Xyz | None = None  # PX4's own estimate
    fuses_position: bool = False  # whether PX4, by required parameters, uses the mocap's position
    fuses_heading: bool = False  # whether PX4, by required parameters, uses the mocap's heading

    # whether PX4 has a position by a camera whose heading it does not use
    is_camera_turned: bool = False
    # whether poses that came back after a short outage are not believed
    is_contradicted: bool = False
    # distance from the take-off spot at a restart after which its place is not known; 0: it is
    displaced_m: float = 0.0

    # satellites
    fix_type: int | None = None  # fix of PX4's receiver; None: not reported recently
    corrections: CorrectionsStatus | None = None  # None: the vehicle uses no corrections

    # mocap
    # arrival of the newest sample minus its stamp; None without a sample
    sample_delay_s: float | None = None
    sample_age_s: float = math.inf  # time since that arrival
    pose_sources: int = 0  # number of programs that have recently sent poses of our own body
    source_problem: str = ""  # problem of a mocap that this computer reads; empty: none
    heading_miss_rad: float = 0.0  # the mocap's heading minus PX4's
    # angle between the up direction measured by the mocap and the one estimated by PX4, both in
    # body axes
    tilt_miss_rad: float = 0.0
    # whether these two directions differed when the vehicle was last tilted by hand
    differed_when_tilted: bool = False

    # the vehicle
    speed_m_s: float = 0.0  # highest speed of the last second
    has_flown: bool = False  # since this agent started
    may_be_anywhere: bool = False  # it has flown, and its poses have been continuous since
    hover_frac: float = math.nan  # hover throttle learned in flight

    # bus and computers
    # person that the mocap sees -> distance from this vehicle to that person's circle
    people_m: Mapping[str, float] = field(default_factory=dict)
    radio: RadioMeasured | None = None  # None until enough states have arrived
    has_duplicate: bool = False  # whether another agent publishes for this vehicle
    # node -> largest error of its clock; inf: not measured
    clock_bounds_s: Mapping[str, float] = field(default_factory=dict)
    # node whose certificate ends first, and seconds until then; None on a bus without keys
    certificate_left: tuple[str, float] | None = None
    loop_p99_ms: float = 0.0  # 99th percentile of the control loop's period
    has_recorder: bool = False
    has_emulator: bool = False  # whether covey sitl is on the bus

    # law and failsafes
    law: str = "covey"
    # (name, sentence, remedy) of the feasibility findings that refuse a take-off
    law_refusals: tuple[tuple[str, str, str], ...] = ()
    conditions: frozenset[Condition] = frozenset()  # conditions of the failsafe table that hold

    # vehicle on the ground that has not flown yet -> its seen position [m], ENU
    spots_seen_enu_m: Mapping[str, Xyz] = field(default_factory=dict)
    stands_in_for: str = ""  # vehicle that this one replaces in the fleet; empty: none
    position_std_m: float = 0.0  # standard deviation of our own position, per axis

    @property
    def has_autopilot(self) -> bool:
        """Whether PX4 and its heartbeat are heard."""
        is_heard = self.autopilot_age_s < AUTOPILOT_SILENT_S
        return is_heard and self.heartbeat_age_s < HEARTBEAT_SILENT_S

    @property
    def newest_refused(self) -> str:
        """Reason for the newest refused packet; empty if no packet was refused recently."""
        if self.refused_age_s >= REFUSED_LATELY_S:
            return ""
        return self.refused.newest

    @property
    def has_wrong_clock(self) -> bool:
        """Whether mocap samples arrive with stamps that do not fit our clock."""
        delay_s = self.sample_delay_s
        if delay_s is None or self.sample_age_s >= POSITION_STALE_S:
            return False
        return not -FUTURE_S <= delay_s <= OLDEST_SAMPLE_S

    @property
    def has_position(self) -> bool:
        """Whether the position is fresh."""
        return self.position_age_s < POSITION_STALE_S
