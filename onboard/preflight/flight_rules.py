"""Rules of preflight about the coming flight. Pure.

The rules are about neighbours, fleet file, law, throttle, battery, loop and record.

Each rule returns a key and values for a sentence. The key names a sentence in ``preflight.toml``.
It is under ``[RULE.refuses]`` if the fault refuses a take-off, and under ``[RULE.advises]`` if it
is advice.
"""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.preflight.preflight_facts import PreflightFacts
from onboard.preflight.preflight_rule import NO_PX4, OK, PASSED, SKIP, Judgement, rules
from onboard.security.certificate_times import SOON_S, left_words, required_validity_s

# A larger difference of the hover throttle refuses a take-off. The estimate differs by 0.2 at most.
HOVER_SHARE = 0.18
HOVER_ADVICE_SHARE = 0.10  # a larger difference of the hover throttle is reported as advice
LOWEST_VOLTAGE_V = 2.5
LATE_LOOP_MS = 30.0  # longest 99th percentile of the control loop's period

# Allowed differences from the fleet file's expected delay and loss. States are sent and sampled at
# ticks, and a loss measured from a hundred samples has an error of a tenth.
DELAY_ALLOWANCE_S = 0.04
LOSS_ALLOWANCE = 0.10


def _neighbours(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    missing = facts.missing_neighbours
    lost = facts.lost_neighbours
    if missing:
        names = ", ".join(missing)
        if len(missing) == 1:
            return "missing", {"names": names, "are": "is", "agents": "agent"}
        return "missing", {"names": names, "are": "are", "agents": "agents"}

    if lost:
        names = ", ".join(lost)
        if len(lost) == 1:
            return "lost", {"names": names, "do": "does", "its": "its"}
        return "lost", {"names": names, "do": "do", "its": "their"}
    return _radio(facts, fleet)


def _radio(facts: PreflightFacts, fleet: FleetConfig) -> Judgement:
    """Compare delay and loss with those that the fleet file expects."""
    expected = fleet.expected_radio
    measured = facts.radio
    count = len(fleet.enabled_names) - 1
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
    if measured.delay_s > expected.expected_delay_s + DELAY_ALLOWANCE_S:
        return "late", words
    if measured.loss_frac > expected.expected_loss_frac + LOSS_ALLOWANCE:
        return "lossy", words
    return OK, words


def _people(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not fleet.people:
        return SKIP, {"reason": "for a fleet file without people"}
    if not facts.people_m:
        return OK, {"nearest": "No person is seen."}

    name = min(facts.people_m, key=facts.people_m.__getitem__)
    distance_m = max(0.0, facts.people_m[name])  # 0 for a person who stands over it
    required_m = fleet.fleet.safety_distance_m
    if distance_m < required_m:
        return "too near", {"name": name, "distance": distance_m, "required": required_m}
    return OK, {"nearest": f"The nearest person, {name}, is {distance_m:.1f} m away."}


def _configuration(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    words = {"hash": facts.config_hash}
    if vehicle.enabled is False:
        return "disabled", words
    if not facts.other_hashes:
        return OK, words

    name, other_hash = next(iter(facts.other_hashes.items()))
    names = name
    if len(facts.other_hashes) > 1:
        names = f"{name} (and {len(facts.other_hashes) - 1} more)"
    return "differs", {**words, "names": names, "other": other_hash}


def _certificates(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.certificate_left is None:
        return SKIP, {"reason": "for a bus without keys"}

    node, left_s = facts.certificate_left
    required_s = required_validity_s(vehicle)
    words = {
        "node": node,
        "left": left_words(left_s),
        "required": left_words(required_s),
        "fleet": fleet.path,
    }
    if left_s <= 0.0:
        return "ended", words
    if left_s < required_s:
        return "ends too soon", words
    if left_s < SOON_S:
        return "soon", words
    return OK, words


def _law(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    # if the fleet file marks no vehicle as emulated, an emulator (covey sitl) emulates all of them
    is_emulated = vehicle.emulated or (facts.has_emulator and not fleet.emulated_names)
    may_fly_own = is_emulated or fleet.law.allow_own_law_on_real_vehicles
    if fleet.law.is_own and not may_fly_own:
        return "own law", {"law": fleet.law.name, "name": vehicle.name}
    if fleet.law.changed_policies and not is_emulated:
        keys = ", ".join(f"law.{name}" for name in fleet.law.changed_policies)
        return "changed policies", {"keys": keys, "name": vehicle.name}

    if not facts.law_refusals:
        if fleet.own_law is None:
            return OK, {"law": facts.law}
        # with the hash of the source, so that the record shows which law flew
        return OK, {"law": f"{facts.law} (source {fleet.own_law.source_hash})"}

    _, sentence, remedy = facts.law_refusals[0]
    words = {"law": facts.law, "finding": sentence, "change": remedy}
    if facts.law in ("paper", "off"):
        return "comparison only", words
    return "refused", words


def _hover(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    learned_frac = facts.hover_frac
    file_frac = vehicle.hover_thrust_frac
    if not math.isfinite(learned_frac):
        return OK, {"learned": file_frac, "file": file_frac}

    words = {"learned": learned_frac, "file": file_frac}
    share = abs(learned_frac / file_frac - 1.0)
    if share > HOVER_SHARE:
        return "far off", words
    if share > HOVER_ADVICE_SHARE:
        return "off", words
    return OK, words


def _battery(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4

    level_pct = 100.0 * facts.battery_frac
    required_pct = fleet.fleet.battery_warning_pct
    words = {"level": level_pct, "volts": facts.battery_voltage_v, "required": required_pct}
    if not math.isfinite(facts.battery_frac):
        return "unknown", words
    if not 0.0 <= facts.battery_frac <= 1.0 or facts.battery_voltage_v < LOWEST_VOLTAGE_V:
        return "implausible", words
    if level_pct < required_pct:
        return "low", words
    return OK, words


def _loop(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.is_law_warm:
        return "warming", {}
    words = {"p99": facts.loop_p99_ms}
    if facts.loop_p99_ms > LATE_LOOP_MS:
        return "late", words
    return OK, words


def _record(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_recorder:
        return PASSED
    return "no recorder", {}


def _kill_switch(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_rc is None:
        return "unknown", {}
    if facts.has_rc:
        return "heard", {}
    return "unheard", {}


FLIGHT_RULES = rules(
    {
        "neighbours": _neighbours,
        "people": _people,
        "configuration": _configuration,
        "certificates": _certificates,
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
