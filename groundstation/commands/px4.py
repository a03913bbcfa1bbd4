"""``covey px4``: each PX4's parameters and state, past the agents, and what another version changes
for a fleet.

Examples:
  covey px4 params --fleet fleet.toml
  covey px4 params --fleet fleet.toml --vehicles mav0 --apply
  covey px4 params --fleet fleet.toml --dump all.params
  covey px4 params --fleet fleet.toml --diff mav0
  covey px4 params --fleet fleet.toml --restore px4-lab-20261122-140301.params
  covey px4 info --fleet fleet.toml
  covey px4 signing --fleet fleet.toml --set
  covey px4 compare 1.16 1.18 --fleet fleet.toml

Exit status: 0 all are as needed; 1 none is; 2 wrong input; 10 nobody answered; 50 some are.
docs/px4.md says more.
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
    comparison,
    parameter_sets,
    signing_keys,
    vehicle_info,
    vehicle_parameters,
)
from groundstation.px4.parameter_file import default_backup
from groundstation.px4.vehicle_links import for_each, opened
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle, load_fleet
from onboard.exit_status import EXIT_OK
from onboard.security.mavlink_key import mavlink_key, read_key

px4 = App(name="px4", help="PX4 itself, past the agents.")
_File = Annotated[Path | None, Parameter(metavar="FILE")]


def _selected(fleet: FleetConfig, vehicles: str | None, exclude: str | None) -> list[Vehicle]:
    names = fleet.select(vehicles, exclude)
    if not names:
        raise ConfigError(
            "No vehicle is selected. Set enabled = true for one, or change --vehicles and --exclude."
        )
    return [fleet.vehicles[name] for name in names]


def _keys(fleet: FleetConfig, vehicles: Sequence[Vehicle]) -> dict[str, bytes]:
    keys = {vehicle.name: mavlink_key(fleet, vehicle.name) for vehicle in vehicles}
    return {name: key for name, key in keys.items() if key is not None}


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
    """Read from every PX4 the parameters that this fleet needs; set them, save all, compare all,
    write all back.

    Args:
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        apply: set those that differ, have PX4 store them, and read them back; disarmed vehicles
            only
        dump: write all parameters of each vehicle to a new file, as QGroundControl does
        diff: compare all parameters of each vehicle with a file's or with another vehicle's
        restore: write back what differs from a file of --dump or a backup, each vehicle its own
        backup: file for all parameters before --apply or --restore changes any (default:
            px4-FLEET-TIME.params here)
        json: one object instead of the list
    """
    config = load_fleet(fleet)
    if sum(map(bool, (apply, dump, diff, restore))) > 1:
        raise ConfigError(
            "--apply, --dump, --diff and --restore exclude each other. Give one of them."
        )
    if backup is not None and not (apply or restore):
        raise ConfigError(
            "--backup belongs to --apply and --restore. To save parameters, give --dump FILE."
        )
    chosen = _selected(config, vehicles, exclude)
    backup = backup or default_backup(config)
    if diff is not None:
        chosen = _with_reference(config, chosen, diff)
    for path in (dump, backup):
        if path is not None and path.exists():
            raise ConfigError(f"{path} exists already. Give another name, or remove it.")
    with opened(chosen, _keys(config, chosen)) as links:
        if dump or diff or restore:
            if dump:
                reports = parameter_sets.dump(links, dump)
            elif diff:
                reports = parameter_sets.diff(links, config, diff)
            else:
                assert restore is not None
                reports = parameter_sets.restore(links, restore, backup)
            _print(
                parameter_sets.as_mapping(reports) if json else parameter_sets.as_text(reports),
                backup,
                is_json=json,
            )
            return parameter_sets.exit_status(reports)
        states: Sequence[vehicle_parameters.VehicleParams] = for_each(
            vehicle_parameters.read_one, links
        )
        if apply:
            states = vehicle_parameters.set_all(links, states, backup)
    _print(
        vehicle_parameters.as_mapping(states) if json else vehicle_parameters.as_text(states),
        backup,
        is_json=json,
    )
    return vehicle_parameters.exit_status(states)


def _print(content: object, backup: Path, *, is_json: bool) -> None:
    print(dumps(content, indent=2) if is_json else content)
    if backup.exists():
        says = f"All parameters before: {backup}. Write them back with --restore {backup}."
        print(says, file=sys.stderr if is_json else sys.stdout)


def _with_reference(fleet: FleetConfig, chosen: list[Vehicle], diff: str) -> list[Vehicle]:
    """Return the vehicles to read: the one to compare with belongs to them."""
    if Path(diff).is_file():
        return chosen
    try:
        (name,) = fleet.select(diff)
    except (ConfigError, ValueError):
        raise ConfigError(
            f"--diff {diff}: neither a file nor one vehicle of this fleet ({', '.join(fleet.vehicles)})."
        ) from None
    return chosen if fleet.vehicles[name] in chosen else [*chosen, fleet.vehicles[name]]


@px4.command
def info(
    *,
    fleet: FleetFile,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    json: bool = False,
) -> int:
    """Say of every PX4 its version, board, uptime, state, sensors and links.

    Args:
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        json: one object instead of the list
    """
    config = load_fleet(fleet)
    chosen = _selected(config, vehicles, exclude)
    keys = _keys(config, chosen)
    with opened(chosen, keys) as links:
        found = for_each(lambda link: vehicle_info.ask(link, keys.get(link.vehicle.name)), links)
    print(dumps(vehicle_info.as_mapping(found), indent=2) if json else vehicle_info.as_text(found))
    return vehicle_info.exit_status(found)


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
        old: with --set: the key that PX4 has now, where it has another one
        json: one object instead of the list
    """
    config = load_fleet(fleet)
    if set and remove:
        raise ConfigError("--set and --remove exclude each other. Give one of them.")
    if old is not None and not set:
        raise ConfigError("--old belongs to --set: it is the key that PX4 has before.")
    chosen = _selected(config, vehicles, exclude)
    keys = signing_keys.keys_of(config, chosen, is_changed=set or remove)
    old_key = None if old is None else read_key(str(old), config.path)
    with opened(chosen, keys, hears_all=True) as links:
        reports = signing_keys.run(
            links, keys, "set" if set else "remove" if remove else "look", old_key
        )
    print(
        dumps(parameter_sets.as_mapping(reports), indent=2)
        if json
        else parameter_sets.as_text(reports)
    )
    return parameter_sets.exit_status(reports)


@px4.command
def compare(
    old: Annotated[str, Parameter(metavar="VERSION")],
    new: Annotated[str, Parameter(metavar="VERSION")],
    /,
    *,
    fleet: FleetFile,
    json: bool = False,
) -> int:
    """Say what another version of PX4 changes for this fleet: demanded parameters, failsafes, and
    other facts.

    Args:
        old: version that flies now, for instance 1.16
        new: version to fly, for instance 1.18
        json: one object instead of the list
    """
    found = comparison.compare(load_fleet(fleet), old, new)
    print(dumps(comparison.as_mapping(found), indent=2) if json else comparison.as_text(found))
    return EXIT_OK
