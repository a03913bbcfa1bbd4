"""``covey sitl truth``: ground truth of real PX4s with their built-in simulator (SIH) on the bus.

Example:
  covey sitl truth --fleet configs/fleets/px4-sitl.toml

Exit status: 0 ended by an interrupt; 2 wrong input or a port in use.
docs/px4-sitl.md says more.
"""

from __future__ import annotations

from groundstation.commands.parameters import FleetFile, Names
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_OK
from sitl.mavlink.endpoints import StartError
from sitl.sih_truth import run


def sitl_truth(*, fleet: FleetFile, vehicles: Names | None = None, mocap: bool = False) -> int:
    """Put the ground truth of real PX4s (SITL with SIH) on the bus, for verdicts and records.

    Args:
        vehicles: names or indices (default: all enabled that are not emulated)
        mocap: publish it as motion capture too, at 50 Hz
    """
    config = load_fleet(fleet)
    emulated = config.emulated_names
    exclude = None if vehicles else ",".join(emulated)
    names = config.select(vehicles, exclude)

    refused = [name for name in names if name in emulated]
    if not names:  # no vehicle is left, because all are emulated
        refused = list(emulated)
    if refused or not names:
        raise ConfigError(
            f"{', '.join(refused)}: emulated = true in {config.path}. The"
            " emulator tells their truth and their poses; a body may get them from one source only."
            " Name the others, or remove the key."
        )
    try:
        run(config, names, with_mocap=mocap)
    except StartError as error:
        raise ConfigError(str(error)) from None
    return EXIT_OK
