"""All parameters of vehicles: into a file, beside another vehicle's or a file's, and back from a
file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from groundstation.px4.parameter_changes import Change, Outcome, write_all
from groundstation.px4.parameter_file import OWN, STATISTICS, is_one_of, read_file
from groundstation.px4.vehicle_links import VehicleLink, for_each
from groundstation.px4.vehicle_parameters import ARMED, read_whole, save, status_of
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.exit_status import EXIT_NO_ANSWER
from onboard.px4.required_params import RequiredParam, Value


@dataclass(frozen=True, slots=True)
class VehicleReport:
    """Lines about one vehicle."""

    name: str
    is_fine: bool
    headline: str
    lines: tuple[str, ...] = ()
    answers: bool = True


def exit_status(reports: Sequence[VehicleReport]) -> int:
    """0 all are fine; 1 none is; 10 nobody answered; 50 some are."""
    if not any(report.answers for report in reports):
        return EXIT_NO_ANSWER
    return status_of([report.is_fine for report in reports])


def as_text(reports: Sequence[VehicleReport]) -> str:
    """The reports for people."""
    return "\n".join(
        "\n  ".join((f"{report.name}: {report.headline}", *report.lines)) for report in reports
    )


def as_mapping(reports: Sequence[VehicleReport]) -> dict[str, Any]:
    """The same for programs."""
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

    Raises:
        ConfigError: the file cannot be written.
    """
    troubles, counts = save(links, path)
    return [
        VehicleReport(
            name, False, f"not in {path}: {trouble}", answers=links[index].link is not None
        )
        if trouble
        else VehicleReport(
            name, True, f"{counts[name]} parameters of {links[index].version_text} are in {path}."
        )
        for index, (name, trouble) in enumerate(troubles.items())
    ]


def diff(links: Sequence[VehicleLink], fleet: FleetConfig, reference: str) -> list[VehicleReport]:
    """Compare all parameters of vehicles with a file's, or with those of one of them.

    Args:
        links: to the vehicles, the one to compare with among them.
        fleet: the fleet file.
        reference: a vehicle's name or index, or a path.

    Raises:
        ConfigError: the file holds nothing about a vehicle.
    """
    whole = dict(
        zip((link.vehicle.name for link in links), for_each(read_whole, links), strict=True)
    )
    name = "" if Path(reference).is_file() else fleet.select(reference)[0]
    sets = {} if name else read_file(Path(reference))
    reports = []
    for link in links:
        values = whole[link.vehicle.name]
        other: Mapping[str, Value] | str = whole[name] if name else _of_file(sets, link)
        if link.vehicle.name == name and not isinstance(values, str):
            continue
        if isinstance(values, str) or isinstance(other, str):
            why = (
                values if isinstance(values, str) else f"there is nothing to compare with: {other}"
            )
            reports.append(
                VehicleReport(link.vehicle.name, False, why, answers=link.link is not None)
            )
            continue
        rows, left_out = differences(values, other)
        own = (
            f"; {left_out} more that are each vehicle's own ({', '.join(OWN[:3])}, ...)"
            if left_out
            else ""
        )
        headline = f"{len(rows)} of {len(values)} differ from {reference}{own}."
        reports.append(VehicleReport(link.vehicle.name, not rows, headline, tuple(rows)))
    return reports


def _of_file(
    sets: Mapping[int, Mapping[str, Value]], link: VehicleLink
) -> Mapping[str, Value] | str:
    """Return the vehicle's own parameters of a file, or those of the one vehicle that it holds."""
    if link.vehicle.system_id in sets:
        return sets[link.vehicle.system_id]
    if len(sets) == 1:
        return next(iter(sets.values()))
    return f"the file holds vehicles {', '.join(map(str, sorted(sets)))} and not {link.vehicle.system_id}."


def differences(values: Mapping[str, Value], other: Mapping[str, Value]) -> tuple[list[str], int]:
    """Return a row for each parameter that differs, and how many that are each vehicle's own were
    left out.
    """
    rows, left_out = [], 0
    for name in sorted(values.keys() | other.keys()):
        here, there = values.get(name), other.get(name)
        if here is not None and there is not None and RequiredParam(name, there, "").is_met(here):
            continue
        if is_one_of(name, OWN):
            left_out += 1
            continue
        here_text, there_text = (
            "not known" if value is None else f"{value:g}" for value in (here, there)
        )
        rows.append(f"{name:<16} {here_text}, there {there_text}")
    return rows, left_out


def restore(links: Sequence[VehicleLink], path: Path, backup: Path) -> list[VehicleReport]:
    """Write a file's parameters back, each vehicle its own, after a backup of what is there now.

    Raises:
        ConfigError: the file holds none of these vehicles, or the backup cannot be written; nothing
            was changed.
    """
    sets = read_file(path)
    if not any(link.vehicle.system_id in sets for link in links):
        raise ConfigError(
            f"{path} holds vehicles {', '.join(map(str, sorted(sets)))}, by MAV_SYS_ID, and none of those selected. "
            "Select others with --vehicles, or give their own file."
        )
    concerned = [link for link in links if link.vehicle.system_id in sets and not link.is_armed]
    troubles, _ = save(concerned, backup)

    def restore_one(link: VehicleLink) -> VehicleReport:
        name, answers = link.vehicle.name, link.link is not None
        if link.vehicle.system_id not in sets:
            return VehicleReport(
                name,
                False,
                f"{path} holds nothing of vehicle {link.vehicle.system_id}.",
                answers=answers,
            )
        if link.is_armed:
            return VehicleReport(name, False, f"nothing was changed. {ARMED}")
        if link.link is None or troubles[name]:
            return VehicleReport(
                name, False, f"nothing was changed. {troubles[name]}", answers=answers
            )
        before = read_whole(link)
        if isinstance(before, str):
            return VehicleReport(name, False, f"nothing was changed. {before}")
        required = [
            RequiredParam(parameter, value, "")
            for parameter, value in sets[link.vehicle.system_id].items()
            if not is_one_of(parameter, STATISTICS)
            and not RequiredParam(parameter, value, "").is_met(before.get(parameter))
        ]
        changes, trouble = write_all(link.link, required, before)
        count = sum(change.outcome is Outcome.SET for change in changes)
        stored = "; PX4 has stored them" if count and not trouble else ""
        headline = (
            f"{count} of {len(changes)} that differed were written back{stored}. {trouble}".strip()
        )
        return VehicleReport(name, not trouble, headline, tuple(_row(change) for change in changes))

    return for_each(restore_one, links)


def _row(change: Change) -> str:
    before, after = (
        "unknown" if value is None else f"{value:g}" for value in (change.before, change.after)
    )
    return (
        f"{change.outcome.value:<14}{change.name:<16} {before} -> {change.required:g}, now {after}"
    )
