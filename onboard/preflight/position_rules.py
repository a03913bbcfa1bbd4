"""Rules of preflight about position. Pure.

The rules are about freshness, clock, agreement with PX4, rest, take-off spot and geofence.

Each rule returns a key and values for a sentence. The key names a sentence in ``preflight.toml``.
It is under ``[RULE.refuses]`` if the fault refuses a take-off, and under ``[RULE.advises]`` if it
is advice.
"""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.config.stand_in import BY_SATELLITES_M
from onboard.preflight.frame_fit import fit_frame
from onboard.preflight.preflight_facts import OLDEST_SAMPLE_S, PreflightFacts
from onboard.preflight.preflight_rule import (
    NO_MOCAP,
    NO_POSITION,
    NO_PX4,
    OK,
    OWN_FRAME,
    PASSED,
    SKIP,
    Judgement,
    coordinates,
    rules,
)
from onboard.safety.failsafe_table import Condition
from onboard.safety.limits import POSITION_STALE_S
from onboard.tuples import Xyz

# Largest values that pass a rule; preflight.toml describes each rule.
WIDE_CLOCK_S = 0.02
FAR_FROM_PX4_M = 0.3
HEADING_MISS_DEG = 25.0
TILT_MISS_DEG = 6.0
MOVING_M_S = 0.3
OFF_SPOT_M = 0.5
OFF_SPOT_SIGMAS = 3.0  # by satellites, besides BY_SATELLITES_M
UNSEEN_TURN_DEG = 2.0

# conditions in which samples arrive but are rejected; the rule "failsafe" reports them
_REJECTED = frozenset({Condition.MOCAP_FROZEN, Condition.MOCAP_SWAPPED, Condition.POSITION_JUMPED})


