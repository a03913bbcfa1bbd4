"""``covey corrections``: the node that brings RTK corrections to the fleet's bus.

Examples:
  covey corrections --fleet fleet.toml
  covey corrections --fleet fleet.toml --check --seconds 10
  covey corrections --fleet fleet.toml --source mock

Exit status: 0 it was stopped, or --seconds have passed and the base's position and observations
came until then; 1 --seconds have passed and one of the two did not come; 2 wrong input; 10 nothing
came. docs/corrections.md says more.
"""

from __future__ import annotations

import asyncio
import os
from typing import Literal

from groundstation.commands.parameters import FleetFile, Seconds, refuse_wrong_times
from onboard.config.fleet import load_fleet
from onboard.corrections.relay.corrections_relay import CorrectionsRelay, relay_problem
from onboard.corrections.relay.sources import source_of, with_source
from onboard.end_signals import end_signals


def corrections(
    *,
    fleet: FleetFile,
    source: Literal["mock"] | None = None,
    check: bool = False,
    seconds: Seconds | None = None,
    every_s: Seconds = 5.0,
) -> int:
    """Read RTK corrections and publish them on the fleet's bus.

    Args:
        source: mock: a simulated base instead of the fleet's source
        check: only read the source: what does it send, and where is its base?
        seconds: end after this time (default: run until Ctrl-C)
        every_s: time between reports
    """
    refuse_wrong_times(seconds, every_s)
    config = load_fleet(fleet)
    problem = relay_problem(config)
    if problem is not None:
        raise problem
    if source is not None:
        config = with_source(config, source)

    relay = CorrectionsRelay(
        config, lambda: source_of(config, os.environ), _print, publishes=not check
    )
    return asyncio.run(_run(relay, seconds=seconds, every_s=every_s))


async def _run(relay: CorrectionsRelay, *, seconds: float | None, every_s: float) -> int:
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in end_signals():  # all end the relay cleanly
        loop.add_signal_handler(number, stopped.set)
    return await relay.run(seconds=seconds, every_s=every_s, stopped=stopped)


def _print(line: str) -> None:
    print(line, flush=True)
