"""Rules of preflight about the flight to come: neighbours, fleet file, law, throttle, battery,
loop, record. Pure.
"""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.preflight.preflight_facts import PreflightFacts
from onboard.preflight.preflight_rule import FINE, NO_PX4, OK, Judgement, rules

HOVER_SHARE, HOVER_ADVICE_SHARE = 0.25, 0.10
LOWEST_VOLTAGE_V = 2.5
LATE_LOOP_MS = 30.0
# states are sampled at ticks and sent at ticks, and a hundred samples tell a loss by a tenth
DELAY_ALLOWANCE_S, LOSS_ALLOWANCE = 0.04, 0.10


def _neighbours(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    missing = facts.missing_neighbours
    if not missing:
        return _radio(facts, fleet)
    several = len(missing) > 1
    words = {
        "names": ", ".join(missing),
        "are": "are" if several else "is",
        "agents": "agents" if several else "agent",
    }
    return "missing", words


def _radio(facts: PreflightFacts, fleet: FleetConfig) -> Judgement:
    """Compare the delay and the loss with what the fleet file expects."""
    expected, measured, count = fleet.expected_radio, facts.radio, len(fleet.enabled_names) - 1
    if measured is None:
        return OK, {"count": count}
    words = {
        "delayed": measured.delayed,
        "delay": 1e3 * measured.delay_s,
        "lossy": measured.lossy,
        "loss": 100.0 * measured.loss_frac,
        "expected_delay": 1e3 * expected.expected_delay_s,
        "expected_loss": 100.0 * expected.expected_loss_frac,
        "count": count,
    }
    is_late = measured.delay_s > expected.expected_delay_s + DELAY_ALLOWANCE_S
    is_lossy = measured.loss_frac > expected.expected_loss_frac + LOSS_ALLOWANCE
    return ("late" if is_late else "lossy" if is_lossy else OK), words


def _configuration(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    words = {"hash": facts.config_hash}
    if vehicle.enabled is False:
        return "disabled", words
    if facts.other_hashes:
        name, other = next(iter(facts.other_hashes.items()))
        more = f" (and {len(facts.other_hashes) - 1} more)" if len(facts.other_hashes) > 1 else ""
        return "differs", {**words, "names": f"{name}{more}", "other": other}
    return OK, words


def _law(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    # of a fleet that marks none, covey sitl plays all vehicles
    is_emulated = vehicle.emulated or (facts.has_emulator and not fleet.emulated_names)
    if fleet.law.is_own and not is_emulated and not fleet.law.allow_own_law_on_real_vehicles:
        return "own", {"law": fleet.law.name, "name": vehicle.name}
    # the report is part of the record: so the record tells which source flew
    if not facts.law_refusals:
        source = "" if fleet.own_law is None else f" (source {fleet.own_law.source_hash})"
        return OK, {"law": f"{facts.law}{source}"}
    _, sentence, remedy = facts.law_refusals[0]
    words = {"law": facts.law, "finding": sentence, "change": remedy}
    return ("refused" if facts.law not in ("paper", "off") else "baseline"), words


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
    words = {
        "level": 100.0 * facts.battery_frac,
        "volts": facts.battery_voltage_v,
        "required": required_pct,
    }
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


FLIGHT_RULES = rules(
    {
        "neighbours": _neighbours,
        "configuration": _configuration,
        "law": _law,
        "hover thrust": _hover,
        "battery": _battery,
        "loop": _loop,
        "record": _record,
        "kill switch": _kill_switch,
    },
    HOVER_ADVICE_SHARE=HOVER_ADVICE_SHARE,
    HOVER_SHARE=HOVER_SHARE,
    LATE_LOOP_MS=LATE_LOOP_MS,
)
