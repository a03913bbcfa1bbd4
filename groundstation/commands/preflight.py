"""``covey check vehicles``: go or no-go of every vehicle, check by check.

Examples:
  covey check vehicles --fleet fleet.toml
  covey check vehicles --fleet fleet.toml --vehicles mav0,mav2 --json
  covey check vehicles --fleet fleet.toml --wait 20 && covey fly mission.toml --fleet fleet.toml

Exit status: 0 all are go; 1 at least one is not; 2 wrong input; 10 nobody answered.
docs/preflight.md explains each check.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from json import dumps

from groundstation.client.client import FleetClient
from groundstation.client.ground_node import session
from groundstation.client.preflight_page import VehiclePage, as_mapping, as_text, ask, exit_status
from groundstation.commands.parameters import FleetFile, Names, Seconds
from onboard.bus.control_token import WATCHER
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet

_LONGEST_S = 600.0


def preflight(
    *,
    fleet: FleetFile,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    timeout: Seconds = 5.0,
    wait: Seconds = 0.0,
    json: bool = False,
) -> int:
    """Say for every vehicle whether it may take off, check by check, each fault with its remedy.

    Args:
        vehicles: only these: names or indices, a,b or 0-2 (default all)
        exclude: all but these
        timeout: longest wait for the first answers
        wait: longest time for which to ask again after the first answers, until all are go, because
            agents that have just started know little yet
        json: one object instead of the page
    """
    config = load_fleet(fleet)
    names = config.select(vehicles, exclude)
    for name in names:
        if name not in config.enabled_names:
            raise ConfigError(
                f"{name} is not enabled in the fleet file. Set enabled = true to fly it."
            )
    if not names:
        raise ConfigError(
            "No vehicle is selected. Set enabled = true for one, "
            "or change --vehicles and --exclude."
        )
    if not 0.0 < timeout <= _LONGEST_S:
        raise ConfigError(f"--timeout is {timeout:g}; give 0 to 600 s.")
    if not 0.0 <= wait <= _LONGEST_S:
        raise ConfigError(f"--wait is {wait:g}; give 0 to 600 s.")

    pages = asyncio.run(_pages(config, names, timeout, wait))
    if json:
        print(dumps(as_mapping(pages), indent=2))
    else:
        print(as_text(pages))
    return exit_status(pages)


async def _pages(
    fleet: FleetConfig, names: Sequence[str], timeout_s: float, wait_s: float
) -> tuple[VehiclePage, ...]:
    """Return the vehicles' pages, received by a ground that only watches."""
    client = FleetClient(fleet, operates=False, bus=session(fleet, WATCHER))
    await client.start()
    try:
        return await ask(client, names, timeout_s, wait_s)
    finally:
        await client.stop()
