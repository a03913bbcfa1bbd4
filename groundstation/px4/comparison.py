"""What another version of PX4 changes for a fleet: demanded parameters, defaults, failsafes, other
measured facts.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import groupby
from typing import Any

from onboard.autopilot import Version
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle
from onboard.config.toml_reading import package_table
from onboard.preflight.attitude_lag import lag_s
from onboard.px4.required_params import RequiredParam, Value, all_params
from sitl.conformance.facts import VERSIONS, facts_of, nearest
from sitl.conformance.suite import FACTS

_WIDTH, _SHOWN = 118, 8
_ROWS: list[dict[str, Any]] = package_table(__package__, "comparison.toml")["row"]
_PARAMETERS = package_table("sitl.conformance", "parameters.toml")
_GROUPS = {
    "failsafe": "Failsafes",
    "attitude": "Attitude",
    "link": "Messages, answers and other behaviour",
}


@dataclass(frozen=True, slots=True)
class ChangedFact:
    """One measured fact that differs between the versions."""

    name: str
    says: str
    group: str
    before: str
    after: str
    meaning: str
    concerns: tuple[str, ...]  # vehicles that it matters to


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two versions of PX4, for one fleet."""

    old: str  # as asked for
    new: str
    vehicles: tuple[str, ...]
    notes: tuple[str, ...]  # versions that nobody measured, and other remarks
    parameters: tuple[str, ...]  # sentences
    facts: tuple[ChangedFact, ...] = field(default=())


def compare(fleet: FleetConfig, old: str, new: str) -> Comparison:
    """Compare two versions for all enabled vehicles.

    Args:
        fleet: the fleet file.
        old: version that flies now.
        new: version to fly.

    Raises:
        ConfigError: one is no version.
    """
    first, second = _version(old), _version(new)
    (old_name, old_note), (new_name, new_note) = nearest(first), nearest(second)
    vehicles = [fleet.vehicles[name] for name in fleet.enabled_names]
    notes = [note[0].upper() + note[1:] + "." for note in (old_note, new_note) if note]
    passed = _versions_between(old_name, new_name)
    parameters = [
        *_demands(vehicles, first, second),
        *_gone(vehicles, passed, second),
        *_defaults(vehicles, passed, second, is_back=first > second),
    ]
    notes += _identified(vehicles, new_name)
    facts = _facts(vehicles, old_name, new_name, second)
    return Comparison(old, new, fleet.enabled_names, tuple(notes), tuple(parameters), tuple(facts))


def _version(text: str) -> Version:
    match = re.fullmatch(r"v?(\d{1,2})\.(\d{1,3})(\.\d+.*)?", text)
    if match is None:
        raise ConfigError(
            f"'{text}' is no version of PX4. Write it as 1.16; measured are {', '.join(VERSIONS)}."
        )
    return int(match[1]), int(match[2])


def _versions_between(old: str, new: str) -> list[str]:
    """Return the versions whose changes lie between two, the older one left out."""
    first, last = sorted((VERSIONS.index(old), VERSIONS.index(new)))
    return list(VERSIONS[first + 1 : last + 1])


def _by_vehicle(
    vehicles: Sequence[Vehicle], rows_of: Callable[[Vehicle], Iterable[str]]
) -> list[str]:
    """Return each sentence once, with the vehicles that it holds for unless it holds for all."""
    names: dict[str, list[str]] = {}
    for vehicle in vehicles:
        for sentence in rows_of(vehicle):
            names.setdefault(sentence, []).append(vehicle.name)
    return [
        sentence if len(of) == len(vehicles) else f"{', '.join(of)}: {sentence}"
        for sentence, of in names.items()
    ]


def _demanded(vehicle: Vehicle, version: Version) -> dict[str, RequiredParam]:
    return {demand.name: demand for demand in all_params(vehicle, version)}


def _demands(vehicles: Sequence[Vehicle], old: Version, new: Version) -> list[str]:
    def rows(vehicle: Vehicle) -> Iterable[str]:
        before, after = _demanded(vehicle, old), _demanded(vehicle, new)
        for name in before.keys() - after.keys():
            yield f"{name} = {before[name].value:g} is demanded no more."
        for name in after.keys() - before.keys():
            yield f"{name} = {after[name].value:g} is demanded from now on: {after[name].reason}."

    return _by_vehicle(vehicles, rows)


def _gone(vehicles: Sequence[Vehicle], passed: Sequence[str], new: Version) -> list[str]:
    gone = {
        name: version for version in passed for name in _PARAMETERS.get(version, {}).get("gone", ())
    }

    def rows(vehicle: Vehicle) -> Iterable[str]:
        for name in vehicle.px4_params:
            if name in gone:
                yield f"{name} of the fleet file's px4_params is gone in v{gone[name]}: take-off would be refused."

    return _by_vehicle(vehicles, rows)


