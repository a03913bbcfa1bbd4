"""What a vehicle on the ground is judged by before take-off, and each judgement without its words. Pure.

A judge names what it found: ``ok``, ``skip`` (another rule must come true first) or a fault of its rule in
:mod:`onboard.safety.preflight_rules`, and the numbers for the sentence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from onboard.config.fleet import FleetConfig, Vec3, Vehicle
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation, in_order

AUTOPILOT_SILENT_S = 0.3
HEARTBEAT_SILENT_S = 3.0
POSITION_STALE_S = 0.2
LEAST_ATTITUDE_HZ, USUAL_ATTITUDE_HZ = 20.0, 35.0
OLDEST_SAMPLE_S, FUTURE_S, WIDE_CLOCK_S = 0.5, 0.005, 0.02
FAR_FROM_PX4_M, HEADING_MISS_DEG, TILT_MISS_DEG = 0.3, 25.0, 6.0
MOVING_M_S = 0.3
OFF_SPOT_M = 0.5
HOVER_SHARE, HOVER_ADVICE_SHARE = 0.25, 0.10
LOWEST_VOLTAGE_V = 2.5
LATE_LOOP_MS = 30.0

OK, SKIP = "ok", "skip"
Judgement = tuple[str, Mapping[str, object]]


@dataclass(frozen=True, slots=True)
class PreflightFacts:
    """What is known of a vehicle on the ground; ages in seconds, inf = never heard, None = never told.

    attitude_hz: of PX4's attitude as it arrives. unhealthy: PX4's sensors that it calls unhealthy, and whether flight
    needs them. has_rc: whether PX4 hears a radio control. has_duplicate: another process speaks for this vehicle.
    sample_delay_s: arrival of the newest mocap sample minus its stamp; sample_age_s: since that arrival.
    source_problem: what the mocap that is read here says of itself, as a sentence; empty when nothing is wrong.
    px4_position_enu_m: PX4's own estimate, turned to ENU. heading_miss_rad: mocap's heading minus PX4's; tilt_miss_rad:
    between both directions of gravity as the body sees it; has_wrong_tilt: they differed when it was last tilted by
    hand. fuses_position, fuses_heading: what PX4 takes from the mocap by its required parameters.
    has_flown: since this agent started, so that it may stand anywhere. hover_frac: as learned in flight.
    clock_bounds_s: node on another host -> how well its clock is known, inf: not measured. other_hashes: vehicle ->
    its configuration hash, where it differs. law_refusals: (name, sentence, remedy) of the law's findings against it.
    param_problems: sentences; None while not read yet. conditions: what holds of the failsafe table.
    """

    autopilot_age_s: float
    heartbeat_age_s: float
    position_age_s: float
    position_enu_m: Vec3
    battery_frac: float
    missing_neighbours: tuple[str, ...]
    other_hashes: Mapping[str, str]
    config_hash: str
    param_problems: tuple[str, ...] | None
    is_law_warm: bool
    is_airborne: bool
    battery_voltage_v: float = math.nan
    attitude_hz: float | None = None
    is_armed: bool = False
    is_failsafe: bool = False
    unhealthy: tuple[tuple[str, bool], ...] = ()
    has_rc: bool | None = None
    has_duplicate: bool = False
    sample_delay_s: float | None = None
    sample_age_s: float = math.inf
    source_problem: str = ""
    speed_m_s: float = 0.0
    px4_position_enu_m: Vec3 | None = None
    heading_miss_rad: float = 0.0
    tilt_miss_rad: float = 0.0
    has_wrong_tilt: bool = False
    fuses_position: bool = False
    fuses_heading: bool = False
    has_flown: bool = False
    hover_frac: float = math.nan
    clock_bounds_s: Mapping[str, float] = field(default_factory=dict)
    law: str = "covey"
    law_refusals: tuple[tuple[str, str, str], ...] = ()
    loop_p99_ms: float = 0.0
    has_recorder: bool = False
    conditions: frozenset[Condition] = frozenset()

    @property
    def has_autopilot(self) -> bool:
        """Whether PX4 speaks."""
        return self.autopilot_age_s < AUTOPILOT_SILENT_S and self.heartbeat_age_s < HEARTBEAT_SILENT_S

    @property
    def has_wrong_clock(self) -> bool:
        """Whether mocap samples arrive whose stamps cannot be of our clock."""
        delay = self.sample_delay_s
        return delay is not None and self.sample_age_s < POSITION_STALE_S and not -FUTURE_S <= delay <= OLDEST_SAMPLE_S

    @property
    def has_position(self) -> bool:
        """Whether the position is fresh."""
        return self.position_age_s < POSITION_STALE_S


# conditions that have a line of their own here, or, having been asked to stop, a word of the order's own refusal
_OF_OTHER_RULES = frozenset(
    {
        *(Condition.POSITION_STALE, Condition.POSITION_LOST, Condition.AUTOPILOT_SILENT, Condition.AUTOPILOT_FROZEN),
        *(Condition.HEARTBEAT_LOST, Condition.TWIN, Condition.SHUTDOWN, Condition.BUS_LOST, Condition.BUS_LOST_LONG),
        *(Condition.SEPARATION_BREACHED, Condition.CONFIG_DIFFERS, Condition.BATTERY_WARNING, Condition.BATTERY_LOW),
        *(Condition.FENCE_BREACH, Condition.FENCE_BREACH_LONG),
    }
)
# samples come and are not taken: the failsafe's line says why
_UNBELIEVED = frozenset({Condition.MOCAP_FROZEN, Condition.MOCAP_SWAPPED, Condition.POSITION_JUMPED})
_FINE: Judgement = (OK, {})
_NO_PX4: Judgement = (SKIP, {"without": "while PX4 is silent"})
_NO_POSITION: Judgement = (SKIP, {"without": "without a fresh position"})
_NO_MOCAP: Judgement = (SKIP, {"without": "for a vehicle that flies on PX4's own position"})


def _where(position: Vec3) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in position) + ") m"


def px4(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.has_autopilot:
        return "silent", {}
    return OK, {"age": f.heartbeat_age_s}


def link(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.has_autopilot:
        return _NO_PX4
    if f.attitude_hz is None:
        return SKIP, {"without": "in the first second"}
    words = {"rate": f.attitude_hz}
    return ("slow" if f.attitude_hz < LEAST_ATTITUDE_HZ else "thin" if f.attitude_hz < USUAL_ATTITUDE_HZ else OK), words


def alone(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    return ("duplicate", {}) if f.has_duplicate else _FINE


def health(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.has_autopilot:
        return _NO_PX4
    if f.is_failsafe:
        return "failsafe", {}
    for is_needed, key in ((True, "unhealthy"), (False, "unneeded")):
        names = ", ".join(name for name, needed in f.unhealthy if needed is is_needed)
        if names:
            return key, {"sensors": names}
    return _FINE


def disarmed(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.has_autopilot:
        return _NO_PX4
    return ("airborne", {}) if f.is_airborne else ("armed", {}) if f.is_armed else _FINE


def failsafe(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    late = {Condition.MOCAP_LATE, Condition.CLOCK_JUMPED} if f.has_wrong_clock else set()  # the clock's line says so
    found = [
        condition.value
        for condition in in_order(f.conditions - _OF_OTHER_RULES - late)
        if TABLE[Situation.GROUND, condition] is Action.REFUSE
    ]
    if not found:
        return _FINE
    text = ", ".join(found)
    return "holds", {"conditions": text[0].upper() + text[1:]}


def parameters(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.has_autopilot:
        return _NO_PX4
    if f.param_problems is None:
        return "unread", {}
    words = {"problems": " ".join(f.param_problems), "fleet": fleet.path}
    return ("differ" if f.param_problems else OK), words


def position(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if f.has_position:
        return OK, {"where": _where(f.position_enu_m), "age": 1e3 * f.position_age_s}
    if f.has_wrong_clock:
        return SKIP, {"without": "before the clocks agree"}
    if f.conditions & _UNBELIEVED:
        return SKIP, {"without": "while the mocap is not believed"}
    if not vehicle.mocap_required:
        return "silent", {}
    if f.source_problem:
        return "source", {"problem": f.source_problem}
    return "untracked", {}


def clock(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if f.has_wrong_clock:
        assert f.sample_delay_s is not None
        ahead = f.sample_delay_s < 0.0
        return "mocap", {"gap": f"{abs(f.sample_delay_s):.3g} s {'in the future' if ahead else 'in the past'}"}
    unknown = [name for name, bound_s in f.clock_bounds_s.items() if not math.isfinite(bound_s)]
    if unknown:
        return "unmeasured", {"others": ", ".join(unknown)}
    widest = max(f.clock_bounds_s, key=f.clock_bounds_s.__getitem__, default="")
    if widest and f.clock_bounds_s[widest] > WIDE_CLOCK_S:
        return "wide", {"other": widest, "bound": 1e3 * f.clock_bounds_s[widest]}
    return _FINE


def agreement(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not vehicle.mocap_required:
        return _NO_MOCAP
    if not f.has_autopilot:
        return _NO_PX4
    if not f.has_position:
        return _NO_POSITION
    heading_deg, tilt_deg = math.degrees(f.heading_miss_rad), math.degrees(f.tilt_miss_rad)
    words: dict[str, object] = {"heading": heading_deg, "turn": abs(heading_deg), "tilt": tilt_deg}
    if not tilt_deg <= TILT_MISS_DEG:  # so that what is not a number is not fine
        return "tilt", words
    if f.has_wrong_tilt:
        return "handled", words
    if f.param_problems:
        return SKIP, {"without": "before PX4's parameters are right"}
    is_turned = not abs(heading_deg) <= HEADING_MISS_DEG
    if is_turned and f.fuses_heading:
        return "heading", words
    if f.fuses_position:
        if f.px4_position_enu_m is None:
            return "untold", words
        words["away"] = math.dist(f.px4_position_enu_m, f.position_enu_m)
        words["px4"] = _where(f.px4_position_enu_m)
        if not math.dist(f.px4_position_enu_m, f.position_enu_m) <= FAR_FROM_PX4_M:
            return "apart", words
    return ("compass" if is_turned else OK), words


def at_rest(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.has_position:
        return _NO_POSITION
    return ("moving" if not f.speed_m_s <= MOVING_M_S else OK), {"speed": f.speed_m_s}


def spot(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not vehicle.mocap_required:
        return _NO_MOCAP
    if not f.has_position:
        return _NO_POSITION
    off_m = math.dist(f.position_enu_m[:2], vehicle.start_enu_m[:2])
    words: dict[str, object] = {"off": off_m, "spot": _where(vehicle.start_enu_m), "where": _where(f.position_enu_m)}
    if off_m <= OFF_SPOT_M or f.has_flown:
        return OK, words
    for name in fleet.enabled_names:
        if name != vehicle.name and math.dist(f.position_enu_m[:2], fleet.vehicles[name].start_enu_m[:2]) < OFF_SPOT_M:
            return "swapped", {**words, "other": name}
    return "away", words


def fence(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    fence = fleet.fleet.geofence_m
    if not fence.contains(vehicle.start_enu_m):
        return "spot", {"spot": _where(vehicle.start_enu_m)}
    if not f.has_position:
        return _NO_POSITION
    return ("outside" if not fence.contains(f.position_enu_m) else OK), {"where": _where(f.position_enu_m)}


def neighbours(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if f.missing_neighbours:
        several = len(f.missing_neighbours) > 1
        who = ", ".join(f.missing_neighbours)
        return "unheard", {"who": who, "are": "are" if several else "is", "agents": "agents" if several else "agent"}
    return OK, {"count": len(fleet.enabled_names) - 1}


def configuration(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    words = {"hash": f.config_hash}
    if f.other_hashes:
        name, other = next(iter(f.other_hashes.items()))
        more = f" (and {len(f.other_hashes) - 1} more)" if len(f.other_hashes) > 1 else ""
        return "differs", {**words, "who": f"{name}{more}", "other": other}
    return OK, words


def law(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.law_refusals:
        return OK, {"law": f.law}
    _, sentence, remedy = f.law_refusals[0]
    words = {"law": f.law, "finding": sentence, "change": remedy}
    return ("refused" if f.law == "covey" else "baseline"), words


def hover(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    words = {"learned": f.hover_frac, "file": vehicle.hover_thrust_frac}
    if not math.isfinite(f.hover_frac):
        return OK, {**words, "learned": vehicle.hover_thrust_frac}
    share = abs(f.hover_frac / vehicle.hover_thrust_frac - 1.0)
    return ("far" if share > HOVER_SHARE else "off" if share > HOVER_ADVICE_SHARE else OK), words


def battery(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.has_autopilot:
        return _NO_PX4
    words = {
        "level": 100.0 * f.battery_frac,
        "volts": f.battery_voltage_v,
        "need": fleet.fleet.battery_warning_pct,
    }
    if not math.isfinite(f.battery_frac):
        return "untold", words
    if not 0.0 <= f.battery_frac <= 1.0 or f.battery_voltage_v < LOWEST_VOLTAGE_V:
        return "implausible", words
    return ("low" if words["level"] < fleet.fleet.battery_warning_pct else OK), words


def loop(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not f.is_law_warm:
        return "warming", {}
    return ("late" if f.loop_p99_ms > LATE_LOOP_MS else OK), {"p99": f.loop_p99_ms}


def record(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    return _FINE if f.has_recorder else ("none", {})


def kill_switch(f: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if f.has_rc:
        return "heard", {}
    return ("unknown" if f.has_rc is None else "unheard"), {}
