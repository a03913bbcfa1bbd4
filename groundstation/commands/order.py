"""``covey order``: one order from a shell or a script, one line per vehicle, an exit status. No
questions are asked.

Examples, with the orders of the console:
  covey order --fleet fleet.toml takeoff all 1.0
  covey order --fleet fleet.toml move mav1 0 1 1.2
  covey order --fleet fleet.toml formation triangle 1.6
  covey order --fleet fleet.toml locate mav1
  covey order --fleet fleet.toml land all --json

Nothing is shown ahead: covey check and the console do that. Land, hold and kill go at once, whoever
operates; other orders need control, which is taken when nobody has it and given back at the end.
Exit status: 0 every vehicle did it; 1 none did; 2 wrong input, nothing sent; 10 nobody answered; 50
some did; 130 interrupted.
"""

from __future__ import annotations

import asyncio
import sys
from json import dumps
from typing import Annotated

from cyclopts import Parameter

from groundstation.client.client import FleetClient
from groundstation.commands.parameters import FleetFile, Seconds
from groundstation.fleet.state import FleetState
from groundstation.orders.grammar import parse
from groundstation.orders.intents import Intent
from groundstation.orders.result import VehicleResult
from onboard.bus.control_token import EMERGENCY
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_MIXED, EXIT_NO_ANSWER, EXIT_OK
from onboard.plain_text import plain_line

CONNECT_S = 3.0


def order(
    *words: Annotated[str, Parameter(name="WORD", required=True)],
    fleet: FleetFile,
    timeout: Seconds = 60.0,
    json: bool = False,
) -> int:
    """Send one order to a flying fleet.

    Args:
        words: the order
        timeout: wait so long for its end
        json: a list with one object per vehicle
    """
    config = load_fleet(fleet)
    intent = parse(" ".join(words), config)
    if not 0.0 < timeout <= 3600.0:
        raise ConfigError(f"--timeout is {timeout:g}; give seconds between 0 and 3600.")
    results = asyncio.run(send(config, intent, timeout))
    if json:
        rows = [
            {"vehicle": one.vehicle, "phase": one.phase, "sentence": one.sentence}
            for one in results.values()
        ]
        print(dumps(rows, indent=2))
        return exit_status(results)
    for one in results.values():
        line = f"{one.vehicle}: {one.phase}. {one.sentence}".rstrip()
        print(plain_line(line), file=sys.stdout if one.is_done else sys.stderr)
    return exit_status(results)


async def send(fleet: FleetConfig, intent: Intent, timeout_s: float) -> dict[str, VehicleResult]:
    """Connect, send the order and wait for its end."""
    client = FleetClient(fleet)
    await client.start()
    try:

        def is_heard(state: FleetState) -> bool:
            views = [state.vehicles[name] for name in intent.names if name in state.vehicles]
            knows_operator = (
                client.control.is_operator or client.control.refusal(intent.verb) is not None
            )
            return all(view.telemetry is not None for view in views) and (
                intent.verb in EMERGENCY or knows_operator
            )

        await client.wait_for(is_heard, CONNECT_S)
        return await client.order(intent, timeout_s)
    finally:
        await client.stop()


def exit_status(results: dict[str, VehicleResult]) -> int:
    """Return 0 when all vehicles did it, 50 when some did, 10 when nobody answered, else 1."""
    done = sum(one.is_done for one in results.values())
    if done == len(results):
        return EXIT_OK
    if done:
        return EXIT_MIXED
    return EXIT_NO_ANSWER if all(one.is_silent for one in results.values()) else EXIT_FAILED
