"""``covey replay``: a recorded flight in the console, or its events as text."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import sys
from pathlib import Path

from groundstation.recording.replay import SPEEDS, Replay, open_flight, story
from onboard.config.fleet import ConfigError


def main(argv: list[str]) -> int:
    """Replay a record; the exit status. ConfigError where there is no record to open."""
    parser = argparse.ArgumentParser(
        prog="covey replay",
        description="Open a recorded flight in the console: play, pause, step, seek, jump from event to event.",
        epilog="Keys: space play or pause; , and . one step; left and right 5 s; n and N next event and the one "
        "before; < and > speed; home and end. Exit status: 0; 2 when there is no record to open.",
    )
    parser.add_argument("flight", metavar="DIR", type=Path, help="flight folder, or the MCAP file of one")
    parser.add_argument("--fleet", metavar="FILE", help="fleet file, where none lies beside the record")
    parser.add_argument("--speed", type=_speed, default=1.0, metavar="X", help="times real time (default 1)")
    parser.add_argument("--at", type=_seconds, default=0.0, metavar="S", help="begin at this second (default 0)")
    parser.add_argument("--headless", action="store_true", help="no console: print what happened")
    parser.add_argument("--json", action="store_true", help="with --headless: as JSON")
    options = parser.parse_args(argv)
    fleet, timeline = open_flight(options.flight, options.fleet)
    with contextlib.closing(timeline):
        replay = Replay(fleet, timeline, speed=options.speed)
        if options.headless or options.json:
            print(asyncio.run(story(replay, is_json=options.json)))
            return 0
        if not (sys.stdout.isatty() or "TEXTUAL_DRIVER" in os.environ):
            raise ConfigError("The console needs a terminal, and this output is none. Add --headless.")
        from groundstation.console.replay import run_replay

        return asyncio.run(run_replay(replay, title=f"replay of {options.flight.name}", at_s=options.at))


def _speed(text: str) -> float:
    value = float(text)
    if not SPEEDS[0] <= value <= SPEEDS[-1]:
        raise argparse.ArgumentTypeError(f"{text} is not between {SPEEDS[0]:g} and {SPEEDS[-1]:g}")
    return value


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is no number of seconds from 0 on")
    return value
