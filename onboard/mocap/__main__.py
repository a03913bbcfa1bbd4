"""``covey mocap`` and ``python -m onboard.mocap``: the relay from a motion capture to the fleet's bus."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Sequence
from typing import get_args

from onboard.bus.protocol import BusError
from onboard.config.fleet import ConfigError, load_fleet
from onboard.config.mocap import SystemType, problems
from onboard.mocap.relay.check import Check
from onboard.mocap.relay.relay import Relay, with_source

EXIT_WRONG_INPUT = 2


def parser() -> argparse.ArgumentParser:
    """The command line of the relay."""
    found = argparse.ArgumentParser(
        prog="covey mocap",
        description="Read a motion capture and give its bodies to the fleet's bus; docs/mocap.md says more.",
        epilog="Exit status: 0 stopped, or all is right at the end (every vehicle's body tracked; with --check its own "
        "one, and its stamps right); 1 something is not; 2 wrong input; 10 no body was seen.",
    )
    found.add_argument("--fleet", required=True, metavar="FILE", help="fleet file, with its table [mocap]")
    found.add_argument(
        "--source", choices=get_args(SystemType), metavar="TYPE", help=f"instead of mocap.type: {_types()}"
    )
    found.add_argument("--hostname", metavar="HOST", help="instead of mocap.hostname")
    found.add_argument(
        "--check", action="store_true", help="only listen: does each vehicle have its own body, axes and stamps?"
    )
    found.add_argument("--seconds", type=float, metavar="S", help="end after so long (default: run until Ctrl-C)")
    found.add_argument("--every-s", type=float, default=2.0, metavar="S", help="time between reports (default 2)")
    return found


def _types() -> str:
    return ", ".join(get_args(SystemType))


def print_line(line: str) -> None:
    """For a person or a log, at once."""
    print(line, flush=True)


def run_until_stopped(what: Relay | Check, *, seconds: float | None, every_s: float) -> int:
    """Run until Ctrl-C, which is a clean end, or for ``seconds``; exit status."""
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    return what.run(seconds=seconds, every_s=every_s, stopped=stopped)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the relay; exit status."""
    arguments = parser().parse_args(argv)
    try:
        if not 0.1 <= arguments.every_s <= 3600.0 or not (arguments.seconds is None or arguments.seconds >= 0.5):
            raise ConfigError("--every-s must lie between 0.1 and 3600, --seconds be 0.5 or more.")
        if arguments.check:
            return run_until_stopped(
                Check(load_fleet(arguments.fleet), print_line), seconds=arguments.seconds, every_s=arguments.every_s
            )
        fleet = with_source(load_fleet(arguments.fleet), type_=arguments.source, hostname=arguments.hostname)
        for sentence in problems(fleet.mocap, {}):
            raise ConfigError(f"{arguments.fleet}: {sentence}")
        if fleet.mocap.source == "bus":
            raise ConfigError(
                f"{arguments.fleet}: there is no motion capture to read: mocap.source is 'bus'. Add a table [mocap] "
                'with source = "motioncapture", type and hostname (docs/mocap.md), or give --source and --hostname.'
            )
        relay = Relay(fleet, print_line)
        return run_until_stopped(relay, seconds=arguments.seconds, every_s=arguments.every_s)
    except (ConfigError, BusError) as error:
        print(f"mocap: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT


if __name__ == "__main__":
    sys.exit(main())
