"""Rules of preflight about position: freshness, clock, agreement with PX4, rest, take-off spot,
geofence. Pure.
"""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.preflight.preflight_facts import OLDEST_SAMPLE_S, PreflightFacts
from onboard.preflight.preflight_rule import (
    FINE,
    NO_MOCAP,
    NO_POSITION,
    NO_PX4,
    OK,
    SKIP,
    Judgement,
    coordinates,
    rules,
)
from onboard.safety.failsafe_table import Condition
from onboard.safety.limits import POSITION_STALE_S

WIDE_CLOCK_S = 0.02
FAR_FROM_PX4_M, HEADING_MISS_DEG, TILT_MISS_DEG = 0.3, 25.0, 6.0
MOVING_M_S = 0.3
OFF_SPOT_M = 0.5

# samples arrive and are not used: the rule "failsafe" has the sentence
_REJECTED = frozenset({Condition.MOCAP_FROZEN, Condition.MOCAP_SWAPPED, Condition.POSITION_JUMPED})


def _position(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.pose_sources > 1:
        return "several", {"count": facts.pose_sources}
    if facts.has_position:
        return OK, {
            "position": coordinates(facts.position_enu_m),
            "age": 1e3 * facts.position_age_s,
        }
    if facts.has_wrong_clock:
        return SKIP, {"reason": "before the clocks agree"}
    if facts.conditions & _REJECTED:
        return SKIP, {"reason": "while the mocap's samples are rejected"}
    if not vehicle.mocap_required:
        return "silent", {}
    if facts.source_problem:
        return "source", {"problem": facts.source_problem}
    return ("unemulated" if vehicle.emulated else "untracked"), {}


def _clock(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_wrong_clock:
        assert facts.sample_delay_s is not None
        is_ahead = facts.sample_delay_s < 0.0
        return "mocap", {
            "gap": f"{abs(facts.sample_delay_s):.3g} s {'in the future' if is_ahead else 'in the past'}"
        }
    unknown = [name for name, bound_s in facts.clock_bounds_s.items() if not math.isfinite(bound_s)]
    if unknown:
        return "unmeasured", {"others": ", ".join(unknown)}
    widest = max(facts.clock_bounds_s, key=facts.clock_bounds_s.__getitem__, default="")
    if widest and facts.clock_bounds_s[widest] > WIDE_CLOCK_S:
        return "wide", {"other": widest, "bound": 1e3 * facts.clock_bounds_s[widest]}
    return FINE


def _agreement(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not vehicle.mocap_required:
        return NO_MOCAP
    if not facts.has_autopilot:
        return NO_PX4
    if not facts.has_position:
        return NO_POSITION
    heading_deg, tilt_deg = math.degrees(facts.heading_miss_rad), math.degrees(facts.tilt_miss_rad)
    words: dict[str, object] = {"heading": heading_deg, "turn": abs(heading_deg), "tilt": tilt_deg}
    if not tilt_deg <= TILT_MISS_DEG:  # so that NaN is not fine
        return "tilt", words
    if facts.has_wrong_tilt:
        return "handled", words
    if facts.param_problems:
        return SKIP, {"reason": "before PX4's parameters are right"}
    is_turned = not abs(heading_deg) <= HEADING_MISS_DEG
    if is_turned and facts.fuses_heading:
        return "heading", words
    if facts.fuses_position:
        if facts.px4_position_enu_m is None:
            return "missing", words
        words["distance"] = math.dist(facts.px4_position_enu_m, facts.position_enu_m)
        words["px4"] = coordinates(facts.px4_position_enu_m)
        if not math.dist(facts.px4_position_enu_m, facts.position_enu_m) <= FAR_FROM_PX4_M:
            return "apart", words
    return ("compass" if is_turned else OK), words


def _at_rest(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_position:
        return NO_POSITION
    return ("moving" if not facts.speed_m_s <= MOVING_M_S else OK), {"speed": facts.speed_m_s}


def _spot(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not vehicle.mocap_required:
        return NO_MOCAP
    if not facts.has_position:
        return NO_POSITION
    x_y = facts.position_enu_m[:2]
    off_m = math.dist(x_y, vehicle.start_enu_m[:2])
    spot, position = coordinates(vehicle.start_enu_m), coordinates(facts.position_enu_m)
    words: dict[str, object] = {"off": off_m, "spot": spot, "position": position}
    if off_m <= OFF_SPOT_M or facts.has_flown:
        return OK, words
    for name in fleet.enabled_names:
        if (
            name != vehicle.name
            and math.dist(x_y, fleet.vehicles[name].start_enu_m[:2]) < OFF_SPOT_M
        ):
            return "swapped", {**words, "other": name}
    return "away", words


def _fence(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    fence = fleet.fleet.geofence_m
    if not fence.contains(vehicle.start_enu_m):
        return "spot", {"spot": coordinates(vehicle.start_enu_m)}
    if not facts.has_position:
        return NO_POSITION
    is_outside = not fence.contains(facts.position_enu_m)
    return ("outside" if is_outside else OK), {"position": coordinates(facts.position_enu_m)}


POSITION_RULES = rules(
    {
        "position": _position,
        "clock": _clock,
        "agreement": _agreement,
        "at rest": _at_rest,
        "spot": _spot,
        "fence": _fence,
    },
    FAR_FROM_PX4_M=FAR_FROM_PX4_M,
    HEADING_MISS_DEG=HEADING_MISS_DEG,
    MOVING_M_S=MOVING_M_S,
    OFF_SPOT_M=OFF_SPOT_M,
    OLDEST_SAMPLE_S=OLDEST_SAMPLE_S,
    POSITION_STALE_S=POSITION_STALE_S,
    TILT_MISS_DEG=TILT_MISS_DEG,
    WIDE_CLOCK_S=WIDE_CLOCK_S,
)
