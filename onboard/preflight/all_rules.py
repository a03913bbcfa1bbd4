"""The preflight check: all rules that must be passed before a take-off. Pure.

Each rule checks the facts. The rule passes, cannot be checked yet, or finds one of its faults. A
fault refuses a take-off, unless it is only advice. Sentences and remedies are in preflight.toml.
docs/preflight.md is generated from them, so a refused order uses the same words as that page.
"""

from __future__ import annotations

from collections.abc import Collection

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.preflight.autopilot_rules import AUTOPILOT_RULES
from onboard.preflight.corrections_rules import CORRECTIONS_RULES
from onboard.preflight.flight_rules import FLIGHT_RULES
from onboard.preflight.position_rules import POSITION_RULES
from onboard.preflight.preflight_facts import PreflightFacts
from onboard.preflight.preflight_rule import OK, SKIP, PreflightCheck, PreflightRule

RULES: tuple[PreflightRule, ...] = (
    *AUTOPILOT_RULES,
    *POSITION_RULES,
    *CORRECTIONS_RULES,
    *FLIGHT_RULES,
)


def checks(
    facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle
) -> tuple[PreflightCheck, ...]:
    """Return the results of all rules, in the order of RULES.

    Args:
        facts: about the vehicle, at one tick.
        fleet: the fleet file.
        vehicle: the vehicle of that file.
    """
    return tuple(rule.check(facts, fleet, vehicle) for rule in RULES)


def reasons(
    facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle, only: Collection[str] | None = None
) -> tuple[str, ...]:
    """Return the reasons that refuse a take-off.

    Args:
        facts: facts about the vehicle, at one tick.
        fleet: the fleet file.
        vehicle: the vehicle, from that file.
        only: names of the rules to check; None: all rules.
    Returns:
        Sentence and remedy of each fault, in the order of RULES; empty if no rule refuses.
    """
    refusals = []
    for rule in RULES:
        if only is not None and rule.name not in only:
            continue

        # this runs ten times a second, so sentences are composed only for faults
        key, _ = rule.judge(facts, fleet, vehicle)
        if key not in (OK, SKIP) and not rule.faults[key].is_advice:
            check = rule.check(facts, fleet, vehicle)
            refusals.append(f"{check.sentence} {check.remedy}")
    return tuple(refusals)
