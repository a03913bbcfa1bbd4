"""Rules of preflight about position: freshness, clock, agreement with PX4, rest, take-off spot, geofence. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.safety.failsafe_table import Condition
from onboard.safety.limits import POSITION_STALE_S
from onboard.safety.preflight_facts import OLDEST_SAMPLE_S, PreflightFacts
from onboard.safety.preflight_rule import (
    FINE,
    NO_MOCAP,
    NO_POSITION,
    NO_PX4,
    OK,
    SKIP,
    Judgement,
    PreflightRule,
    RuleFault,
    coordinates,
)

WIDE_CLOCK_S = 0.02
FAR_FROM_PX4_M, HEADING_MISS_DEG, TILT_MISS_DEG = 0.3, 25.0, 6.0
MOVING_M_S = 0.3
OFF_SPOT_M = 0.5

# samples arrive and are not used: the rule "failsafe" has the sentence
_REJECTED = frozenset({Condition.MOCAP_FROZEN, Condition.MOCAP_SWAPPED, Condition.POSITION_JUMPED})


def _position(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_position:
        return OK, {"position": coordinates(facts.position_enu_m), "age": 1e3 * facts.position_age_s}
    if facts.has_wrong_clock:
        return SKIP, {"reason": "before the clocks agree"}
    if facts.conditions & _REJECTED:
        return SKIP, {"reason": "while the mocap's samples are rejected"}
    if not vehicle.mocap_required:
        return "silent", {}
    if facts.source_problem:
        return "source", {"problem": facts.source_problem}
    return "untracked", {}


def _clock(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_wrong_clock:
        assert facts.sample_delay_s is not None
        is_ahead = facts.sample_delay_s < 0.0
        return "mocap", {"gap": f"{abs(facts.sample_delay_s):.3g} s {'in the future' if is_ahead else 'in the past'}"}
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
        if name != vehicle.name and math.dist(x_y, fleet.vehicles[name].start_enu_m[:2]) < OFF_SPOT_M:
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


POSITION_RULES = (
    PreflightRule(
        "position",
        f"The position is younger than {POSITION_STALE_S:g} s.",
        "At {position}, {age:.0f} ms old.",
        {
            "untracked": RuleFault(
                "There is no fresh position from mocap body '{body}'.",
                "Check that the body is tracked, that it is published under this name (covey mocap), and that this "
                "computer receives it.",
            ),
            "source": RuleFault(
                "There is no fresh position from mocap body '{body}': {problem}",
                "Correct [mocap] in the fleet file or the mocap itself, and test it with 'covey mocap --check'.",
            ),
            "silent": RuleFault(
                "PX4 sends no fresh local position.",
                "Wait until PX4's estimator has a position (satellites, vision), and check its rate on this link.",
            ),
        },
        _position,
    ),
    PreflightRule(
        "clock",
        f"Mocap samples are at most {OLDEST_SAMPLE_S:g} s old on arrival and not from the future: sender and receiver "
        "share one clock, or the offset is measured. The clocks of other computers are measured; an error above "
        f"{1e3 * WIDE_CLOCK_S:g} ms gives advice.",
        "The mocap's stamps and this computer's clock agree.",
        {
            "mocap": RuleFault(
                "Mocap samples arrive with stamps {gap}.",
                "The sender has another clock: run 'covey mocap' on the computer that reads the mocap, so that the "
                "offset is measured, or restart the sender.",
            ),
            "unmeasured": RuleFault(
                "The clock of {others} is not measured yet.",
                "Wait a second. If it stays, that computer does not receive this agent's messages: check its network.",
            ),
            "wide": RuleFault(
                "The clock of {other} is known to {bound:.0f} ms only; its messages count as older by that.",
                "Look for a slow or busy network between the two computers.",
                is_advice=True,
            ),
        },
        _clock,
    ),
    PreflightRule(
        "agreement",
        f"Mocap and PX4 agree: tilt within {TILT_MISS_DEG:g} degrees, now and when last tilted by hand; heading within "
        f"{HEADING_MISS_DEG:g} degrees and position within {FAR_FROM_PX4_M:g} m, if PX4 fuses them.",
        "Mocap and PX4 agree: heading within {turn:.0f} and tilt within {tilt:.0f} degrees.",
        {
            "tilt": RuleFault(
                "Mocap and PX4 disagree by {tilt:.0f} degrees about which way is up.",
                "Align the body's axes in the mocap software with the vehicle standing level: x forward, z up, and the "
                "mocap's z axis up.",
            ),
            "handled": RuleFault(
                "When the vehicle was last tilted by hand, mocap and PX4 measured tilts in different directions.",
                "Body '{body}' is on another vehicle, or its axes are turned: correct it, then tilt the vehicle again.",
            ),
            "heading": RuleFault(
                "Mocap and PX4 disagree by {heading:.0f} degrees about the heading, although PX4 receives the mocap's.",
                "Align the body's x axis with the vehicle's nose, check the mocap's frame, and that PX4 fuses the "
                "heading (EKF2_EV_CTRL).",
            ),
            "missing": RuleFault(
                "PX4 sends no local position.", "Wait until PX4 has fused the mocap; check EKF2_EV_CTRL."
            ),
            "apart": RuleFault(
                "PX4's position is {px4}, {distance:.2f} m from where the mocap measures the vehicle.",
                "Wait a few seconds. If it stays, PX4 does not fuse the mocap: check EKF2_EV_CTRL, EKF2_HGT_REF and "
                "EKF2_GPS_CTRL, and restart PX4.",
            ),
            "compass": RuleFault(
                "The mocap's heading is {heading:.0f} degrees from PX4's compass.",
                "The agent takes the heading from the mocap; make sure that the body's x axis is the vehicle's nose.",
                is_advice=True,
            ),
        },
        _agreement,
    ),
    PreflightRule(
        "at rest",
        f"The vehicle stands still: it is slower than {MOVING_M_S:g} m/s.",
        "It stands still.",
        {
            "moving": RuleFault(
                "It moves with {speed:.1f} m/s.",
                "Put it down. If it stands still, the mocap measures wrongly: look for reflections.",
            )
        },
        _at_rest,
    ),
    PreflightRule(
        "spot",
        f"With a mocap the vehicle stands within {OFF_SPOT_M:g} m of its start_enu_m, unless this agent has flown it. "
        "This rule finds turned or mirrored frames and swapped bodies.",
        "It stands {off:.2f} m from its take-off spot.",
        {
            "swapped": RuleFault(
                "The mocap measures it at {position}, on the take-off spot of {other}.",
                "Check which body is on which vehicle and the axes of the mocap, or carry it to its own spot {spot}.",
            ),
            "away": RuleFault(
                "The mocap measures it at {position}, {off:.2f} m from its take-off spot {spot}.",
                "If it stands there, correct start_enu_m or carry it to its spot. If not, the mocap's frame is turned "
                "or mirrored: correct its axes.",
            ),
        },
        _spot,
    ),
    PreflightRule(
        "fence",
        "Position and take-off spot lie inside the geofence.",
        "It stands inside the geofence.",
        {
            "spot": RuleFault(
                "The take-off spot {spot} lies outside the geofence.", "Correct start_enu_m or geofence_m."
            ),
            "outside": RuleFault("The position {position} lies outside the geofence.", "Carry the vehicle inside."),
        },
        _fence,
    ),
)
