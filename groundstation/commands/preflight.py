"""``covey preflight``: go or no-go of every vehicle, check by check."""

from __future__ import annotations

import argparse
import asyncio
import json
from collections.abc import Sequence

from groundstation.client.client import FleetClient
from groundstation.client.preflight_page import VehiclePage, as_mapping, as_text, ask, exit_status
from onboard.bus.protocol import BusError
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet


async def _run(fleet: FleetConfig, names: Sequence[str], timeout_s: float) -> tuple[VehiclePage, ...]:
    client = FleetClient(fleet, operates=False)
    await client.start()
    try:
        return await ask(client, names, timeout_s)
    finally:
        await client.stop()


def main(argv: Sequence[str] | None = None) -> int:
    """Ask and print; the exit status. ConfigError where nobody could be asked."""
    parser = argparse.ArgumentParser(
        prog="covey preflight",
        description="Say for every vehicle whether it may take off, check by check, each fault with its remedy.",
        epilog="Exit status: 0 all are go; 1 at least one is not; 2 wrong input; 10 nobody answered. "
        "docs/preflight.md explains each check.",
    )
    parser.add_argument("--fleet", metavar="FILE", required=True, help="fleet file")
    parser.add_argument("--vehicles", metavar="NAMES", help="only these: names or places, a,b or 0-2 (default all)")
    parser.add_argument("--exclude", metavar="NAMES", help="all but these")
    parser.add_argument("--timeout", metavar="S", type=float, default=5.0, help="wait so long for answers (default 5)")
    parser.add_argument("--json", action="store_true", help="one object instead of the page")
    options = parser.parse_args(argv)
    fleet = load_fleet(options.fleet)
    names = fleet.select(options.vehicles, options.exclude)
    unknown = [name for name in names if name not in fleet.enabled_names]
    if unknown:
        raise ConfigError(f"{unknown[0]} is not enabled in the fleet file. Set enabled = true to fly it.")
    if not names:
        raise ConfigError("No vehicle is selected. Set enabled = true for one, or change --vehicles and --exclude.")
    if not 0.0 < options.timeout <= 600.0:
        raise ConfigError(f"--timeout is {options.timeout:g}; give 0 to 600 s.")
    try:
        pages = asyncio.run(_run(fleet, names, options.timeout))
    except BusError as error:
        raise ConfigError(str(error)) from None
    print(json.dumps(as_mapping(pages), indent=2) if options.json else as_text(pages))
    return exit_status(pages)
