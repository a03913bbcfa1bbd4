"""``covey web``: the fleet, or a recorded flight, on a page in a browser of this machine.

Examples:
  covey web --fleet fleet.toml
  covey web --fleet fleet.toml --operate
  covey web --replay flights/first --port 0

Exit status: 0 ended by an interrupt; 2 wrong input, nothing was served.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from pathlib import Path

from groundstation.client.client import FleetClient
from groundstation.client.ground_node import session
from groundstation.commands.parameters import File, Folder
from groundstation.scene.ground_tiles import GroundTiles, read_ground_tiles
from groundstation.web.live_feed import LiveFeed
from groundstation.web.page_server import PageServer, require_loopback
from onboard.bus.control_token import WATCHER
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.end_signals import end_signals
from onboard.exit_status import EXIT_OK

_KEY_BYTES = 24  # random bytes in the address at which pages may give orders


def web(
    *,
    fleet: File | None = None,
    replay: Folder | None = None,
    operate: bool = False,
    tiles: Folder | None = None,
    port: int = 8000,
    host: str = "127.0.0.1",
) -> int:
    """Show a fleet, or a recorded flight, on a page in a browser of this machine.

    Pages only watch unless --operate is given: nothing that is pressed in them reaches a vehicle.
    Nothing is loaded from the internet.

    Args:
        fleet: watch the fleet of this file
        replay: the report of a recorded flight, which plays
        operate: pages may give orders, one operator at a time; the printed address has a key, new
            at every start
        tiles: folder with pictures of the ground, {z}/{x}/{y}.png; the fleet file has an origin
        port: 0 takes any
        host: a loopback address
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"--port {port}: ports lie between 0 and 65535.")
    if replay and operate:
        raise ConfigError(
            "--operate is for a fleet that flies; in a replay nothing can be ordered. Leave it out."
        )
    require_loopback(host)

    if fleet and not replay:
        config = load_fleet(fleet)
        ground = None if tiles is None else read_ground_tiles(tiles, config)
        return asyncio.run(_serve_fleet(config, host, port, can_order=operate, ground=ground))
    if replay and not fleet:
        return asyncio.run(_serve_record(replay, host, port, tiles))
    raise ConfigError("Give one of --fleet FILE and --replay DIR.")


async def _serve_fleet(
    fleet: FleetConfig, host: str, port: int, *, can_order: bool, ground: GroundTiles | None
) -> int:
    """Serve the page of a fleet until an interrupt."""
    title = f"Covey: {fleet.fleet.name}"
    if can_order:
        client = FleetClient(fleet)
        key = secrets.token_urlsafe(_KEY_BYTES)
    else:
        client = FleetClient(fleet, operates=False, bus=session(fleet, WATCHER))
        key = ""
        title += " (read-only)"

    feed = LiveFeed(fleet, client, can_order=can_order, ground=ground)
    server = PageServer(title=title, feed=feed, ground=ground, key=key)
    address = await server.start(host, port)
    try:
        await feed.start()
        return await _serve(title, address)
    finally:
        await server.stop()
        await feed.stop()


async def _serve_record(folder: Path, host: str, port: int, tiles: Path | None) -> int:
    """Serve the report of a recorded flight until an interrupt."""
    # Imported here: the page of a fleet does not need it.
    from groundstation.report.flight_page import make_page

    title = f"Covey: {folder.name}"
    server = PageServer(title=title, page=make_page(folder, tiles=tiles).text)
    address = await server.start(host, port)
    try:
        return await _serve(title, address)
    finally:
        await server.stop()


async def _serve(title: str, address: str) -> int:
    """Print the address of the page, and wait for an interrupt."""
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in end_signals():
        loop.add_signal_handler(number, ended.set)

    with contextlib.suppress(BrokenPipeError):
        print(f"{title}: open {address} on this machine. Ctrl-C ends it.", flush=True)
    await ended.wait()
    return EXIT_OK
