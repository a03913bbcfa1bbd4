"""One preflight rule: its check of the facts, and the sentence for each result. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.toml_reading import package_table
from onboard.preflight.preflight_facts import PreflightFacts
from onboard.tuples import Xyz

_WORDS = package_table("onboard.preflight", "preflight.toml")

# keys of results that are not faults
OK = "ok"
SKIP = "skip"

# the key of the result (OK, SKIP or a fault's key), and the values for its sentence
Judgement = tuple[str, Mapping[str, object]]
PreflightJudge = Callable[[PreflightFacts, FleetConfig, Vehicle], Judgement]

# results that several rules share: passed, and skipped with the reason
PASSED: Judgement = (OK, {})
NO_PX4: Judgement = (SKIP, {"reason": "while PX4 is silent"})
NO_POSITION: Judgement = (SKIP, {"reason": "without a fresh position"})
NO_MOCAP: Judgement = (SKIP, {"reason": "for a vehicle that flies on PX4's own position"})
OWN_FRAME: Judgement = (SKIP, {"reason": "for a vehicle whose frame begins where it stands"})


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """Result of one rule, in words."""

    name: str
    is_ok: bool  # False: the result refuses a take-off
    sentence: str
    remedy: str = ""  # if is_ok, a remedy is advice


@dataclass(frozen=True, slots=True)
class RuleFault:
    """One fault that a rule can find, with templates of sentence and remedy."""

    sentence: str
    remedy: str
    is_advice: bool = False  # True: it does not refuse a take-off


@dataclass(frozen=True, slots=True)
class PreflightRule:
    """One line of the preflight page."""

    name: str
    demand: str  # what must be true, for docs/preflight.md
    passes: str  # template of the sentence for a passed rule
    faults: Mapping[str, RuleFault]  # key of a result -> fault
    judge: PreflightJudge

    def check(self, facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> PreflightCheck:
        """Return the rule's result in words.

        Args:
            facts: facts about the vehicle, at one tick.
            fleet: the fleet file.
            vehicle: the vehicle, from that file.
        """
        key, values = self.judge(facts, fleet, vehicle)
        words = {
            "name": vehicle.name,
            "autopilot": vehicle.autopilot,
            "body": vehicle.body,
            **values,
        }
        if key == OK:
            return PreflightCheck(self.name, is_ok=True, sentence=self.passes.format(**words))
        if key == SKIP:
            sentence = "Not judged {reason}.".format(**words)
            return PreflightCheck(self.name, is_ok=True, sentence=sentence)

        fault = self.faults[key]
        return PreflightCheck(
            name=self.name,
            is_ok=fault.is_advice,
            sentence=fault.sentence.format(**words),
            remedy=fault.remedy.format(**words),
        )


def coordinates(position: Xyz) -> str:
    """Return a position for a sentence, for instance "(1.00, 2.00, 0.00) m".

    Args:
        position: ENU [m].
    """
    return "(" + ", ".join(f"{value:.2f}" for value in position) + ") m"


def rules(judges: Mapping[str, PreflightJudge], **constants: float) -> tuple[PreflightRule, ...]:
    """Return rules with their sentences from preflight.toml.

    Args:
        judges: name of a rule -> function that checks the facts, in the order of the page.
        constants: values for the templates of the demands.
    """
    preflight_rules = []
    for name, judge in judges.items():
        row = _WORDS[name]
        faults = {}
        for key, (sentence, remedy) in row.get("refuses", {}).items():
            faults[key] = RuleFault(sentence, remedy)
        for key, (sentence, remedy) in row.get("advises", {}).items():
            faults[key] = RuleFault(sentence, remedy, is_advice=True)

        preflight_rules.append(
            PreflightRule(
                name=name,
                demand=row["demand"].format(**constants),
                passes=row["passes"],
                faults=faults,
                judge=judge,
            )
        )
    return tuple(preflight_rules)
