"""All parameters of vehicles: saved to a file, compared with others, restored from a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from groundstation.px4.parameter_changes import Outcome, ParameterChange, write_all
from groundstation.px4.parameter_file import OWN, STATISTICS, is_one_of, read_file
from groundstation.px4.vehicle_links import VehicleLink, for_each
from groundstation.px4.vehicle_parameters import ARMED, read_whole, save, status_of
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.exit_status import EXIT_NO_ANSWER
from onboard.px4.required_params import RequiredParam, Value

# All parameters of a vehicle, or a sentence that says why they are not known.
_Parameters = Mapping[str, Value] | str


@dataclass(frozen=True, slots=True)
class VehicleReport:
    """Lines about one vehicle."""

    name: str
    is_fine: bool
    headline: str
    lines: tuple[str, ...] = ()
    answers: bool = True  # whether its PX4 is heard


class Differences(NamedTuple):
    """The differences between two sets of parameters."""

    rows: list[str]  # one line for each parameter that differs
    left_out: int  # number of differing parameters that belong to one vehicle by nature


def exit_status(reports: Sequence[VehicleReport]) -> int:
    """Return 0 if all vehicles are fine, 1 if none is, 10 if none answered, 50 if some are."""
    if not any(report.answers for report in reports):
        return EXIT_NO_ANSWER
    return status_of([report.is_fine for report in reports])


def as_text(reports: Sequence[VehicleReport]) -> str:
    """Return the reports for people."""
    texts = []
    for report in reports:
        lines = [f"{report.name}: {report.headline}", *report.lines]
        texts.append("\n  ".join(lines))
    return "\n".join(texts)


def as_mapping(reports: Sequence[VehicleReport]) -> dict[str, Any]:
    """Return the reports as data for programs."""
    return {
        report.name: {
            "answers": report.answers,
            "is_fine": report.is_fine,
            "says": report.headline,
            "rows": report.lines,
        }
        for report in reports
    }


def dump(links: Sequence[VehicleLink], path: Path) -> list[VehicleReport]:
    """Write all parameters of the vehicles that answer to a new file.

    Args:
        links: links to the vehicles.
        path: path of the file.

    Raises:
        ConfigError: the file cannot be written.
    """
    troubles, counts = save(links, path)
    reports = []
    for link in links:
        name = link.vehicle.name
        if troubles[name]:
            headline = f"not in {path}: {troubles[name]}"
            is_heard = link.link is not None
            reports.append(VehicleReport(name, False, headline, answers=is_heard))
        else:
            headline = f"{counts[name]} parameters of {link.version_text} are in {path}."
            reports.append(VehicleReport(name, True, headline))
    return reports


def diff(links: Sequence[VehicleLink], fleet: FleetConfig, reference: str) -> list[VehicleReport]:
    """Compare all parameters of vehicles with those in a file, or with those of a vehicle.

    Args:
        links: links to the vehicles, including the one to compare with.
        fleet: the fleet file.
        reference: name or index of the vehicle to compare with, or path of the file.

    Raises:
        ConfigError: the file cannot be read, or there is no such vehicle.
    """
    parameters: dict[str, _Parameters] = {}
    for link, values in zip(links, for_each(read_whole, links), strict=True):
        parameters[link.vehicle.name] = values

    if Path(reference).is_file():
        sets = read_file(Path(reference))
        return [
            _compared(link, parameters[link.vehicle.name], _file_parameters(sets, link), reference)
            for link in links
        ]

    reference_name, *_ = fleet.select(reference)
    reports = []
    for link in links:
        name = link.vehicle.name
        is_reference = name == reference_name
        # the reference itself gets a report only if it could not be read
        if not is_reference or isinstance(parameters[name], str):
            reports.append(_compared(link, parameters[name], parameters[reference_name], reference))
    return reports


def _compared(
    link: VehicleLink, values: _Parameters, other: _Parameters, reference: str
) -> VehicleReport:
    """Return a report about how a vehicle's parameters differ from others."""
    name = link.vehicle.name
    is_heard = link.link is not None
    if isinstance(values, str):
        return VehicleReport(name, False, values, answers=is_heard)
    if isinstance(other, str):
        headline = f"there is nothing to compare with: {other}"
        return VehicleReport(name, False, headline, answers=is_heard)

    compared = differences(values, other)
    more = ""
    if compared.left_out:
        more = f"; {compared.left_out} more that are each vehicle's own ({', '.join(OWN[:3])}, ...)"
    headline = f"{len(compared.rows)} of {len(values)} differ from {reference}{more}."
    return VehicleReport(name, not compared.rows, headline, tuple(compared.rows))


