"""``covey web``: the console of a fleet, or of a recorded flight, in a browser of this machine."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import signal
from pathlib import Path

from groundstation.recording.replay import open_flight
from groundstation.web.server import ConsoleServer, require_loopback
from onboard.config.fleet import ConfigError, load_fleet

DEFAULT_PORT = 8000


def main(argv: list[str]) -> int:
    """Entry of ``covey web``; ends with an interrupt, exit status 0."""
    parser = argparse.ArgumentParser(
        prog="covey web",
        description="The console in a browser of this machine. Pages only watch unless --operate is given: nothing "
        "that is pressed in them reaches a vehicle. Nothing is loaded from the internet.",
        epilog="Exit status: 0 ended by an interrupt; 2 wrong input, nothing was served.",
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--fleet", metavar="FILE", help="watch the fleet of this file")
    what.add_argument("--replay", metavar="DIR", help="play a recorded flight; each page plays for itself")
    parser.add_argument("--operate", action="store_true", help="pages may give orders; one operator at a time, as ever")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"0 takes any (default {DEFAULT_PORT})")
    parser.add_argument("--host", default="127.0.0.1", help="a loopback address (default 127.0.0.1)")
    options = parser.parse_args(argv)
    if not 0 <= options.port <= 65535:
        raise ConfigError(f"--port {options.port}: ports lie between 0 and 65535.")
    if options.replay and options.operate:
        raise ConfigError("--operate is for a fleet that flies; in a replay nothing can be ordered. Leave it out.")
    require_loopback(options.host)
    if options.replay:
        words, title = _replay(Path(options.replay))
    else:
        words, title = _fleet(options.fleet, can_order=options.operate)
    ended = "The console has ended. A fleet that flies goes on flying."
    server = ConsoleServer(words, title=title, ended=ended)
    return asyncio.run(_serve(server, title, options.host, options.port))


def _fleet(path: str, *, can_order: bool) -> tuple[list[str], str]:
    fleet = load_fleet(path)  # a wrong file is told here, not in every page
    words = ["tui", "--fleet", str(Path(path).absolute())]
    if can_order:
        return words, f"Covey: {fleet.fleet.name}"
    return [*words, "--readonly"], f"Covey: {fleet.fleet.name} (read-only)"


def _replay(folder: Path) -> tuple[list[str], str]:
    _, timeline = open_flight(folder)
    timeline.close()
    return ["replay", str(folder.absolute())], f"Covey: replay of {folder.name}"


async def _serve(server: ConsoleServer, title: str, host: str, port: int) -> int:
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
    return 0
