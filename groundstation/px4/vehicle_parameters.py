"""Parameters of each vehicle's PX4 beside those that close flight needs; setting them, and reading
them back.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from groundstation.client.autopilot_link import LinkSilentError
from groundstation.px4.parameter_changes import Change, Outcome, write_all
from groundstation.px4.parameter_file import write_file
from groundstation.px4.vehicle_links import VehicleLink, for_each
from onboard.exit_status import EXIT_FAILED, EXIT_MIXED, EXIT_NO_ANSWER, EXIT_OK
from onboard.px4.required_params import RequiredParam, Value, all_params

_WIDTH = 118
ARMED = "It is armed, and parameters are set on the ground only: land and disarm it."


@dataclass(frozen=True, slots=True)
class ParameterState:
    """One parameter of one vehicle."""

    demand: RequiredParam
    value: Value | None  # None: PX4 did not send it
    change: Change | None = None  # it was to be set

    @property
    def is_met(self) -> bool:
        """Whether it is as it should be."""
        return self.demand.is_met(self.value)

    @property
    def was_set(self) -> bool:
        """Whether it was set, and read back."""
        return self.change is not None and self.change.outcome is Outcome.SET


@dataclass(frozen=True, slots=True)
class VehicleParams:
    """Parameters of one vehicle, read at one endpoint; ``trouble``: why there are no more."""

    name: str
    endpoint: str
    rows: tuple[ParameterState, ...]
    trouble: str = ""
    version: str = ""  # of its PX4, in words
    is_stored: bool = False  # PX4 has written them: a restart keeps them
    is_armed: bool = False

    @property
    def answers(self) -> bool:
        """Whether PX4 sent any value."""
        return any(row.value is not None for row in self.rows)

    @property
    def is_fine(self) -> bool:
        """Whether everything is met that take-off is refused without."""
        return not self.trouble and all(row.is_met or row.demand.is_advice for row in self.rows)

    @property
    def restarts_for(self) -> tuple[str, ...]:
        """Parameters that were set and that PX4 reads only when it starts."""
        return tuple(
            row.demand.name for row in self.rows if row.was_set and row.demand.needs_restart
        )


def read_one(link: VehicleLink) -> VehicleParams:
    """Read what one vehicle needs."""
    demands = all_params(link.vehicle, link.version)
    values: dict[str, Value | None] = {}
    trouble = link.trouble
    if link.link is not None:
        try:
            for demand in demands:
                values[demand.name] = link.link.read(demand.name)
        except LinkSilentError as error:
            trouble = (
                f"{error} {len(values)} of {len(demands)} parameters were read. Run this once more."
            )
    rows = tuple(ParameterState(demand, values.get(demand.name)) for demand in demands)
    version = link.version_text if link.link is not None else ""
    return VehicleParams(
        link.vehicle.name, link.endpoint, rows, trouble, version, is_armed=link.is_armed
    )


def set_all(
    links: Sequence[VehicleLink], states: Sequence[VehicleParams], backup: Path
) -> list[VehicleParams]:
    """Set what differs, after all parameters of the vehicles concerned are in a backup.

    Args:
        links: to the vehicles.
        states: as they were read.
        backup: file to write, if anything is to be set.

    Raises:
        ConfigError: the backup cannot be written; nothing was changed.
    """
    needed = {
        state.name: [row.demand for row in state.rows if not row.is_met and row.value is not None]
        for state in states
    }
    concerned = [
        link
        for link, state in zip(links, states, strict=True)
        if needed[state.name] and not state.trouble and not state.is_armed
    ]
    saved, _ = save(concerned, backup)

    def set_one(link: VehicleLink) -> VehicleParams:
        state = next(state for state in states if state.name == link.vehicle.name)
        if state.is_armed and needed[state.name]:
            return replace(state, trouble=ARMED)
        if link not in concerned:
            return state
        if saved[state.name]:
            return replace(
                state,
                trouble=f"Nothing was changed, since it could not be saved: {saved[state.name]}",
            )
        assert link.link is not None
        before = {row.demand.name: row.value for row in state.rows}
        changes, trouble = write_all(link.link, needed[state.name], before)
        of_name = {change.name: change for change in changes}
        rows = tuple(
            replace(row, value=of_name[row.demand.name].after, change=of_name[row.demand.name])
            if row.demand.name in of_name
            else row
            for row in state.rows
        )
        return replace(state, rows=rows, trouble=trouble, is_stored=not trouble)

    return for_each(set_one, links)


def save(links: Sequence[VehicleLink], path: Path) -> tuple[dict[str, str], dict[str, int]]:
    """Write all parameters of vehicles to one file.

    Returns:
        Vehicle -> why it is not in the file, empty when it is; vehicle -> number of its parameters.

    Raises:
        ConfigError: the file cannot be written.
    """
    read = for_each(read_whole, links)
    whole = {
        link.vehicle.system_id: (f"{link.vehicle.name}, {link.version_text}", values)
        for link, values in zip(links, read, strict=True)
        if not isinstance(values, str)
    }
    if whole:
        write_file(path, whole)
    of_name = dict(zip((link.vehicle.name for link in links), read, strict=True))
    troubles = {name: values if isinstance(values, str) else "" for name, values in of_name.items()}
    return troubles, {name: len(values) for name, values in of_name.items()}


def read_whole(link: VehicleLink) -> dict[str, Value] | str:
    """Return all parameters of one vehicle, or a sentence on why not."""
    if link.link is None:
        return link.trouble
    try:
        return link.link.read_all()
    except LinkSilentError as error:
        return str(error)


def exit_status(answers: Sequence[VehicleParams]) -> int:
    """0 all are as needed; 1 none is; 10 nobody answered; 50 some are and some are not."""
    if not any(answer.answers for answer in answers):
        return EXIT_NO_ANSWER
    return status_of([answer.is_fine for answer in answers])


def status_of(fine: Sequence[bool]) -> int:
    """0 all are fine; 1 none is; 50 some are."""
    return EXIT_OK if all(fine) else EXIT_MIXED if any(fine) else EXIT_FAILED


def as_text(answers: Sequence[VehicleParams]) -> str:
    """The list for people."""
    lines: list[str] = []
    for answer in answers:
        off = sum(not row.is_met for row in answer.rows)
        if not answer.answers:
            lines += textwrap.wrap(
                f"{answer.name}: no answer. {answer.trouble}", _WIDTH, subsequent_indent="  "
            )
            continue
        state = (
            f"{off} of {len(answer.rows)} differ"
            if off
            else f"all {len(answer.rows)} are as they should be"
        )
        lines.append(f"{answer.name}, {answer.version}, read at {answer.endpoint}: {state}.")
        for row in answer.rows:
            lines += textwrap.wrap(
                _line(row, answer), _WIDTH, subsequent_indent=" " * 10, initial_indent="  "
            )
        lines += textwrap.wrap(answer.trouble, _WIDTH, initial_indent="  ", subsequent_indent="  ")
        if answer.is_stored:
            lines.append("  Stored: PX4 keeps them over a restart.")
        if answer.restarts_for:
            lines.append(
                f"  Restart PX4: it reads {', '.join(answer.restarts_for)} only when it starts."
            )
    versions = {answer.version for answer in answers if answer.version}
    if len(versions) > 1:
        lines.append(
            f"Not all are of one version ({', '.join(sorted(versions))}): each was asked for what its own needs."
        )
    return "\n".join(lines)


def _line(row: ParameterState, of: VehicleParams) -> str:
    demand, change = row.demand, row.change
    missing = "not read" if of.trouble else f"unknown to {of.version}"
    value = missing if row.value is None else f"{row.value:g}"
    if change is not None and row.was_set:
        return (
            f"{'set':<8}{demand.name:<16} {change.before:g} -> {value}, read back: {demand.reason}"
        )
    if row.is_met:
        return f"{'ok':<8}{demand.name:<16} {value}"
    mark = "better" if demand.is_advice else "WRONG"
    became = f" ({change.outcome.value})" if change is not None else ""
    return (
        f"{mark:<8}{demand.name:<16} {value}{became}, should be {demand.value:g}: {demand.reason}"
    )


def as_mapping(answers: Sequence[VehicleParams]) -> dict[str, Any]:
    """The same for programs."""
    return {
        answer.name: {
            "answers": answer.answers,
            "is_fine": answer.is_fine,
            "version": answer.version,
            "asked_at": answer.endpoint,
            "trouble": answer.trouble,
            "is_stored": answer.is_stored,
            "restart_for": list(answer.restarts_for),
            "params": {
                row.demand.name: {
                    "is": row.value,
                    "should": row.demand.value,
                    "why": row.demand.reason,
                    "is_met": row.is_met,
                    "is_required": not row.demand.is_advice,
                    "was_set": row.was_set,
                    "outcome": row.change.outcome.value if row.change is not None else "",
                }
                for row in answer.rows
            },
        }
        for answer in answers
    }
