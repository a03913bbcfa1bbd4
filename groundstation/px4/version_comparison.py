"""The comparison of two versions of PX4 for a fleet.

Four things can change: the parameters that the fleet demands, the parameters and defaults of PX4,
the lag of a vehicle's attitude, and other measured facts about PX4, such as its failsafes. The
caller passes the measurements (:class:`MeasuredPx4`). The table ``comparison.toml`` says what each
measured fact means for a fleet, and which vehicles it concerns.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from itertools import groupby
from typing import Any, NamedTuple, Protocol

from onboard.autopilot import Version
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle
from onboard.config.toml_reading import package_table
from onboard.plain_text import capitalised
from onboard.preflight.attitude_lag import lag_s
from onboard.px4.required_params import RequiredParam, Value, all_params

_WIDTH = 118
_MAX_SHOWN = 8  # facts of one meaning in the text; --json has all
_ROWS: list[dict[str, Any]] = package_table(__package__, "comparison.toml")["row"]
_GROUPS = {
    "failsafe": "Failsafes",
    "attitude": "Attitude",
    "link": "Messages, answers and other behaviour",
}


class MeasuredFact(Protocol):
    """One fact about one version of PX4."""

    @property
    def says(self) -> str:
        """The subject of the measurement, in words."""

    @property
    def expected(self) -> str:
        """The outcome of the measurement."""


class MeasuredPx4(NamedTuple):
    """Measurements of the versions of PX4."""

    versions: tuple[str, ...]  # measured versions, the oldest first
    # any version -> the nearest measured one, and a sentence if that is another version
    nearest: Callable[[Version], tuple[str, str]]
    # measured version -> facts by name
    facts_of: Callable[[str], Mapping[str, MeasuredFact]]
    # measured version -> its removed parameters, and its changed defaults (before, after)
    parameters: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class ChangedFact:
    """One measured fact that differs between the versions."""

    name: str
    says: str  # subject of the measurement
    group: str
    before: str
    after: str
    meaning: str  # what it means for a fleet
    concerns: tuple[str, ...]  # names of the vehicles for which it matters


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two versions of PX4, for one fleet."""

    old: str  # versions as the user has written them
    new: str
    vehicles: tuple[str, ...]
    notes: tuple[str, ...]  # remarks, for instance about a version that was not measured
    parameters: tuple[str, ...]  # sentences about changed parameters
    facts: tuple[ChangedFact, ...]


def compare(fleet: FleetConfig, old: str, new: str, measured: MeasuredPx4) -> Comparison:
    """Compare two versions for all enabled vehicles.

    Args:
        fleet: the fleet file.
        old: version that flies now.
        new: version to fly.
        measured: measurements of the versions of PX4.

    Raises:
        ConfigError: one of the texts is not a version.
    """
    old_version = _version(old, measured)
    new_version = _version(new, measured)
    old_name, old_note = measured.nearest(old_version)
    new_name, new_note = measured.nearest(new_version)
    vehicles = _enabled(fleet)

    notes = []
    for note in (old_note, new_note):
        if note:
            notes.append(f"{capitalised(note)}.")
    notes += _lag_notes(vehicles, new_name, measured)

    steps = _versions_between(old_name, new_name, measured)
    is_downgrade = old_version > new_version
    parameters = [
        *_changed_demands(fleet, old_version, new_version),
        *_gone_parameters(vehicles, steps, measured),
        *_changed_defaults(fleet, steps, new_version, measured, is_downgrade=is_downgrade),
    ]
    return Comparison(
        old=old,
        new=new,
        vehicles=fleet.enabled_names,
        notes=tuple(notes),
        parameters=tuple(parameters),
        facts=tuple(_changed_facts(fleet, old_name, new_name, new_version, measured)),
    )


def _version(text: str, measured: MeasuredPx4) -> Version:
    match = re.fullmatch(r"v?(\d{1,2})\.(\d{1,3})(\.\d+.*)?", text)
    if match is None:
        known = ", ".join(measured.versions)
        raise ConfigError(f"'{text}' is no version of PX4. Write it as 1.16; measured are {known}.")
    return int(match[1]), int(match[2])


def _versions_between(old: str, new: str, measured: MeasuredPx4) -> tuple[str, ...]:
    """Return the versions from one to the other, without the older of the two.

    The changes that each of these versions brought, taken together, separate old from new.
    """
    first, last = sorted((measured.versions.index(old), measured.versions.index(new)))
    return measured.versions[first + 1 : last + 1]


