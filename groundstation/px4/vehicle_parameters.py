"""The PX4 parameters that Covey requires: reads them, reports differences, and sets them.

Before anything is set, all parameters of the vehicles concerned are saved to a file.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from groundstation.client.autopilot_link import LinkSilentError
from groundstation.px4.parameter_changes import Outcome, ParameterChange, write_all
from groundstation.px4.parameter_file import write_file
from groundstation.px4.vehicle_links import VehicleLink, for_each
from onboard.config.fleet import FleetConfig
from onboard.exit_status import EXIT_FAILED, EXIT_MIXED, EXIT_NO_ANSWER, EXIT_OK
from onboard.px4.required_params import RequiredParam, Value, all_params

_WIDTH = 118
ARMED = "It is armed, and parameters are set on the ground only: land and disarm it."


@dataclass(frozen=True, slots=True)
class ParameterState:
    """One parameter of one vehicle."""

    demand: RequiredParam
    value: Value | None  # None: PX4 did not send it
    change: ParameterChange | None = None  # the attempt to set it; None if there was none

    @property
    def is_met(self) -> bool:
        """Whether it has the required value."""
        return self.demand.is_met(self.value)

    @property
    def was_set(self) -> bool:
        """Whether it was set and read back."""
        return self.change is not None and self.change.outcome is Outcome.SET


@dataclass(frozen=True, slots=True)
class VehicleParams:
    """The required parameters of one vehicle."""

    name: str
    endpoint: str  # endpoint at which they were read
    rows: tuple[ParameterState, ...]
    trouble: str = ""  # why some are missing or were not set; empty if all went well
    version: str = ""  # version of its PX4, in words
    is_stored: bool = False  # whether PX4 has stored them, so that a restart keeps them
    is_armed: bool = False

    @property
    def answers(self) -> bool:
        """Whether PX4 sent any value."""
        return any(row.value is not None for row in self.rows)

    @property
    def is_fine(self) -> bool:
        """Whether all parameters have their required values, except those that are only advice."""
        return not self.trouble and all(row.is_met or row.demand.is_advice for row in self.rows)

    @property
    def restarts_for(self) -> tuple[str, ...]:
        """Names of parameters that were set, but that PX4 reads only when it starts."""
        return tuple(
            row.demand.name for row in self.rows if row.was_set and row.demand.needs_restart
        )


def read_one(link: VehicleLink, fleet: FleetConfig) -> VehicleParams:
    """Read the parameters that one vehicle requires."""
    demands = all_params(fleet, link.vehicle, link.version)
    values: dict[str, Value | None] = {}
    trouble = link.trouble
    version = ""
    if link.link is not None:
        version = link.version_text
        try:
            for demand in demands:
                values[demand.name] = link.link.read(demand.name)
        except LinkSilentError as error:
            trouble = (
                f"{error} {len(values)} of {len(demands)} parameters were read. Run this once more."
            )

    rows = []
    for demand in demands:
        value = values.get(demand.name)
        # this PX4 does not have the parameter, and does not need it
        is_superfluous = demand.is_optional and value is None and not trouble
        if not is_superfluous:
            rows.append(ParameterState(demand, value))

    return VehicleParams(
        name=link.vehicle.name,
        endpoint=link.endpoint,
        rows=tuple(rows),
        trouble=trouble,
        version=version,
        is_armed=link.is_armed,
    )


def set_all(
    links: Sequence[VehicleLink], states: Sequence[VehicleParams], backup: Path
) -> list[VehicleParams]:
    """Set the parameters that differ, after a backup of all parameters of these vehicles.

    Args:
        links: links to the vehicles.
        states: parameters of the same vehicles, as they were read.
        backup: path of the backup, which is written if anything is to be set.

    Raises:
        ConfigError: the backup cannot be written; nothing was changed.
    """
    state_by_name = {state.name: state for state in states}
    required = {state.name: _to_be_set(state) for state in states}

    to_set = []
    for link, state in zip(links, states, strict=True):
        if required[state.name] and not state.trouble and not state.is_armed:
            to_set.append(link)
    troubles, _ = save(to_set, backup)

    def set_one(link: VehicleLink) -> VehicleParams:
        state = state_by_name[link.vehicle.name]
        if state.is_armed and required[state.name]:
            return replace(state, trouble=ARMED)
        if link not in to_set:
            return state
        if troubles[state.name]:
            trouble = f"Nothing was changed, since it could not be saved: {troubles[state.name]}"
            return replace(state, trouble=trouble)
        return _set(link, state, required[state.name])

    return for_each(set_one, links)


def _to_be_set(state: VehicleParams) -> list[RequiredParam]:
    """Return the parameters that differ; one that PX4 did not send cannot be set."""
    return [row.demand for row in state.rows if not row.is_met and row.value is not None]


def _set(
    link: VehicleLink, state: VehicleParams, required: Sequence[RequiredParam]
) -> VehicleParams:
    """Set parameters of one vehicle; return its state afterwards."""
    assert link.link is not None
    if link.link.is_armed():  # since the backup began
        return replace(state, trouble=ARMED)

    before = {row.demand.name: row.value for row in state.rows}
    changes, trouble = write_all(link.link, required, before)

    change_by_name = {change.name: change for change in changes}
    rows = []
    for row in state.rows:
        change = change_by_name.get(row.demand.name)
        if change is None:
            rows.append(row)
        else:
            rows.append(replace(row, value=change.after, change=change))
    return replace(state, rows=tuple(rows), trouble=trouble, is_stored=not trouble)


def save(links: Sequence[VehicleLink], path: Path) -> tuple[dict[str, str], dict[str, int]]:
    """Write all parameters of vehicles to one file.

    Args:
        links: links to the vehicles.
        path: path of the file.

    Returns:
        Two mappings. The first has for each vehicle why it is not in the file; empty if it is. The
        second has for each vehicle in the file the number of its parameters.

    Raises:
        ConfigError: the file cannot be written.
    """
    troubles: dict[str, str] = {}
    counts: dict[str, int] = {}
    contents = {}
    for link, values in zip(links, for_each(read_whole, links), strict=True):
        name = link.vehicle.name
        if isinstance(values, str):
            troubles[name] = values
        else:
            troubles[name] = ""
            counts[name] = len(values)
            contents[link.vehicle.system_id] = (f"{name}, {link.version_text}", values)

    if contents:
        write_file(path, contents)
    return troubles, counts


def read_whole(link: VehicleLink) -> dict[str, Value] | str:
    """Return all parameters of one vehicle, or a sentence that says why they are not known."""
    if link.link is None:
        return link.trouble
    try:
        return link.link.read_all()
    except LinkSilentError as error:
        return str(error)


def exit_status(vehicles: Sequence[VehicleParams]) -> int:
    """Return 0 if all vehicles are fine, 1 if none is, 10 if none answered, 50 if some are."""
    if not any(vehicle.answers for vehicle in vehicles):
        return EXIT_NO_ANSWER
    return status_of([vehicle.is_fine for vehicle in vehicles])


def status_of(fine: Sequence[bool]) -> int:
    """Return 0 if all are fine, 1 if none is, 50 if some are."""
    if all(fine):
        return EXIT_OK
    if any(fine):
        return EXIT_MIXED
    return EXIT_FAILED


def as_text(vehicles: Sequence[VehicleParams]) -> str:
    """Return the list for people."""
    lines: list[str] = []
    for vehicle in vehicles:
        if vehicle.answers:
            lines += _vehicle_lines(vehicle)
        else:
            text = f"{vehicle.name}: no answer. {vehicle.trouble}"
            lines += textwrap.wrap(text, _WIDTH, subsequent_indent="  ")

    versions = {vehicle.version for vehicle in vehicles if vehicle.version}
    if len(versions) > 1:
        lines.append(
            f"Not all are of one version ({', '.join(sorted(versions))}):"
            " each was asked for what its own needs."
        )
    return "\n".join(lines)


def _vehicle_lines(vehicle: VehicleParams) -> list[str]:
    differing = [row for row in vehicle.rows if not row.is_met]
    summary = f"all {len(vehicle.rows)} are as they should be"
    if differing:
        summary = f"{len(differing)} of {len(vehicle.rows)} differ"

    lines = [f"{vehicle.name}, {vehicle.version}, read at {vehicle.endpoint}: {summary}."]
    for row in vehicle.rows:
        lines += textwrap.wrap(
            _line(row, vehicle), _WIDTH, subsequent_indent=" " * 10, initial_indent="  "
        )
    lines += textwrap.wrap(vehicle.trouble, _WIDTH, initial_indent="  ", subsequent_indent="  ")

    if vehicle.is_stored:
        lines.append("  Stored: PX4 keeps them over a restart.")
    if vehicle.restarts_for:
        names = ", ".join(vehicle.restarts_for)
        lines.append(f"  Restart PX4: it reads {names} only when it starts.")
    return lines


def _line(row: ParameterState, vehicle: VehicleParams) -> str:
    """Return the line of one parameter."""
    demand = row.demand
    if row.value is not None:
        value = f"{row.value:g}"
    elif vehicle.trouble:
        value = "not read"
    else:
        value = f"unknown to {vehicle.version}"

    if row.change is not None and row.was_set:
        before = f"{row.change.before:g}"
        return f"{'set':<8}{demand.name:<16} {before} -> {value}, read back: {demand.reason}"
    if row.is_met:
        return f"{'ok':<8}{demand.name:<16} {value}"

    mark = "better" if demand.is_advice else "WRONG"
    outcome = ""
    if row.change is not None:
        outcome = f" ({row.change.outcome.value})"
    required = f"should be {demand.words}: {demand.reason}"
    return f"{mark:<8}{demand.name:<16} {value}{outcome}, {required}"


def as_mapping(vehicles: Sequence[VehicleParams]) -> dict[str, Any]:
    """Return the parameters of vehicles as data for programs."""
    return {vehicle.name: _vehicle_mapping(vehicle) for vehicle in vehicles}


def _vehicle_mapping(vehicle: VehicleParams) -> dict[str, Any]:
    return {
        "answers": vehicle.answers,
        "is_fine": vehicle.is_fine,
        "version": vehicle.version,
        "asked_at": vehicle.endpoint,
        "trouble": vehicle.trouble,
        "is_stored": vehicle.is_stored,
        "restart_for": list(vehicle.restarts_for),
        "params": {row.demand.name: _row_mapping(row) for row in vehicle.rows},
    }


def _row_mapping(row: ParameterState) -> dict[str, Any]:
    return {
        "is": row.value,
        "should": row.demand.value,
        "why": row.demand.reason,
        "is_met": row.is_met,
        "is_required": not row.demand.is_advice,
        "was_set": row.was_set,
        "outcome": "" if row.change is None else row.change.outcome.value,
    }
