"""``covey px4``: each PX4's parameters and state, over MAVLink and not through the agents.

Examples:
  covey px4 params --fleet fleet.toml
  covey px4 params --fleet fleet.toml --vehicles mav0 --apply
  covey px4 params --fleet fleet.toml --dump all.params
  covey px4 params --fleet fleet.toml --diff mav0
  covey px4 params --fleet fleet.toml --restore px4-lab-20261122-140301.params
  covey px4 info --fleet fleet.toml
  covey px4 signing --fleet fleet.toml --set
  covey px4 compare 1.16 1.18 --fleet fleet.toml

Exit status: 0 all are as needed; 1 none is; 2 wrong input; 10 nobody answered;
50 some are. docs/px4.md says more.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from json import dumps
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from groundstation.commands.parameters import FleetFile, Names
from groundstation.px4 import (
    parameter_sets,
    signing_keys,
    vehicle_info,
    vehicle_parameters,
    version_comparison,
)
from groundstation.px4.parameter_file import default_backup
from groundstation.px4.vehicle_links import VehicleLink, for_each, opened, selected_vehicles
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle, load_fleet
from onboard.config.toml_reading import package_table
from onboard.exit_status import EXIT_OK
from onboard.security.mavlink_key import mavlink_keys, read_key

px4 = App(name="px4", help="PX4 itself, past the agents.")
_File = Annotated[Path | None, Parameter(metavar="FILE")]
_BY_HAND = (
    "These values are for flights of Covey. Before you fly by hand, write back what PX4 had:"
    " covey px4 params --fleet {fleet} --restore BACKUP, with the file of the first --apply."
)


@px4.command
def params(
    *,
    fleet: FleetFile,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    apply: bool = False,
    dump: _File = None,
    diff: Annotated[str | None, Parameter(metavar="FILE|VEHICLE")] = None,
    restore: _File = None,
    backup: _File = None,
    json: bool = False,
) -> int:
    """Read from every PX4 the parameters that this fleet needs; set, save, compare or restore them.

    Args:
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        apply: set those that differ, have PX4 store them, and read them back; disarmed vehicles
            only
        dump: write all parameters of each vehicle to a new file, as QGroundControl does
        diff: compare all parameters of each vehicle with those of a file or of another vehicle
        restore: write back the parameters that differ from a file of --dump or a backup; each
            vehicle gets its own
        backup: file for all parameters before --apply or --restore changes any (default:
            px4-FLEET-TIME.params here)
        json: one object instead of the list
    """
    config = load_fleet(fleet)
    actions = [action for action in (apply, dump, diff, restore) if action]
    if len(actions) > 1:
        raise ConfigError(
            "--apply, --dump, --diff and --restore exclude each other. Give one of them."
        )
    if backup is not None and not (apply or restore):
        raise ConfigError(
            "--backup belongs to --apply and --restore. To save parameters, give --dump FILE."
        )

    chosen = selected_vehicles(config, vehicles, exclude)
    backup = backup or default_backup(config)
    if diff is not None:
        chosen = _with_reference(config, chosen, diff)
    for path in (dump, backup):
        if path is not None and path.exists():
            raise ConfigError(f"{path} exists already. Give another name, or remove it.")

    with opened(chosen, mavlink_keys(config, [vehicle.name for vehicle in chosen])) as links:
        if dump:
            status = _print_reports(parameter_sets.dump(links, dump), is_json=json)
        elif diff:
            status = _print_reports(parameter_sets.diff(links, config, diff), is_json=json)
        elif restore:
            reports = parameter_sets.restore(links, restore, backup)
            status = _print_reports(reports, is_json=json)
        else:
            status = _print_needed(links, config, backup, is_set=apply, is_json=json)
    _print_backup(backup, is_json=json)
    return status


def _print_reports(reports: Sequence[parameter_sets.VehicleReport], *, is_json: bool) -> int:
    """Print a report about each vehicle; return the exit status."""
    if is_json:
        print(dumps(parameter_sets.as_mapping(reports), indent=2))
    else:
        print(parameter_sets.as_text(reports))
    return parameter_sets.exit_status(reports)


def _print_needed(
    links: Sequence[VehicleLink],
    fleet: FleetConfig,
    backup: Path,
    *,
    is_set: bool,
    is_json: bool,
) -> int:
    """Read the parameters that the fleet needs, set them if asked, and print them.

    Returns:
        The exit status.
    """

    def read_one(link: VehicleLink) -> vehicle_parameters.VehicleParams:
        return vehicle_parameters.read_one(link, fleet)

    states: Sequence[vehicle_parameters.VehicleParams] = for_each(read_one, links)
    if is_set:
        states = vehicle_parameters.set_all(links, states, backup)

    if is_json:
        print(dumps(vehicle_parameters.as_mapping(states), indent=2))
    else:
        print(vehicle_parameters.as_text(states))
        print(_BY_HAND.format(fleet=fleet.path))
    return vehicle_parameters.exit_status(states)


def _print_backup(backup: Path, *, is_json: bool) -> None:
    """Print where the backup is, if one was written."""
    if backup.exists():
        sentence = f"All parameters before: {backup}. Write them back with --restore {backup}."
        print(sentence, file=sys.stderr if is_json else sys.stdout)


def _with_reference(fleet: FleetConfig, chosen: list[Vehicle], diff: str) -> list[Vehicle]:
    """Return the vehicles to read: the chosen ones, and the one to compare with.

    Raises:
        ConfigError: there is nothing to compare with, or no other vehicle to compare.
    """
    if Path(diff).is_file():
        return chosen
    try:
        (name,) = fleet.select(diff)
    except (ConfigError, ValueError):
        known = ", ".join(fleet.vehicles)
        raise ConfigError(
            f"--diff {diff}: neither a file nor one vehicle of this fleet ({known})."
        ) from None

    reference = fleet.vehicles[name]
    if chosen == [reference]:
        raise ConfigError(
            f"--diff {diff}: there is no other vehicle to compare with {name}. Name others with"
            " --vehicles, or compare with a file of --dump."
        )
    if reference in chosen:
        return chosen
    return [*chosen, reference]


@px4.command
def info(
    *,
    fleet: FleetFile,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    json: bool = False,
) -> int:
    """Print the version, board, uptime, state, sensors and links of every PX4.

    Args:
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        json: one object instead of the list
    """
    config = load_fleet(fleet)
    chosen = selected_vehicles(config, vehicles, exclude)
    keys = mavlink_keys(config, [vehicle.name for vehicle in chosen])
    with opened(chosen, keys) as links:
        infos = for_each(lambda link: vehicle_info.ask(link, keys.get(link.vehicle.name)), links)

    if json:
        print(dumps(vehicle_info.as_mapping(infos), indent=2))
    else:
        print(vehicle_info.as_text(infos))
    return vehicle_info.exit_status(infos)


@px4.command
def signing(
    *,
    fleet: FleetFile,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    set: bool = False,
    remove: bool = False,
    old: _File = None,
    json: bool = False,
) -> int:
    """Say whether every PX4 signs its messages with its key; give it the key, or take it away.

    Args:
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        set: give each disarmed PX4 the key keys/NAME.mavlink.key, over the vehicle's own link
        remove: take the key from each disarmed PX4
        old: with --set: the key that PX4 has now, if it has one already
        json: one object instead of the list
    """
    config = load_fleet(fleet)
    if set and remove:
        raise ConfigError("--set and --remove exclude each other. Give one of them.")
    if old is not None and not set:
        raise ConfigError("--old belongs to --set: it is the key that PX4 has before.")

    chosen = selected_vehicles(config, vehicles, exclude)
    keys = signing_keys.keys_of(config, chosen, is_changed=set or remove)
    old_key = None
    if old is not None:
        old_key = read_key(str(old), config.path)

    action: signing_keys.KeyAction = "look"
    if set:
        action = "set"
    elif remove:
        action = "remove"
    with opened(chosen, keys, hears_all=True) as links:
        reports = signing_keys.run(links, keys, action, old_key)
    return _print_reports(reports, is_json=json)


@px4.command
def compare(
    old: Annotated[str, Parameter(metavar="VERSION")],
    new: Annotated[str, Parameter(metavar="VERSION")],
    /,
    *,
    fleet: FleetFile,
    json: bool = False,
) -> int:
    """Say what another version of PX4 changes for this fleet.

    It compares required parameters, defaults, failsafes, and all else that was measured.

    Args:
        old: version that flies now, for instance 1.16
        new: version to fly, for instance 1.18
        json: one object instead of the list
    """
    comparison = version_comparison.compare(load_fleet(fleet), old, new, measured_px4())
    if json:
        print(dumps(version_comparison.as_mapping(comparison), indent=2))
    else:
        print(version_comparison.as_text(comparison))
    return EXIT_OK


def measured_px4() -> version_comparison.MeasuredPx4:
    """Return the conformance suite's measurements of the versions of PX4."""
    # Imported here: the other commands do not need the simulation.
    from sitl.conformance.facts import VERSIONS, facts_of, nearest
    from sitl.conformance.suite import FACTS

    return version_comparison.MeasuredPx4(
        versions=VERSIONS,
        nearest=nearest,
        facts_of=lambda version: facts_of(version, FACTS),
        parameters=package_table("sitl.conformance", "parameters.toml"),
    )
