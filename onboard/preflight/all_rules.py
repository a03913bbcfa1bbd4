"""Go or no-go: everything that must be true before take-off. Pure.

A rule judges the facts: they are fine, cannot be judged yet, or show one of the rule's faults. A
fault refuses take-off, unless it is advice. Sentences and remedies stand in preflight.toml, so that
docs/preflight.md is printed from them and an order is refused in the words of the preflight page.
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
    """Return the answers of all rules, in the order of the table.

    Args:
        facts: about the vehicle, at one tick.
        fleet: the fleet file.
        vehicle: the vehicle of that file.
    """
    return tuple(rule.check(facts, fleet, vehicle) for rule in RULES)


def reasons(
    facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle, only: Collection[str] | None = None
) -> tuple[str, ...]:
    """Return what refuses take-off.

    Args:
        facts: about the vehicle, at one tick.
        fleet: the fleet file.
        vehicle: the vehicle of that file.
        only: names of the rules to judge; all by default.
    Returns:
        sentence and remedy of each refusal, in the order of the table; empty when nothing refuses.
    """
    refusals = []
    for rule in RULES:
        if only is not None and rule.name not in only:
            continue

        # the words are put together only where they are needed: this is judged ten times a second
        key, _ = rule.judge(facts, fleet, vehicle)
        if key not in (OK, SKIP) and not rule.faults[key].is_advice:
            check = rule.check(facts, fleet, vehicle)
            refusals.append(f"{check.sentence} {check.remedy}")
    return tuple(refusals)