def _file_parameters(sets: Mapping[int, Mapping[str, Value]], link: VehicleLink) -> _Parameters:
    """Return a vehicle's parameters in a file.

    If the file contains a single vehicle, its parameters stand for those of every vehicle.
    """
    system_id = link.vehicle.system_id
    if system_id in sets:
        return sets[system_id]
    if len(sets) == 1:
        return next(iter(sets.values()))
    return f"the file holds vehicles {_listed(sets)} and not {system_id}."


def differences(values: Mapping[str, Value], other: Mapping[str, Value]) -> Differences:
    """Return the differences between two sets of parameters, each parameter -> value."""
    rows = []
    left_out = 0
    for name in sorted(values.keys() | other.keys()):
        here = values.get(name)
        there = other.get(name)
        if here is not None and there is not None and _is_same(name, here, there):
            continue
        if is_one_of(name, OWN):
            left_out += 1
            continue
        rows.append(f"{name:<16} {_shown(here, 'not known')}, there {_shown(there, 'not known')}")
    return Differences(rows, left_out)


def _is_same(name: str, value: Value | None, required: Value) -> bool:
    """Return whether a value counts as equal to the required one."""
    return RequiredParam(name, required, "").is_met(value)


def _shown(value: Value | None, missing: str) -> str:
    return missing if value is None else f"{value:g}"


def _listed(sets: Mapping[int, object]) -> str:
    return ", ".join(str(system_id) for system_id in sorted(sets))


def restore(links: Sequence[VehicleLink], path: Path, backup: Path) -> list[VehicleReport]:
    """Restore each vehicle's parameters from a file, after a backup of the present ones.

    Args:
        links: links to the vehicles.
        path: path of the file.
        backup: path of the backup, which is written first.

    Raises:
        ConfigError: the file holds none of these vehicles, or the backup cannot be written; nothing
            was changed.
    """
    sets = read_file(path)
    if not any(link.vehicle.system_id in sets for link in links):
        raise ConfigError(
            f"{path} holds vehicles {_listed(sets)}, by MAV_SYS_ID, and none of those selected."
            " Select others with --vehicles, or give their own file."
        )

    to_restore = [link for link in links if link.vehicle.system_id in sets and not link.is_armed]
    troubles, _ = save(to_restore, backup)

    def restore_one(link: VehicleLink) -> VehicleReport:
        name = link.vehicle.name
        system_id = link.vehicle.system_id
        is_heard = link.link is not None
        if system_id not in sets:
            headline = f"{path} holds nothing of vehicle {system_id}."
            return VehicleReport(name, False, headline, answers=is_heard)
        if link.is_armed:
            return VehicleReport(name, False, f"nothing was changed. {ARMED}")
        if not is_heard or troubles[name]:
            headline = f"nothing was changed. {troubles[name]}"
            return VehicleReport(name, False, headline, answers=is_heard)
        return _restore(link, sets[system_id])

    return for_each(restore_one, links)


def _restore(link: VehicleLink, values: Mapping[str, Value]) -> VehicleReport:
    """Write the values of a file that differ from the vehicle's."""
    assert link.link is not None
    name = link.vehicle.name
    before = read_whole(link)
    if isinstance(before, str):
        return VehicleReport(name, False, f"nothing was changed. {before}")
    if link.link.is_armed():  # since the backup began
        return VehicleReport(name, False, f"nothing was changed. {ARMED}")

    required = []
    for parameter, value in values.items():
        is_same = _is_same(parameter, before.get(parameter), value)
        if not is_same and not is_one_of(parameter, STATISTICS):
            required.append(RequiredParam(parameter, value, ""))

    changes, trouble = write_all(link.link, required, before)
    count = sum(1 for change in changes if change.outcome is Outcome.SET)
    stored = ""
    if count and not trouble:
        stored = "; PX4 has stored them"
    headline = f"{count} of {len(changes)} that differed were written back{stored}. {trouble}"
    rows = tuple(_row(change) for change in changes)
    return VehicleReport(name, not trouble, headline.strip(), rows)


def _row(change: ParameterChange) -> str:
    before = _shown(change.before, "unknown")
    after = _shown(change.after, "unknown")
    outcome = change.outcome.value
    return f"{outcome:<14}{change.name:<16} {before} -> {change.required:g}, now {after}"
