"""Rules of preflight about the flight to come: neighbours, fleet file, law, throttle, battery, loop, record. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.safety.preflight_facts import PreflightFacts
from onboard.safety.preflight_rule import FINE, NO_PX4, OK, Judgement, PreflightRule, RuleFault

HOVER_SHARE, HOVER_ADVICE_SHARE = 0.25, 0.10
LOWEST_VOLTAGE_V = 2.5
LATE_LOOP_MS = 30.0


def _neighbours(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    missing = facts.missing_neighbours
    if not missing:
        return OK, {"count": len(fleet.enabled_names) - 1}
    several = len(missing) > 1
    words = {"names": ", ".join(missing), "are": "are" if several else "is", "agents": "agents" if several else "agent"}
    return "missing", words


def _configuration(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    words = {"hash": facts.config_hash}
    if facts.other_hashes:
        name, other = next(iter(facts.other_hashes.items()))
        more = f" (and {len(facts.other_hashes) - 1} more)" if len(facts.other_hashes) > 1 else ""
        return "differs", {**words, "names": f"{name}{more}", "other": other}
    return OK, words


def _law(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.law_refusals:
        return OK, {"law": facts.law}
    _, sentence, remedy = facts.law_refusals[0]
    words = {"law": facts.law, "finding": sentence, "change": remedy}
    return ("refused" if facts.law == "covey" else "baseline"), words


def _hover(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    words = {"learned": facts.hover_frac, "file": vehicle.hover_thrust_frac}
    if not math.isfinite(facts.hover_frac):
        return OK, {**words, "learned": vehicle.hover_thrust_frac}
    share = abs(facts.hover_frac / vehicle.hover_thrust_frac - 1.0)
    return ("far" if share > HOVER_SHARE else "off" if share > HOVER_ADVICE_SHARE else OK), words


def _battery(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    required_pct = fleet.fleet.battery_warning_pct
    words = {"level": 100.0 * facts.battery_frac, "volts": facts.battery_voltage_v, "required": required_pct}
    if not math.isfinite(facts.battery_frac):
        return "unknown", words
    if not 0.0 <= facts.battery_frac <= 1.0 or facts.battery_voltage_v < LOWEST_VOLTAGE_V:
        return "implausible", words
    return ("low" if words["level"] < required_pct else OK), words


def _loop(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.is_law_warm:
        return "warming", {}
    return ("late" if facts.loop_p99_ms > LATE_LOOP_MS else OK), {"p99": facts.loop_p99_ms}


def _record(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    return FINE if facts.has_recorder else ("none", {})


def _kill_switch(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_rc:
        return "heard", {}
    return ("unknown" if facts.has_rc is None else "unheard"), {}


FLIGHT_RULES = (
    PreflightRule(
        "neighbours",
        "Every vehicle with enabled = true is heard on the bus.",
        "All {count} others are heard.",
        {
            "missing": RuleFault(
                "{names} {are} not heard on the bus.",
                "Start the {agents}, or set enabled = false in the fleet file of all vehicles.",
            )
        },
        _neighbours,
    ),
    PreflightRule(
        "configuration",
        "All vehicles fly with the same fleet file and the same law.",
        "All fly with configuration {hash}.",
        {
            "differs": RuleFault(
                "{names} flies with another fleet file, or another law ({other}, here {hash}).",
                "Restart both agents with the same file and the same --law, or without it.",
            )
        },
        _configuration,
    ),
    PreflightRule(
        "law",
        "The law can keep the safety distance with this fleet file, at the spots where vehicles stand and in their "
        "slots: docs/check.md lists these findings. For the laws paper and off they are advice only.",
        "Law '{law}' can be flown with this fleet at these spots.",
        {
            "refused": RuleFault("{finding}", "{change}"),
            "baseline": RuleFault("{finding}", "{change} Law '{law}' is flown for comparison only.", is_advice=True),
        },
        _law,
    ),
    PreflightRule(
        "hover thrust",
        f"The hover throttle learned in flight is within {100 * HOVER_SHARE:g} % of the fleet file's; beyond "
        f"{100 * HOVER_ADVICE_SHARE:g} % there is advice.",
        "It hovers at {learned:.2f} of its throttle.",
        {
            "far": RuleFault(
                "It hovered at {learned:.2f} of its throttle, the fleet file says {file:.2f}.",
                "Look for a wrong propeller, load or battery. If all fit, set hover_thrust_frac (covey identify).",
            ),
            "off": RuleFault(
                "It hovered at {learned:.2f} of its throttle, the fleet file says {file:.2f}.",
                "Set hover_thrust_frac (covey identify).",
                is_advice=True,
            ),
        },
        _hover,
    ),
    PreflightRule(
        "battery",
        "PX4 reports a plausible battery level, above battery_warning_pct of the fleet file.",
        "Battery at {level:.0f} %, {volts:.1f} V.",
        {
            "unknown": RuleFault(
                "PX4 reports no battery level.", "Wait a second. If it stays, set up PX4's battery (BAT1_...)."
            ),
            "implausible": RuleFault(
                "PX4 reports a battery of {level:.0f} % and {volts:.1f} V, which cannot be.",
                "Check the power module and PX4's battery calibration (BAT1_...).",
            ),
            "low": RuleFault(
                "Battery at {level:.0f} %, take-off requires {required:.0f} %.", "Charge or change the battery."
            ),
        },
        _battery,
    ),
    PreflightRule(
        "loop",
        f"The control pipeline has run once; periods above {LATE_LOOP_MS:g} ms give advice.",
        "The control loop keeps its time (99 % of periods within {p99:.1f} ms).",
        {
            "warming": RuleFault("The control pipeline is still warming up.", "Wait a moment."),
            "late": RuleFault(
                "1 % of the control loop's periods are longer than {p99:.0f} ms instead of 20 ms.",
                "Give this computer less to do, or more cores.",
                is_advice=True,
            ),
        },
        _loop,
    ),
    PreflightRule(
        "record",
        "The flight is recorded. Only advice, since a record is no matter of safety.",
        "A recorder is on the bus.",
        {
            "none": RuleFault(
                "Nobody records this flight.",
                "Fly it with covey fly, which records, so that you can see afterwards what happened.",
                is_advice=True,
            )
        },
        _record,
    ),
    PreflightRule(
        "kill switch",
        "Somebody holds the radio control and its kill switch, the one way to stop a vehicle without any computer. "
        "Always advice, since no computer can check it.",
        "",
        {
            "heard": RuleFault(
                "PX4 hears a radio control.",
                "Have its kill switch in somebody's hand, and try it today.",
                is_advice=True,
            ),
            "unheard": RuleFault(
                "PX4 hears no radio control: only the computers can stop this vehicle.",
                "Switch the transmitter on and try its kill switch. Without one, keep a net between the vehicles and "
                "people.",
                is_advice=True,
            ),
            "unknown": RuleFault(
                "It is not known whether PX4 hears a radio control.",
                "Have its kill switch in somebody's hand, and try it today.",
                is_advice=True,
            ),
        },
        _kill_switch,
    ),
)
