"""``covey replay``: a recorded flight in the console, or its events as text.

Examples:
  covey replay flights/first
  covey replay flights/first --at 12 --speed 0.5
  covey replay flights/first --headless --json
  covey replay flights/first --csv flown
  covey replay flights/first --orders

Keys: space play or pause; , and . one step; left and right 5 s; n and N next
event and the one before; < and > speed; home and end.

Exit status: 0; 2 when there is no record to open.
"""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File, Folder, Seconds
from groundstation.commands.tui import require_terminal
from groundstation.recording.audit import trail, trail_lines
from groundstation.recording.flown_paths import write_csvs
from groundstation.recording.replay import SPEEDS, Replay, open_flight, story
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK

_LATEST_S = 1e9


def replay(
    flight: Annotated[Path, Parameter(name="DIR")],
    /,
    *,
    fleet: File | None = None,
    speed: Annotated[float, Parameter(metavar="X")] = 1.0,
    at: Seconds = 0.0,
    headless: bool = False,
    json: bool = False,
    csv: Folder | None = None,
    orders: bool = False,
) -> int:
    """Open a recorded flight in the console: play, pause, step, seek, jump from event to event.

    Args:
        flight: flight folder, or the MCAP file of one
        fleet: fleet file, where none lies beside the record
        speed: times real time
        at: begin at this second
        headless: no console: print what happened
        json: with --headless: as JSON
        orders: no console: print who ordered what, when, the vehicle's answer, and how it ended
        csv: no console: write t,x,y,z,yaw of each vehicle into this folder; docs/shows.md flies
            them again
    """
    if csv is not None:
        print("\n".join(str(path) for path in write_csvs(flight, Path(csv))))
        return EXIT_OK

    slowest, fastest = SPEEDS[0], SPEEDS[-1]
    if not slowest <= speed <= fastest:
        raise ConfigError(f"--speed is {speed:g}; it must lie between {slowest:g} and {fastest:g}.")
    if not 0.0 <= at < _LATEST_S:
        raise ConfigError(f"--at is {at:g}; it must be a number of seconds, 0 or more.")

    config, timeline = open_flight(flight, fleet)
    with contextlib.closing(timeline):
        if orders:
            print("\n".join(trail_lines(trail(timeline))))
            return EXIT_OK

        shown = Replay(config, timeline, speed=speed)
        if headless or json:
            print(asyncio.run(story(shown, is_json=json)))
            return EXIT_OK

        require_terminal("Add --headless.")
        # Imported here: what is only printed needs no textual.
        from groundstation.console.replay_app import ReplayApp

        app = ReplayApp(shown, title=f"replay of {flight.name}", at_s=at)
        return asyncio.run(app.run_to_end())
