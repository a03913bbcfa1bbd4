"""Facts, their measured results, and the report that compares both."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from fnmatch import fnmatchcase
from importlib.resources import files

Measured = float | str


class FactVerdict(Enum):
    """Result of comparing an endpoint with one fact."""

    AGREES = "agrees"
    DIFFERS = "differs"
    SKIPPED = "skipped"


@dataclass(frozen=True, slots=True)
class Fact:
    """One thing that a real PX4 does, as it was measured on v1.16.0.

    `versions.toml` says what other versions do.
    """

    name: str  # topic, dot, detail
    section: str  # of the list of measured facts
    says: str  # the fact in words
    # bounds of a number, wide enough for the scatter of a real PX4, and its unit
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    allowed: tuple[str, ...] = ()  # allowed words, when it is not a number

    def accepts(self, measured: Measured) -> bool:
        """Whether a measurement agrees."""
        if self.allowed or isinstance(measured, str):
            return self.show(measured) in self.allowed
        return self.low <= measured <= self.high

    @property
    def expected(self) -> str:
        """The accepted values, in words."""
        if self.allowed:
            return " or ".join(self.allowed)
        if self.low == self.high:
            return self._with_unit(f"{self.low:g}")
        return self._with_unit(f"{self.low:g} to {self.high:g}")

    def show(self, measured: Measured) -> str:
        """Return a measurement in words."""
        if isinstance(measured, str):
            return measured
        if math.isnan(measured):
            return "nothing"
        return self._with_unit(f"{measured:.4g}")

    def _with_unit(self, text: str) -> str:
        if not self.unit:
            return text
        return f"{text} {self.unit}"


def word(name: str, section: str, says: str, *allowed: str) -> Fact:
    """Return a fact that is a word."""
    return Fact(name=name, section=section, says=says, allowed=allowed)


def number(name: str, section: str, says: str, low: float, high: float, unit: str = "") -> Fact:
    """Return a fact that is a number within bounds."""
    return Fact(name=name, section=section, says=says, low=low, high=high, unit=unit)


_TABLE = tomllib.loads(files(__package__).joinpath("facts.toml").read_text(encoding="utf-8"))


def facts(group: str, part: str) -> tuple[Fact, ...]:
    """Return one part of a group of facts in `facts.toml`: words, or numbers within bounds."""
    listed: list[Fact] = []
    for name, (section, says, *values) in _TABLE[group][part].items():
        if isinstance(values[0], str):
            listed.append(word(name, section, says, *values))
        else:
            listed.append(number(name, section, says, *values))
    return tuple(listed)


@dataclass(frozen=True, slots=True)
class FactResult:
    """Result of one fact; `reason` says why nothing could be measured."""

    fact: Fact
    verdict: FactVerdict
    measured: str
    reason: str = ""

    def as_json(self) -> dict[str, str]:
        """Return plain values."""
        return {
            "name": self.fact.name,
            "section": self.fact.section,
            "fact": self.fact.says,
            "expected": self.fact.expected,
            "measured": self.measured,
            "verdict": self.verdict.value,
            "reason": self.reason,
        }


@dataclass(slots=True)
class FactReport:
    """Collects results and shows each at once.

    What is measured before the version is known waits for it.
    """

    facts: dict[str, Fact]  # those that were requested, by name
    show: Callable[[FactResult], None] = lambda result: None  # called with every result
    results: dict[str, FactResult] = field(default_factory=dict)
    is_version_known: bool = True
    _waiting: dict[str, Measured] = field(default_factory=dict)

    def expect(self, facts: Mapping[str, Fact]) -> None:
        """Judge by these facts from now on, and what has waited."""
        self.facts = {name: facts[name] for name in self.facts}
        self.is_version_known = True

        waiting = self._waiting
        self._waiting = {}
        for name, measured in waiting.items():
            self.add(name, measured)

    def wants(self, *patterns: str) -> bool:
        """Whether a fact that matches one of these shell patterns was requested.

        What nobody requested is not flown.
        """
        return any(fnmatchcase(name, pattern) for name in self.facts for pattern in patterns)

    def add(self, name: str, measured: Measured) -> None:
        """Judge one measurement; one of a fact that was not requested is dropped."""
        fact = self.facts.get(name)
        if fact is None:
            return
        if not self.is_version_known:
            self._waiting[name] = measured
            return

        verdict = FactVerdict.AGREES if fact.accepts(measured) else FactVerdict.DIFFERS
        self._file(FactResult(fact, verdict, fact.show(measured)))

    def skip(self, facts: Iterable[Fact], reason: str) -> None:
        """Leave facts out, for a reason that is not the vehicle's."""
        self._unmeasured(facts, FactVerdict.SKIPPED, reason)

    def fail(self, facts: Iterable[Fact], reason: str) -> None:
        """Let facts differ that the vehicle has left unmeasured."""
        self._unmeasured(facts, FactVerdict.DIFFERS, reason)

    def count(self, verdict: FactVerdict) -> int:
        """Return the number of results with this verdict."""
        return sum(1 for result in self.results.values() if result.verdict is verdict)

    def _unmeasured(self, facts: Iterable[Fact], verdict: FactVerdict, reason: str) -> None:
        for fact in facts:
            is_requested = fact.name in self.facts
            is_measured = fact.name in self.results or fact.name in self._waiting
            if is_requested and not is_measured:
                self._file(FactResult(fact, verdict, "nothing", reason))

    def _file(self, result: FactResult) -> None:
        self.results[result.fact.name] = result
        self.show(result)