def _position(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.pose_sources > 1:
        return "several sources", {"count": facts.pose_sources}
    if facts.has_position:
        age_ms = 1e3 * facts.position_age_s
        return OK, {"position": coordinates(facts.position_enu_m), "age": age_ms}

    if facts.has_wrong_clock:
        return SKIP, {"reason": "before the clocks agree"}
    if facts.conditions & _REJECTED:
        return SKIP, {"reason": "while the mocap's samples are rejected"}
    if facts.displaced_m > 0.0 and vehicle.flies_by_vision:
        return "camera began anew", {"away": facts.displaced_m}
    if facts.displaced_m > 0.0:
        return "displaced", {"away": facts.displaced_m}
    if facts.is_camera_turned:
        return "camera turned", {}
    if not vehicle.mocap_required:
        return "silent", {}
    if facts.is_contradicted:
        return "contradicted", {}
    if facts.source_problem:
        return "source faulty", {"problem": facts.source_problem}
    if vehicle.emulated:
        return "no emulator", {}  # covey sitl should send its poses
    return "untracked", {}


def _clock(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_wrong_clock:
        assert facts.sample_delay_s is not None
        direction = "in the past"
        if facts.sample_delay_s < 0.0:
            direction = "in the future"
        return "wrong stamps", {"gap": f"{abs(facts.sample_delay_s):.3g} s {direction}"}

    bounds_s = facts.clock_bounds_s
    unknown = [name for name, bound_s in bounds_s.items() if not math.isfinite(bound_s)]
    if unknown:
        return "unmeasured", {"others": ", ".join(unknown)}

    widest = max(bounds_s, key=bounds_s.__getitem__, default="")
    if widest and bounds_s[widest] > WIDE_CLOCK_S:
        return "uncertain", {"other": widest, "bound": 1e3 * bounds_s[widest]}
    return PASSED


def _agreement(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not vehicle.mocap_required:
        return NO_MOCAP
    if not facts.has_autopilot:
        return NO_PX4
    if not facts.has_position:
        return NO_POSITION

    # comparisons are written so that NaN is a fault
    heading_deg = math.degrees(facts.heading_miss_rad)
    tilt_deg = math.degrees(facts.tilt_miss_rad)
    words: dict[str, object] = {"heading": heading_deg, "turn": abs(heading_deg), "tilt": tilt_deg}
    if not tilt_deg <= TILT_MISS_DEG:
        return "tilt", words
    if facts.differed_when_tilted:
        return "tilted by hand", words
    if facts.param_problems:
        return SKIP, {"reason": "before PX4's parameters are right"}

    is_turned = not abs(heading_deg) <= HEADING_MISS_DEG
    if is_turned and facts.fuses_heading:
        return "heading", words

    if facts.fuses_position:
        if facts.px4_position_enu_m is None:
            return "no PX4 position", words
        apart_m = math.dist(facts.px4_position_enu_m, facts.position_enu_m)
        words["distance"] = apart_m
        words["px4"] = coordinates(facts.px4_position_enu_m)
        if not apart_m <= FAR_FROM_PX4_M:
            return "apart", words

    # PX4 does not use the mocap's heading, so a difference only shows an error of its compass
    if is_turned:
        return "compass", words
    return OK, words


def _at_rest(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_position:
        return NO_POSITION
    if not facts.speed_m_s <= MOVING_M_S:
        words = {"speed": facts.speed_m_s}
        return ("moving" if vehicle.mocap_required else "position moves"), words
    return PASSED


def _spot(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if fleet.begins_on_its_spot(vehicle):
        return OWN_FRAME
    if not facts.has_position:
        return NO_POSITION

    x_y_m = facts.position_enu_m[:2]
    spot_enu_m = _spot_enu_m(facts, fleet, vehicle)
    off_m = math.dist(x_y_m, spot_enu_m[:2])
    words: dict[str, object] = {
        "off": off_m,
        "spot": coordinates(spot_enu_m),
        "position": coordinates(facts.position_enu_m),
    }
    if facts.may_be_anywhere:
        return OK, words
    if not vehicle.mocap_required:
        most_m = BY_SATELLITES_M + OFF_SPOT_SIGMAS * facts.position_std_m
        if off_m <= most_m:
            return OK, words
        return "elsewhere", {**words, "most": most_m}
    if off_m <= OFF_SPOT_M:
        return OK, words

    slot_owner = vehicle.name
    if facts.stands_in_for:
        slot_owner = facts.stands_in_for
    for name in fleet.enabled_names:
        if name == slot_owner:
            continue
        other_spot_m = fleet.vehicles[name].start_enu_m[:2]
        if math.dist(x_y_m, other_spot_m) < OFF_SPOT_M:
            return "swapped", {**words, "other": name}
    if facts.has_flown:
        return "not followed", words
    return "away", words


def _frame(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if fleet.begins_on_its_spot(vehicle):
        return OWN_FRAME
    if facts.may_be_anywhere:
        return SKIP, {"reason": "after a flight"}

    planned_m = []
    seen_m = []
    for name, (east_m, north_m, _) in facts.spots_seen_enu_m.items():
        spot_east_m, spot_north_m, _ = fleet.vehicles[name].start_enu_m
        planned_m.append((spot_east_m, spot_north_m))
        seen_m.append((east_m, north_m))

    fence = fleet.fleet.geofence_m
    std_m = math.hypot(fleet.fleet.placing_m, facts.position_std_m)
    corners_m = [(x, y) for x in fence.x for y in fence.y]
    frame = fit_frame(planned_m, seen_m, corners_m, std_m)
    if frame is None:
        return SKIP, {"reason": "by fewer than two vehicles on their spots"}

    words: dict[str, object] = {
        "count": len(planned_m),
        "turn": math.degrees(frame.turn_rad),
        "shift": frame.shift_m,
        "miss": abs(frame.turn_rad) * frame.far_m,
        "unseen": math.degrees(frame.unseen_turn_rad),
        "corner": frame.unseen_turn_rad * frame.far_m,
        "placing": fleet.fleet.placing_m,
        "std": frame.spot_std_m,
    }
    if frame.is_turned:
        return "turned", words
    if frame.is_shifted:
        return "shifted", words
    if math.degrees(frame.unseen_turn_rad) > UNSEEN_TURN_DEG:
        return "spots too near", words
    return OK, words


def _fence(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    space = flight_space_of(fleet)
    spot_enu_m = _spot_enu_m(facts, fleet, vehicle)
    if not space.contains(spot_enu_m):
        return "spot outside", {"spot": coordinates(spot_enu_m)}
    if not facts.has_position:
        return NO_POSITION
    if not space.contains(facts.position_enu_m):
        return "position outside", {"position": coordinates(facts.position_enu_m)}
    return PASSED


def _spot_enu_m(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Xyz:
    """Return the vehicle's take-off spot [m]: its own, or that of the vehicle it replaces."""
    if facts.stands_in_for:
        return fleet.vehicles[facts.stands_in_for].start_enu_m
    return vehicle.start_enu_m


POSITION_RULES = rules(
    {
        "position": _position,
        "clock": _clock,
        "agreement": _agreement,
        "at rest": _at_rest,
        "spot": _spot,
        "frame": _frame,
        "fence": _fence,
    },
    FAR_FROM_PX4_M=FAR_FROM_PX4_M,
    HEADING_MISS_DEG=HEADING_MISS_DEG,
    MOVING_M_S=MOVING_M_S,
    OFF_SPOT_M=OFF_SPOT_M,
    OFF_SPOT_SIGMAS=OFF_SPOT_SIGMAS,
    BY_SATELLITES_M=BY_SATELLITES_M,
    UNSEEN_TURN_DEG=UNSEEN_TURN_DEG,
    OLDEST_SAMPLE_S=OLDEST_SAMPLE_S,
    POSITION_STALE_S=POSITION_STALE_S,
    TILT_MISS_DEG=TILT_MISS_DEG,
    WIDE_CLOCK_S=WIDE_CLOCK_S,
)
