"""``covey import spots``: take-off spots where the vehicles stand, for a fleet file.

Examples:
  covey import spots --fleet fleet.toml
  covey import spots --fleet fleet.toml --seconds 60 --spread 0.05 --write
  covey import spots --fleet fleet.toml --vehicles mav1,mav3

Every standing vehicle's position is averaged; the table says how far the positions
are spread. Without --write nothing is changed. The command refuses vehicles that
fly, are armed, have no good position, or stand too near to each other to take off.

Exit status: 0 fine; 2 wrong input or refused, nothing written.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

from groundstation.client.client import FleetClient
from groundstation.client.ground_node import session
from groundstation.client.standing_positions import standing_positions
from groundstation.commands.parameters import File, Names, Seconds
from onboard.bus.control_token import WATCHER
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_OK
from onboard.tuples import Xyz

_LONGEST_S = 3600.0
_MAX_SPREAD_M = 100.0


def spots(
    *,
    fleet: File,
    vehicles: Names = "all",
    seconds: Seconds = 30.0,
    spread: float = 0.3,
    write: bool = False,
) -> int:
    """Print take-off spots where the vehicles stand, as a fleet file has them.

    Args:
        fleet: the fleet file; its agents run
        vehicles: vehicles whose spots are measured
        seconds: time over which positions are averaged
        spread: largest standard deviation of the positions at a spot, in metres
        write: write the spots into the fleet file
    """
    # Imported here: the help page does not need these modules.
    from groundstation.starter.fleet_edit import checked_edit, write_text
    from groundstation.starter.spot_survey import (
        changes_of,
        refuse_poor_spots,
        spot_lines,
        surveyed,
    )

    if not 0.0 < seconds <= _LONGEST_S:
        raise ConfigError(f"--seconds is {seconds:g}; give seconds between 0 and 3600.")
    if not 0.0 < spread <= _MAX_SPREAD_M:
        raise ConfigError(f"--spread is {spread:g}; give metres between 0 and 100.")

    config = load_fleet(fleet)
    names = config.select(vehicles)
    print(f"{seconds:g} s: {', '.join(names)} ...", flush=True)
    measured_spots = surveyed(asyncio.run(_collect(config, names, seconds)), config)
    print("\n".join(spot_lines(measured_spots)))

    refuse_poor_spots(measured_spots, config, spread)
    text = checked_edit(Path(fleet), changes_of(measured_spots, config))
    if not write:
        print(f"{fleet} is as it was. With --write these spots go into it.")
        return EXIT_OK

    write_text(Path(fleet), text)
    print(f"Written into {fleet}. Every computer needs this file: covey check vehicles compares.")
    return EXIT_OK


async def _collect(
    fleet: FleetConfig, names: tuple[str, ...], seconds: float
) -> dict[str, list[Xyz]]:
    client = FleetClient(fleet, operates=False, bus=session(fleet, WATCHER))
    return await standing_positions(client, names, seconds)