def _by_vehicle(
    vehicles: Sequence[Vehicle], sentences_of: Callable[[Vehicle], Iterable[str]]
) -> list[str]:
    """Return each sentence once; one that is not true for all vehicles names those it is about."""
    names: dict[str, list[str]] = {}
    for vehicle in vehicles:
        for sentence in sentences_of(vehicle):
            names.setdefault(sentence, []).append(vehicle.name)

    result = []
    for sentence, concerned in names.items():
        if len(concerned) == len(vehicles):
            result.append(sentence)
        else:
            result.append(f"{', '.join(concerned)}: {sentence}")
    return result


def _enabled(fleet: FleetConfig) -> list[Vehicle]:
    return [fleet.vehicles[name] for name in fleet.enabled_names]


def _demanded(fleet: FleetConfig, vehicle: Vehicle, version: Version) -> dict[str, RequiredParam]:
    return {demand.name: demand for demand in all_params(fleet, vehicle, version)}


def _changed_demands(fleet: FleetConfig, old: Version, new: Version) -> list[str]:
    """Return sentences about parameters that are demanded with only one of the versions."""

    def sentences(vehicle: Vehicle) -> Iterator[str]:
        before = _demanded(fleet, vehicle, old)
        after = _demanded(fleet, vehicle, new)
        for name in sorted(before.keys() - after.keys()):
            yield f"{name} = {before[name].value:g} is demanded no more."
        for name in sorted(after.keys() - before.keys()):
            yield f"{name} = {after[name].value:g} is demanded from now on: {after[name].reason}."

    return _by_vehicle(_enabled(fleet), sentences)


def _gone_parameters(
    vehicles: Sequence[Vehicle], steps: Sequence[str], measured: MeasuredPx4
) -> list[str]:
    """Return sentences about parameters of the fleet file that PX4 no longer has."""
    gone_with = {}
    for version in steps:
        for name in measured.parameters.get(version, {}).get("gone", ()):
            gone_with[name] = version

    def sentences(vehicle: Vehicle) -> Iterator[str]:
        for name in vehicle.px4_params:
            if name in gone_with:
                yield (
                    f"{name} of the fleet file's px4_params is gone in v{gone_with[name]}:"
                    " take-off would be refused."
                )

    return _by_vehicle(vehicles, sentences)


def _changed_defaults(
    fleet: FleetConfig,
    steps: Sequence[str],
    new: Version,
    measured: MeasuredPx4,
    *,
    is_downgrade: bool,
) -> list[str]:
    """Return sentences about defaults of PX4 that differ.

    Args:
        fleet: the fleet file.
        steps: the versions from one to the other, without the older one.
        new: version to fly.
        measured: measurements of the versions of PX4.
        is_downgrade: whether the new version is the older one.
    """
    # if a default changes in several versions, only its first and its last value count
    changed: dict[str, tuple[Value, Value]] = {}
    for version in steps:
        defaults = measured.parameters.get(version, {}).get("defaults", {})
        for name, (older, newer) in defaults.items():
            if name in changed:
                older, _ = changed[name]
            changed[name] = (older, newer)

    def sentences(vehicle: Vehicle) -> Iterator[str]:
        demanded = _demanded(fleet, vehicle, new)
        for name, (older, newer) in changed.items():
            before = older
            after = newer
            if is_downgrade:
                before = newer
                after = older

            effect = ""
            if name in demanded:
                effect = f"; the fleet demands {demanded[name].value:g}, so nothing changes"
            yield f"{name} comes as {after:g} instead of {before:g}{effect}."

    return _by_vehicle(_enabled(fleet), sentences)


def _lag_notes(vehicles: Sequence[Vehicle], new_name: str, measured: MeasuredPx4) -> list[str]:
    """Return sentences about attitude values that were identified with another version.

    Args:
        vehicles: vehicles of the fleet.
        new_name: the measured version that is nearest to the version to fly.
        measured: measurements of the versions of PX4.
    """

    def sentences(vehicle: Vehicle) -> Iterator[str]:
        identified = vehicle.px4_version
        if identified == new_name:
            return
        before_s = lag_s(_version(identified, measured), vehicle.px4_params)
        after_s = lag_s(_version(new_name, measured), vehicle.px4_params)

        head = f"The attitude values of type '{vehicle.type}' were identified with v{identified}."
        if abs(after_s - before_s) > LAG_ERROR_S:
            yield (
                f"{head} With v{new_name} the attitude lags by {after_s:.2f} s instead of"
                f" {before_s:.2f} s and take-off is refused: identify the vehicle anew"
                " (covey identify), and set px4_version."
            )
        else:
            yield (
                f"{head} With v{new_name} the attitude lags alike ({after_s:.2f} s):"
                " set px4_version."
            )

    return _by_vehicle(vehicles, sentences)


