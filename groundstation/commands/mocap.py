"""``covey mocap``: the relay from a motion capture to the fleet's bus, and its check.

Examples:
  covey mocap --fleet fleet.toml
  covey mocap --fleet fleet.toml --source vicon --hostname 192.168.1.5
  covey mocap --fleet fleet.toml --check

Exit status: 0 stopped, or at the end every vehicle's body is tracked and does not repeat the same
numbers (with --check also: each vehicle has its own body, and right stamps); 1 one of these is
wrong; 2 wrong input; 10 no body was seen.
docs/mocap.md says more.
"""

from __future__ import annotations

import signal
import threading
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import FleetFile, Seconds, refuse_wrong_times
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.config.mocap import SystemType, problems
from onboard.end_signals import end_signals
from onboard.mocap.relay.body_check import MocapCheck
from onboard.mocap.relay.mocap_relay import MocapRelay, with_source


def mocap(
    *,
    fleet: FleetFile,
    source: Annotated[SystemType | None, Parameter(choices=SystemType)] = None,
    hostname: Annotated[str | None, Parameter(metavar="HOST")] = None,
    check: bool = False,
    seconds: Seconds | None = None,
    every_s: Seconds = 2.0,
) -> int:
    """Read a motion capture and publish its bodies on the fleet's bus.

    Args:
        source: kind of motion capture, instead of mocap.type
        hostname: computer of the motion capture, instead of mocap.hostname
        check: only listen: does each vehicle have its own body, axes and stamps?
        seconds: end after this time (default: run until Ctrl-C)
        every_s: time between reports
    """
    refuse_wrong_times(seconds, every_s)
    config = load_fleet(fleet)
    runner: MocapCheck | MocapRelay
    if check:
        runner = MocapCheck(config, _print)
    else:
        runner = _relay(config, source, hostname)

    stopped = threading.Event()
    for number in end_signals():  # all end the relay cleanly
        signal.signal(number, lambda *_: stopped.set())
    return runner.run(seconds=seconds, every_s=every_s, stopped=stopped)


def _relay(fleet: FleetConfig, source: SystemType | None, hostname: str | None) -> MocapRelay:
    """Return the relay of a fleet's motion capture, or of the one that the options name.

    Raises:
        ConfigError: the motion capture is not configured, or wrongly.
    """
    config = with_source(fleet, type_=source, hostname=hostname)
    no_bodies: dict[str, str] = {}  # the relay reads all bodies, whichever vehicle has them
    problem = next(problems(config.mocap, no_bodies), None)
    if problem is not None:
        raise ConfigError(f"{fleet.path}: {problem}")

    if config.mocap.source == "bus":
        raise ConfigError(
            f"{fleet.path}: there is no motion capture to read: mocap.source is 'bus'. "
            'Add a table [mocap] with source = "motioncapture", type and hostname '
            "(docs/mocap.md), or give --source and --hostname."
        )
    return MocapRelay(config, _print)


def _print(line: str) -> None:
    print(line, flush=True)
