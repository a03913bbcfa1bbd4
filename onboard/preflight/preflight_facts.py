"""Facts about a vehicle on the ground that the rules of preflight judge. Pure."""

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

HEARTBEAT_SILENT_S = 3.0
REFUSED_LATELY_S = 5.0

# delay of a mocap sample, from its stamp to its arrival, that one clock explains
OLDEST_SAMPLE_S = 0.5
FUTURE_S = 0.005


class RadioMeasured(NamedTuple):
    """Delay and loss of the neighbours' states, of the worst one each."""

    delay_s: float
    delayed: str  # the vehicle with that delay
    loss_frac: float
    lossy: str  # the vehicle with that loss


@dataclass(frozen=True, slots=True)
class PreflightFacts:
    """Facts about one vehicle at one tick.

    Ages are in seconds and infinite before the first message.
    """

    # without a default: what no flight begins without
    autopilot_age_s: float  # of PX4's newest packet
    heartbeat_age_s: float
    position_age_s: float
    position_enu_m: Xyz
    battery_frac: float  # NaN while PX4 has not published it
    missing_neighbours: tuple[str, ...]  # not heard on the bus
    other_hashes: Mapping[str, str]  # vehicle -> its configuration hash, where it differs
    config_hash: str
    # sentences; None while PX4's parameters are not read yet
    param_problems: tuple[str, ...] | None
    is_law_warm: bool  # the control pipeline has run once
    is_airborne: bool

    # PX4
    battery_voltage_v: float = math.nan
    px4_version: Version | None = None
    px4_nonsense: str = ""  # what is wrong with its newest numbers, as a sentence
    attitude_hz: float | None = None  # arrival rate of its attitude; None in the first second
    refused: Refused = NOTHING_REFUSED  # packets at its endpoint that were not let in
    refused_age_s: float = math.inf  # since the newest of them
    is_signed: bool = False  # it signs what it sends
    # this computer's clock is behind that of another one that signs
    has_signing_clock_behind: bool = False
    is_armed: bool = False
    is_landed_told: bool = True  # it has reported lately whether it is on the ground
    is_failsafe: bool = False
    # sensors that it calls unhealthy, and whether this flight needs them
    unhealthy: tuple[tuple[str, bool], ...] = ()
    has_rc: bool | None = None  # it hears a radio control; None while it is not known
    px4_position_enu_m: Xyz | None = None  # its own estimate
    fuses_position: bool = False  # by its required parameters it takes the mocap's position
    fuses_heading: bool = False  # by its required parameters it takes the mocap's heading

    # satellites
    fix_type: int | None = None  # of its receiver; None while it is not told
    corrections: CorrectionsStatus | None = None  # of a vehicle that takes them

    # mocap
    # arrival of the newest sample minus its stamp; None without one
    sample_delay_s: float | None = None
    sample_age_s: float = math.inf  # since that arrival
    pose_sources: int = 0  # programs that have sent poses of the own body lately
    source_problem: str = ""  # of the mocap that is read on this computer, as a sentence
    heading_miss_rad: float = 0.0  # the mocap's heading minus PX4's
    # angle between the directions of up, by mocap and by PX4, in the body's axes
    tilt_miss_rad: float = 0.0
    # these directions differed when the vehicle was last tilted by hand
    has_wrong_tilt: bool = False

    # the vehicle
    speed_m_s: float = 0.0  # highest of the last second
    has_flown: bool = False  # since this agent started, so that the vehicle may stand anywhere
    hover_frac: float = math.nan  # learned in flight

    # bus and computers
    radio: RadioMeasured | None = None  # None until enough states have come
    has_duplicate: bool = False  # another agent publishes for this vehicle
    # node -> error of its clock; inf: not measured
    clock_bounds_s: Mapping[str, float] = field(default_factory=dict)
    # (whose certificate of this computer ends first, seconds until then); None without keys
    certificate_left: tuple[str, float] | None = None
    loop_p99_ms: float = 0.0  # 99 % of the control loop's periods are shorter
    has_recorder: bool = False
    has_emulator: bool = False  # covey sitl is on the bus

    # law and failsafes
    law: str = "covey"
    # (name, sentence, remedy) of the findings that refuse
    law_refusals: tuple[tuple[str, str, str], ...] = ()
    conditions: frozenset[Condition] = frozenset()  # of the failsafe table that hold

    # vehicles on the ground that have not flown yet: where each is seen [m], ENU
    spots_seen_enu_m: Mapping[str, Xyz] = field(default_factory=dict)
    place: str = ""  # whose spot it stands on where it stands in for another vehicle
    position_std_m: float = 0.0  # of the own position, along one axis

    @property
    def has_autopilot(self) -> bool:
        """Whether PX4 and its heartbeat are heard."""
        is_heard = self.autopilot_age_s < AUTOPILOT_SILENT_S
        return is_heard and self.heartbeat_age_s < HEARTBEAT_SILENT_S

    @property
    def newest_refused(self) -> str:
        """Reason of the newest packet that was not let in; empty when that was long ago."""
        if self.refused_age_s >= REFUSED_LATELY_S:
            return ""
        return self.refused.newest

    @property
    def has_wrong_clock(self) -> bool:
        """Whether mocap samples arrive whose stamps cannot be of our clock."""
        delay_s = self.sample_delay_s
        if delay_s is None or self.sample_age_s >= POSITION_STALE_S:
            return False
        return not -FUTURE_S <= delay_s <= OLDEST_SAMPLE_S

    @property
    def has_position(self) -> bool:
        """Whether the position is fresh."""
        return self.position_age_s < POSITION_STALE_S
