"""Facts about a real PX4, and the report that compares measurements with them."""

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
    """One detail of the behaviour of a real PX4, as measured on v1.16.0.

    `versions.toml` has the differences of other versions.
    """

    name: str  # topic, dot, detail
    section: str  # number of the section of measured facts, for the JSON report only
    says: str  # the fact in words
    # Bounds of a number, wide enough for the scatter of a real PX4, and its unit.
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    allowed: tuple[str, ...] = ()  # allowed words of a fact that is not a number

    def accepts(self, measured: Measured) -> bool:
        """Return whether a measurement agrees with the fact."""
        if self.allowed or isinstance(measured, str):
            return self.show(measured) in self.allowed
        return self.low <= measured <= self.high

    @property
    def expected(self) -> str:
        """The accepted values as text."""
        if self.allowed:
            return " or ".join(self.allowed)
        if self.low == self.high:
            return self._with_unit(f"{self.low:g}")
        return self._with_unit(f"{self.low:g} to {self.high:g}")

    def show(self, measured: Measured) -> str:
        """Return a measurement as text."""
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
    """Return the facts of one part of a group in `facts.toml`: words, or numbers within bounds."""
    part_facts: list[Fact] = []
    for name, (section, says, *values) in _TABLE[group][part].items():
        if isinstance(values[0], str):
            part_facts.append(word(name, section, says, *values))
        else:
            part_facts.append(number(name, section, says, *values))
    return tuple(part_facts)


@dataclass(frozen=True, slots=True)
class FactResult:
    """Result of one fact."""

    fact: Fact
    verdict: FactVerdict
    measured: str
    reason: str = ""  # reason why nothing could be measured

    def as_json(self) -> dict[str, str]:
        """Return the result for a JSON file."""
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
    """Results of the requested facts, each of which is shown at once.

    Measurements before the version is known wait until it is known.
    """

    facts: dict[str, Fact]  # requested facts by name
    show: Callable[[FactResult], None] = lambda result: None  # called with every result
    results: dict[str, FactResult] = field(default_factory=dict)
    is_version_known: bool = True
    _waiting: dict[str, Measured] = field(default_factory=dict)

    def expect(self, facts: Mapping[str, Fact]) -> None:
        """Judge the waiting measurements and all later ones by the facts of a version."""
        self.facts = {name: facts[name] for name in self.facts}
        self.is_version_known = True

        waiting = self._waiting
        self._waiting = {}
        for name, measured in waiting.items():
            self.add(name, measured)

    def wants(self, *patterns: str) -> bool:
        """Return whether a requested fact matches one of these shell patterns.

        A flight for facts that nobody requested can then be left out.
        """

        def is_wanted(name: str) -> bool:
            return any(fnmatchcase(name, pattern) for pattern in patterns)

        return any(is_wanted(name) for name in self.facts)

    def add(self, name: str, measured: Measured) -> None:
        """Judge one measurement; it is dropped if its fact was not requested."""
        fact = self.facts.get(name)
        if fact is None:
            return
        if not self.is_version_known:
            self._waiting[name] = measured
            return

        verdict = FactVerdict.DIFFERS
        if fact.accepts(measured):
            verdict = FactVerdict.AGREES
        self._record(FactResult(fact, verdict, fact.show(measured)))

    def skip(self, facts: Iterable[Fact], reason: str) -> None:
        """Report facts as skipped that could not be measured, through no fault of the vehicle."""
        self._unmeasured(facts, FactVerdict.SKIPPED, reason)

    def fail(self, facts: Iterable[Fact], reason: str) -> None:
        """Report facts as different that could not be measured because of the vehicle."""
        self._unmeasured(facts, FactVerdict.DIFFERS, reason)

    def count(self, verdict: FactVerdict) -> int:
        """Return the number of results with this verdict."""
        return sum(1 for result in self.results.values() if result.verdict is verdict)

    def _unmeasured(self, facts: Iterable[Fact], verdict: FactVerdict, reason: str) -> None:
        for fact in facts:
            is_requested = fact.name in self.facts
            is_measured = fact.name in self.results or fact.name in self._waiting
            if is_requested and not is_measured:
                self._record(FactResult(fact, verdict, "nothing", reason))

    def _record(self, result: FactResult) -> None:
        self.results[result.fact.name] = result
        self.show(result)


def matching(facts: Iterable[Fact], patterns: Sequence[str]) -> dict[str, Fact]:
    """Return the facts whose name, or the topic before its dot, matches one of the patterns.

    Without patterns all facts are returned.

    Raises:
        KeyError: a pattern matches nothing; the pattern is the argument of the error.
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


# Facts that change with a version: allowed words, or the low and high bounds of a number.
CHANGES: dict[str, dict[str, list[str] | list[float]]] = tomllib.loads(
    files(__package__).joinpath("versions.toml").read_text(encoding="utf-8")
)
VERSIONS: tuple[str, ...] = tuple(CHANGES)  # oldest first; facts.toml describes the oldest


def facts_of(version: str, facts: Sequence[Fact]) -> dict[str, Fact]:
    """Return the facts of one version by name.

    Args:
        version: version in VERSIONS.
        facts: facts of the oldest version.
    """
    by_name = {fact.name: fact for fact in facts}
    for changed_version in VERSIONS[: VERSIONS.index(version) + 1]:
        for pattern, expected in CHANGES[changed_version].items():
            words = tuple(value for value in expected if isinstance(value, str))
            numbers = [value for value in expected if not isinstance(value, str)]
            low = high = math.nan
            if numbers:
                low, high = numbers
            for name, fact in by_name.items():
                if fnmatchcase(name, pattern):
                    by_name[name] = replace(fact, allowed=words, low=low, high=high)
    return by_name


def nearest(reported: tuple[int, int] | None) -> tuple[str, str]:
    """Return the version to judge by, and a sentence when it differs from the reported version.

    Args:
        reported: major and minor number of AUTOPILOT_VERSION; None when nothing was reported.
    """
    oldest = VERSIONS[0]
    if reported is None:
        return oldest, f"it reports no version and is judged as v{oldest}: --px4 says another"

    major, minor = reported
    version = oldest
    for candidate in VERSIONS:
        if tuple(int(part) for part in candidate.split(".")) <= reported:
            version = candidate

    name = f"{major}.{minor}"
    if name == version:
        return version, ""
    return version, f"v{name} was never measured: it is judged as v{version}"
