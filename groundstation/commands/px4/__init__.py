"""``covey px4 params``: each PX4's parameters beside those that this fleet needs.

Examples:
  covey px4 params --fleet fleet.toml
  covey px4 params --fleet fleet.toml --vehicles mav0 --apply

Exit status: 0 all are as needed; 1 none is; 2 wrong input; 10 nobody answered; 50 some are.
"""

from __future__ import annotations

from json import dumps

from cyclopts import App

from groundstation.commands.parameters import FleetFile, Names
from groundstation.commands.px4.vehicle_parameters import as_mapping, as_text, exit_status, read_or_set_all
from onboard.config.fleet import ConfigError, load_fleet

px4 = App(name="px4", help="PX4 itself, past the agents.")


@px4.command
def params(
    *,
    fleet: FleetFile,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    apply: bool = False,
    json: bool = False,
) -> int:
    """Read from every PX4 the parameters that this fleet needs; with --apply set those that differ.

    Args:
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        apply: set those that differ, have PX4 store them, and read them back; disarmed vehicles only
        json: one object instead of the list
    """
    config = load_fleet(fleet)
    names = config.select(vehicles, exclude)
    if not names:
        raise ConfigError("No vehicle is selected. Set enabled = true for one, or change --vehicles and --exclude.")
    states = read_or_set_all([config.vehicles[name] for name in names], applies=apply)
    print(dumps(as_mapping(states), indent=2) if json else as_text(states))
    return exit_status(states)
