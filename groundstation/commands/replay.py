"""``covey replay``: a recorded flight in the console, or its events as text.

Examples:
  covey replay flights/first
  covey replay flights/first --at 12 --speed 0.5
  covey replay flights/first --headless --json
  covey replay flights/first --csv flown
  covey replay flights/first --orders
  covey replay flights/first --resume-at 12.5 --what-if wind=4,0 --record flights/windy

Keys: space play or pause; , and . one step; left and right 5 s; n and N next
event and the one before; < and > speed; home and end.

Exit status: 0; 2 when there is no record to open, or it cannot be flown again;
1 when the mission that was flown again has failed.
"""

from __future__ import annotations

import asyncio
import contextlib
import shlex
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from groundstation.commands.notes import print_notes
from groundstation.commands.parameters import File, Folder, Seconds
from groundstation.commands.tui import require_terminal
from groundstation.flights.changes import parse_change
from groundstation.flights.flight_settings import flight_folder, refuse_flown_folder
from groundstation.flights.recorded_flight import open_recorded
from groundstation.missions.lasting_output import lasting_output, termination_signals_as_ctrl_c
from groundstation.recording.audit import trail, trail_lines
from groundstation.recording.flown_paths import write_csvs
from groundstation.recording.replay import SPEEDS, Replay, open_flight, story
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK

_LATEST_S = 1e9  # later than the end of every record
_AGAIN = Group("Fly a flight in lockstep again", sort_key=8)


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
    resume_at: Annotated[float | None, Parameter(group=_AGAIN, metavar="S")] = None,
    what_if: Annotated[tuple[str, ...], Parameter(group=_AGAIN, metavar="KEY=VALUE")] = (),
    record: Annotated[Path | None, Parameter(group=_AGAIN, metavar="DIR")] = None,
) -> int:
    """Open a recorded flight in the console: play, pause, step, seek, jump from event to event.

    Args:
        flight: flight folder, or the MCAP file of one
        fleet: fleet file, if there is none beside the record
        speed: speed as a multiple of real time, in the console
        at: begin at this second, in the console
        headless: no console: print what happened
        json: with --headless: as JSON
        orders: no console: print who ordered what, when, the vehicle's answer, and how it ended
        csv: no console: write t,x,y,z,yaw of each vehicle into this folder; docs/shows.md flies
            them again
        resume_at: fly the flight again, with the changes from this second on
        what_if: fly the flight again with this change, by default from its start; may be given
            several times
        record: folder of the new flight (default: flights/<time>)
    """
    if resume_at is not None or what_if or record is not None:
        with flight_folder(record) as folder:
            return _fly_again(flight, resume_at, what_if, folder)

    has_console = not (headless or json or orders or csv is not None)
    if not has_console and (at or speed != 1.0):
        raise ConfigError("--at and --speed are for the console: leave them out.")

    if csv is not None:
        paths, notes = write_csvs(flight, Path(csv))
        print("\n".join(str(path) for path in paths))
        print_notes(flight, notes)
        return EXIT_OK

    slowest = SPEEDS[0]
    fastest = SPEEDS[-1]
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
        # Imported here: only the console needs textual.
        from groundstation.console.replay_app import ReplayApp

        app = ReplayApp(shown, title=f"replay of {flight.name}", at_s=at)
        return asyncio.run(app.run_to_end())


@lasting_output()
@termination_signals_as_ctrl_c()
def _fly_again(
    flight: Path, resume_at_s: float | None, what_if: tuple[str, ...], folder: Path
) -> int:
    """Fly a recorded flight again and print its outcome; return the exit status of its verdict."""
    # Imported here: only a flight that is flown again needs the simulation.
    from sitl.lockstep.reflight import fly_again

    if resume_at_s is not None and not 0.0 <= resume_at_s < _LATEST_S:
        raise ConfigError(
            f"--resume-at is {resume_at_s:g}; it must be a number of seconds, 0 or more."
        )
    changes = [parse_change(text) for text in what_if]
    flown = open_recorded(flight)
    refuse_flown_folder(folder)

    reflown = fly_again(
        flown,
        folder=folder,
        resume_at_s=resume_at_s,
        changes=changes,
        say=lambda line: print(line, flush=True),
    )

    for line in reflown.verdict.sentences:
        print(f"{reflown.flown_s:6.1f} s  {line}")
    for line in reflown.never_happened:
        print(f"{reflown.flown_s:6.1f} s  {line}")
    if flown.digests:
        print(f"Its state was the recorded one up to {reflown.equal_until_s:g} s.")
    both = shlex.join(["covey", "report", str(folder), "--compare", str(flight)])
    print(f"Both ways side by side: {both}")
    return reflown.verdict.exit_status
