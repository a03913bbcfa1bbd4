"""The preflight rule about RTK corrections: their source, their base, and the fix. Pure.

The rule returns a key and values for a sentence. The key names a sentence in ``preflight.toml``. It
is under ``[corrections.refuses]`` if the fault refuses a take-off, and under
``[corrections.advises]`` if it is advice.
"""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.corrections import fix
from onboard.corrections.status import STEADY_S, CorrectionsStatus
from onboard.preflight.preflight_facts import PreflightFacts
from onboard.preflight.preflight_rule import OK, SKIP, Judgement, rules
from onboard.safety.failsafe_table import Condition

_CONDITIONS = frozenset({Condition.FIX_COARSE, Condition.FIX_FELL_BACK, Condition.BASE_FAULT})


def _corrections(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    corrections = fleet.corrections
    status = facts.corrections
    if corrections is None or status is None or not fleet.takes_corrections(vehicle):
        return SKIP, {"reason": "for a vehicle that takes no corrections"}

    is_demanded = corrections.fix != "any"
    fix_words = "not told"
    if facts.fix_type is not None:
        fix_words = fix.words_of(facts.fix_type)
    words: dict[str, object] = {
        "fix": fix_words,
        "fleet": fleet.path,
        "age": status.age_s,
        "base": status.base_id,
        "distance": _distance(status),
    }

    if status.has_several_sources:
        return "several sources", words
    if status.base.fault is not None:
        return "base wrong", {**words, "fault": status.base.words}
    if not math.isfinite(status.age_s):
        if is_demanded:
            return "silent", words
        return "silent, not demanded", words
    if status.unsteady_s is not None:
        return "unsteady", {**words, "ago": status.unsteady_s, "steady": STEADY_S}
    if status.base_distance_m > 1000.0 * corrections.max_base_km:
        return "base far", {**words, "most": corrections.max_base_km}
    if status.age_s > corrections.max_age_s:
        words["most"] = corrections.max_age_s
        if is_demanded:
            return "old", words
        return "old, not demanded", words

    is_enough = facts.fix_type is not None and fix.is_enough(facts.fix_type, corrections.fix)
    if is_demanded and not is_enough:
        return "fix too poor", {**words, "demanded": fix.DEMAND_WORDS[corrections.fix]}
    # a condition of the failsafe table may still hold, and would disarm the vehicle at once
    if facts.conditions & _CONDITIONS:
        return "settling", words
    if status.too_long_bytes:
        return "message too long", {**words, "bytes": status.too_long_bytes}
    return OK, words


def _distance(status: CorrectionsStatus) -> str:
    """Return the distance to the base in words."""
    if math.isnan(status.base_distance_m):
        return "at a distance that is not known"
    if status.base_distance_m < 1000.0:
        return f"{status.base_distance_m:.0f} m"
    return f"{status.base_distance_m / 1000.0:.1f} km"


CORRECTIONS_RULES = rules({"corrections": _corrections}, STEADY_S=STEADY_S)