def _defaults(
    vehicles: Sequence[Vehicle], passed: Sequence[str], new: Version, *, is_back: bool
) -> list[str]:
    changed: dict[str, tuple[Value, Value]] = {}
    for version in passed:
        for name, (before, after) in _PARAMETERS.get(version, {}).get("defaults", {}).items():
            changed[name] = (changed[name][0] if name in changed else before, after)

    def rows(vehicle: Vehicle) -> Iterable[str]:
        demanded = _demanded(vehicle, new)
        for name, values in changed.items():
            before, after = reversed(values) if is_back else values
            kept = (
                f"; the fleet demands {demanded[name].value:g}, so nothing changes"
                if name in demanded
                else ""
            )
            yield f"{name} comes as {after:g} instead of {before:g}{kept}."

    return _by_vehicle(vehicles, rows)


def _identified(vehicles: Sequence[Vehicle], new: str) -> list[str]:
    """Sentences on attitude values that were identified with another version."""

    def rows(vehicle: Vehicle) -> Iterable[str]:
        if vehicle.px4_version == new:
            return
        before_s, after_s = (
            lag_s(_version(name), vehicle.px4_params) for name in (vehicle.px4_version, new)
        )
        head = f"The attitude values of type '{vehicle.type}' were identified with v{vehicle.px4_version}. "
        if abs(after_s - before_s) > LAG_ERROR_S:
            yield (
                f"{head}With v{new} the attitude lags by {after_s:.2f} s instead of {before_s:.2f} s and take-off is "
                "refused: identify the vehicle anew (covey identify), and set px4_version."
            )
        else:
            yield f"{head}With v{new} the attitude lags alike ({after_s:.2f} s): set px4_version."

    return _by_vehicle(vehicles, rows)


def _facts(
    vehicles: Sequence[Vehicle], old: str, new: str, version: Version
) -> Iterable[ChangedFact]:
    before, after = facts_of(old, FACTS), facts_of(new, FACTS)
    for name, fact in after.items():
        if fact.expected == before[name].expected:
            continue
        row = next(
            row for row in _ROWS if any(fnmatchcase(name, pattern) for pattern in row["facts"])
        )
        concerns = tuple(vehicle.name for vehicle in vehicles if _concerns(row, vehicle, version))
        yield ChangedFact(
            name,
            fact.says,
            row["group"],
            _shown(before[name].expected),
            _shown(fact.expected),
            row["says"],
            concerns,
        )


def _concerns(row: dict[str, Any], vehicle: Vehicle, version: Version) -> bool:
    if row.get("is_harmless", False):
        return False
    demand = _demanded(vehicle, version).get(row.get("parameter", ""))
    return demand is None or demand.value not in row["values"]


def _shown(expected: str) -> str:
    return "nothing" if expected.startswith("nan") else expected


def as_text(found: Comparison) -> str:
    """The comparison for people."""
    lines = [
        f"PX4 v{found.old.removeprefix('v')} to v{found.new.removeprefix('v')}, for {', '.join(found.vehicles)}."
    ]
    lines += _wrapped(found.notes, "  ! ")
    lines.append("Parameters")
    lines += _wrapped(found.parameters or ("nothing changes.",), "  ")
    for group, title in _GROUPS.items():
        lines.append(title)
        facts = [fact for fact in found.facts if fact.group == group]
        facts.sort(key=lambda fact: (not fact.concerns, fact.meaning))
        if not facts:
            lines.append("  nothing changes.")
        for (meaning, concerns), of_meaning in groupby(
            facts, key=lambda fact: (fact.meaning, fact.concerns)
        ):
            whom = "concerns " + ("all" if concerns == found.vehicles else ", ".join(concerns))
            lines += _wrapped(
                [f"{meaning} ({whom if concerns else 'does not concern this fleet'}):"], "  "
            )
            rows = [
                f"{fact.name}: {fact.before} -> {fact.after} ({fact.says})" for fact in of_meaning
            ]
            more = (
                [f"and {len(rows) - _SHOWN} more: --json lists them"] if len(rows) > _SHOWN else []
            )
            lines += _wrapped([*rows[:_SHOWN], *more], "    ")
    return "\n".join(lines)


def _wrapped(sentences: Iterable[str], indent: str) -> list[str]:
    return [
        line
        for sentence in sentences
        for line in textwrap.wrap(
            sentence, _WIDTH, initial_indent=indent, subsequent_indent=" " * (len(indent) + 2)
        )
    ]


def as_mapping(found: Comparison) -> dict[str, Any]:
    """The same for programs."""
    return {
        "old": found.old,
        "new": found.new,
        "notes": list(found.notes),
        "parameters": list(found.parameters),
        "facts": [
            {
                "name": fact.name,
                "says": fact.says,
                "group": fact.group,
                "before": fact.before,
                "after": fact.after,
                "meaning": fact.meaning,
                "concerns": list(fact.concerns),
            }
            for fact in found.facts
        ],
    }