def matching(facts: Iterable[Fact], patterns: Sequence[str]) -> dict[str, Fact]:
    """Return the facts whose name, or the topic before its dot, matches one of the patterns.

    Without patterns they are all.

    Raises:
        KeyError: a pattern that matches nothing, as its argument.
    """
    facts = tuple(facts)
    if not patterns:
        return {fact.name: fact for fact in facts}

    names: set[str] = set()
    for pattern in patterns:
        matched: list[str] = []
        for fact in facts:
            topic, _, _ = fact.name.partition(".")
            if fnmatchcase(fact.name, pattern) or topic == pattern:
                matched.append(fact.name)
        if not matched:
            raise KeyError(pattern)
        names.update(matched)

    return {fact.name: fact for fact in facts if fact.name in names}


# What facts expect from a version on, where that differs: words, or low and high of a number.
CHANGES: dict[str, dict[str, list[str] | list[float]]] = tomllib.loads(
    files(__package__).joinpath("versions.toml").read_text(encoding="utf-8")
)
VERSIONS: tuple[str, ...] = tuple(CHANGES)  # from the oldest, which the facts themselves describe


def facts_of(version: str, facts: Sequence[Fact]) -> dict[str, Fact]:
    """Return the facts, by name, as they hold for one version.

    Args:
        version: one of VERSIONS.
        facts: facts as they hold for the oldest version.
    """
    by_name = {fact.name: fact for fact in facts}
    for each in VERSIONS[: VERSIONS.index(version) + 1]:
        for pattern, expected in CHANGES[each].items():
            words = tuple(value for value in expected if isinstance(value, str))
            numbers = [value for value in expected if not isinstance(value, str)]
            low, high = numbers or (math.nan, math.nan)
            for name in [name for name in by_name if fnmatchcase(name, pattern)]:
                by_name[name] = replace(by_name[name], allowed=words, low=low, high=high)
    return by_name


def nearest(reported: tuple[int, int] | None) -> tuple[str, str]:
    """Return the version to judge by, and a sentence when it is not the reported one.

    Args:
        reported: major and minor number of AUTOPILOT_VERSION; None when nothing was reported.
    """
    oldest = VERSIONS[0]
    if reported is None:
        return oldest, f"it reports no version and is judged as v{oldest}: --px4 says another"

    version = oldest
    for candidate in VERSIONS:
        if tuple(int(part) for part in candidate.split(".")) <= reported:
            version = candidate

    name = f"{reported[0]}.{reported[1]}"
    if name == version:
        return version, ""
    return version, f"v{name} was never measured: it is judged as v{version}"
