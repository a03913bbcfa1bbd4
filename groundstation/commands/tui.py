"""``covey tui``: the console, attached to a fleet at any time.

Examples:
  covey tui --fleet configs/fleets/paper.toml
  covey tui --fleet fleet.toml --view

The console ends with q; a fleet that flies goes on flying. Exit status: 0; 2 wrong input or no
terminal.
"""

from __future__ import annotations

import asyncio
import os
import sys

from groundstation.client.client import FleetClient
from groundstation.client.ground_node import session
from groundstation.client.read_only import ReadOnlyClient
from groundstation.commands.parameters import FleetFile
from onboard.bus.control_token import WATCHER
from onboard.config.fleet import ConfigError, load_fleet


def tui(
    *,
    fleet: FleetFile,
    readonly: bool = False,
    bell: bool = False,
    view: bool = False,
    no_preview: bool = False,
) -> int:
    """Attach the console to a fleet.

    Args:
        readonly: give no orders at all, not even land
        bell: ring the terminal's bell for every new alarm
        view: do not take control, not even of a free fleet; land, hold and kill work
        no_preview: send arm, take-off and moves without a preview
    """
    config = load_fleet(fleet)
    require_terminal()

    # Imported here: both import textual, which takes a while.
    from groundstation.console.app import ConsoleApp
    from groundstation.orders.forecast_process import Forecaster

    async def attach() -> int:
        if readonly:
            client = FleetClient(config, operates=False, bus=session(config, WATCHER))
        else:
            client = FleetClient(config, operates=not view)
        try:
            console = ConsoleApp(
                config,
                ReadOnlyClient(client) if readonly else client,
                connect=client.start,
                title=f"fleet {config.fleet.name}",
                has_bell=bell,
                forecaster=None if no_preview else Forecaster(),
            )
            return await console.run_to_end()
        finally:
            await client.stop()

    return asyncio.run(attach())


def require_terminal(remedy: str = "") -> None:
    """Refuse to open a console without a terminal or a browser's page.

    Raises:
        ConfigError: the output is neither a terminal nor a browser's page.
    """
    is_page_of_browser = "TEXTUAL_DRIVER" in os.environ
    if not sys.stdout.isatty() and not is_page_of_browser:
        raise ConfigError(
            f"The console needs a terminal, and this output is none. {remedy}".rstrip()
        )