def _changed_facts(
    fleet: FleetConfig, old_name: str, new_name: str, new_version: Version, measured: MeasuredPx4
) -> Iterator[ChangedFact]:
    """Yield the measured facts that differ, with what they mean for the fleet.

    Args:
        fleet: the fleet file.
        old_name, new_name: the measured versions that are compared.
        new_version: version to fly.
        measured: measurements of the versions of PX4.
    """
    facts_before = measured.facts_of(old_name)
    for name, fact in measured.facts_of(new_name).items():
        before = facts_before[name].expected
        if fact.expected == before:
            continue

        row = _row_of(name)
        concerned = []
        for vehicle in _enabled(fleet):
            if _concerns(row, _demanded(fleet, vehicle, new_version)):
                concerned.append(vehicle.name)
        yield ChangedFact(
            name=name,
            says=fact.says,
            group=row["group"],
            before=_shown(before),
            after=_shown(fact.expected),
            meaning=row["says"],
            concerns=tuple(concerned),
        )


def _row_of(fact_name: str) -> dict[str, Any]:
    """Return the first row of the table with a pattern that matches a fact; each fact has one."""
    for row in _ROWS:
        if any(fnmatchcase(fact_name, pattern) for pattern in row["facts"]):
            return row
    raise LookupError(f"comparison.toml has no row for {fact_name}")


def _concerns(row: dict[str, Any], demanded: Mapping[str, RequiredParam]) -> bool:
    """Return whether a change matters to a vehicle.

    It does not if the fleet demands a parameter value with which the change has no effect.
    """
    if row.get("is_harmless", False):
        return False
    demand = demanded.get(row.get("parameter", ""))
    return demand is None or demand.value not in row["values"]


def _shown(expected: str) -> str:
    return "nothing" if expected.startswith("nan") else expected


def as_text(comparison: Comparison) -> str:
    """Return the comparison for people."""
    old = comparison.old.removeprefix("v")
    new = comparison.new.removeprefix("v")
    lines = [f"PX4 v{old} to v{new}, for {', '.join(comparison.vehicles)}."]
    lines += _wrapped(comparison.notes, "  ! ")

    lines.append("Parameters")
    parameters = comparison.parameters
    if not parameters:
        parameters = ("nothing changes.",)
    lines += _wrapped(parameters, "  ")

    for group, title in _GROUPS.items():
        lines.append(title)
        facts = [fact for fact in comparison.facts if fact.group == group]
        if facts:
            lines += _fact_lines(facts, comparison.vehicles)
        else:
            lines.append("  nothing changes.")
    return "\n".join(lines)


def _fact_lines(facts: Sequence[ChangedFact], vehicles: tuple[str, ...]) -> list[str]:
    """Return lines about the facts of one group, by meaning; those that concern the fleet first."""
    ordered = sorted(facts, key=lambda fact: (not fact.concerns, fact.meaning))
    lines = []
    for (meaning, concerned), of_meaning in groupby(
        ordered, key=lambda fact: (fact.meaning, fact.concerns)
    ):
        if not concerned:
            scope = "does not concern this fleet"
        elif concerned == vehicles:
            scope = "concerns all"
        else:
            scope = f"concerns {', '.join(concerned)}"
        lines += _wrapped([f"{meaning} ({scope}):"], "  ")

        rows = [f"{fact.name}: {fact.before} -> {fact.after} ({fact.says})" for fact in of_meaning]
        shown = rows[:_MAX_SHOWN]
        if len(rows) > _MAX_SHOWN:
            shown.append(f"and {len(rows) - _MAX_SHOWN} more: --json lists them")
        lines += _wrapped(shown, "    ")
    return lines


def _wrapped(sentences: Iterable[str], indent: str) -> list[str]:
    hanging = " " * (len(indent) + 2)
    lines = []
    for sentence in sentences:
        lines += textwrap.wrap(sentence, _WIDTH, initial_indent=indent, subsequent_indent=hanging)
    return lines


def as_mapping(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison for programs."""
    return {
        "old": comparison.old,
        "new": comparison.new,
        "notes": list(comparison.notes),
        "parameters": list(comparison.parameters),
        "facts": [{**asdict(fact), "concerns": list(fact.concerns)} for fact in comparison.facts],
    }
