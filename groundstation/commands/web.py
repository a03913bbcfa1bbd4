"""``covey web``: the console of a fleet, or of a recorded flight, in a browser of this machine.

Examples:
  covey web --fleet fleet.toml
  covey web --replay flights/first --port 0

Exit status: 0 ended by an interrupt; 2 wrong input, nothing was served.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
import sys
from pathlib import Path
from typing import NamedTuple

from groundstation.commands.parameters import File, Folder
from groundstation.recording.replay import open_flight
from groundstation.web.page_server import ConsoleServer, require_loopback
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_OK

_KEY_BYTES = 24  # of the address at which pages may give orders


def web(
    *,
    fleet: File | None = None,
    replay: Folder | None = None,
    operate: bool = False,
    port: int = 8000,
    host: str = "127.0.0.1",
) -> int:
    """Show the console in a browser of this machine.

    Pages only watch unless --operate is given: nothing that is pressed in them reaches a vehicle.
    Nothing is loaded from the internet.

    Args:
        fleet: watch the fleet of this file
        replay: play a recorded flight; each page plays for itself
        operate: pages may give orders, one operator at a time; the printed address has a key, new
            at every start
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
        shown = _of_fleet(fleet, can_order=operate)
    elif replay and not fleet:
        shown = _of_replay(replay)
    else:
        raise ConfigError("Give one of --fleet FILE and --replay DIR.")

    server = ConsoleServer(
        [sys.executable, "-m", "groundstation", *shown.words],
        title=shown.title,
        ended="The console has ended. A fleet that flies goes on flying.",
        key=secrets.token_urlsafe(_KEY_BYTES) if operate else "",
    )
    return asyncio.run(_serve(server, shown.title, host, port))


class _Shown(NamedTuple):
    """What each page shows."""

    words: list[str]  # of the command that runs in it, behind covey
    title: str


def _of_fleet(path: str, *, can_order: bool) -> _Shown:
    """Return the console of a fleet; a wrong file is refused here, not in every page."""
    fleet = load_fleet(path)
    words = ["tui", "--fleet", str(Path(path).absolute())]
    if can_order:
        return _Shown(words, f"Covey: {fleet.fleet.name}")
    return _Shown([*words, "--readonly"], f"Covey: {fleet.fleet.name} (read-only)")


def _of_replay(folder: Path) -> _Shown:
    """Return the replay of a record; a wrong one is refused here, not in every page."""
    _, timeline = open_flight(folder)
    timeline.close()
    return _Shown(["replay", str(folder.absolute())], f"Covey: replay of {folder.name}")


async def _serve(server: ConsoleServer, title: str, host: str, port: int) -> int:
    """Serve pages until an interrupt."""
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)

    address = await server.start(host, port)
    with contextlib.suppress(BrokenPipeError):
        print(f"{title}: open {address} on this machine. Ctrl-C ends it.", flush=True)
    try:
        await ended.wait()
    finally:
        await server.stop()
    return EXIT_OK
