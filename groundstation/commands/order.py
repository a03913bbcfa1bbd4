"""``covey order``: one order from a shell or a script, one line per vehicle, an exit status.

Examples, with the orders of the console:
  covey order --fleet fleet.toml takeoff all 1.0
  covey order --fleet fleet.toml move mav1 0 1 1.2
  covey order --fleet fleet.toml formation triangle 1.6
  covey order --fleet fleet.toml locate mav1
  covey order --fleet fleet.toml land all --json

Unlike the console, this command sends the order without a question or a
preview. Land, hold and kill are sent whichever ground operates the fleet. Other
orders need control of the fleet: the command takes it if no ground has it, and
gives it back at the end.

Exit status: 0 every vehicle did it; 1 none did; 2 wrong input, nothing sent; 10
nobody answered; 50 some did; 130 interrupted.
"""

from __future__ import annotations

import asyncio
import sys
from json import dumps
from typing import Annotated

from cyclopts import Parameter

from groundstation.client.client import FleetClient
from groundstation.client.ground_node import session
from groundstation.client.one_order import CONNECT_S, longest_start_s, order_once
from groundstation.commands.parameters import FleetFile, Seconds
from groundstation.orders.grammar import parse
from groundstation.orders.intents import Intent
from groundstation.orders.result import Results
from onboard.bus.session import BusSession
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_MIXED, EXIT_NO_ANSWER, EXIT_OK
from onboard.plain_text import fitted, plain_line

_LONGEST_S = 3600.0


def order(
    *words: Annotated[str, Parameter(name="WORD", required=True)],
    fleet: FleetFile,
    timeout: Seconds = 60.0,
    json: bool = False,
) -> int:
    """Send one order to a flying fleet.

    Args:
        words: the order
        timeout: longest wait for the end of the order
        json: a list with one object per vehicle
    """
    config = load_fleet(fleet)
    intent = parse(" ".join(words), config)
    if not 0.0 < timeout <= _LONGEST_S:
        raise ConfigError(f"--timeout is {timeout:g}; give seconds between 0 and 3600.")

    results = asyncio.run(_connect_and_order(config, intent, timeout))
    if json:
        _print_json(results)
    else:
        _print_lines(results)
    return exit_status(results)


async def _connect_and_order(fleet: FleetConfig, intent: Intent, timeout_s: float) -> Results:
    bus: BusSession | None = None
    if longest_start_s(fleet, intent) is not None:
        # The command ends no earlier than its search for a router.
        bus = session(fleet, router_timeout_s=CONNECT_S)
    return await order_once(FleetClient(fleet, bus=bus), intent, timeout_s, say=_warn)


def _warn(sentence: str) -> None:
    print(fitted(plain_line(sentence), sys.stderr), file=sys.stderr, flush=True)


def _print_json(results: Results) -> None:
    rows = [
        {"vehicle": result.vehicle, "phase": result.phase, "sentence": result.sentence}
        for result in results.values()
    ]
    print(dumps(rows, indent=2))


def _print_lines(results: Results) -> None:
    for result in results.values():
        line = f"{result.vehicle}: {result.phase}. {result.reason}".rstrip()
        stream = sys.stdout if result.is_done else sys.stderr
        print(fitted(plain_line(line), stream), file=stream)


def exit_status(results: Results) -> int:
    """Return 0 if all vehicles did it, 50 if some did, 10 if none answered, or else 1."""
    done = [result for result in results.values() if result.is_done]
    if len(done) == len(results):
        return EXIT_OK
    if done:
        return EXIT_MIXED
    if all(result.is_silent for result in results.values()):
        return EXIT_NO_ANSWER
    return EXIT_FAILED
