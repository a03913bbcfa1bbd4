"""``covey order``: one order from a shell or a script, one line per vehicle, an exit status. No questions are asked."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.missions.verdict import EXIT_FAILED, EXIT_MIXED, EXIT_NO_ANSWER, EXIT_OK
from groundstation.orders.grammar import Intent, OrderError, parse
from groundstation.orders.result import VehicleResult
from onboard.bus.authority import EMERGENCY
from onboard.bus.protocol import BusError
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet

CONNECT_S = 3.0
_EPILOG = (
    "Orders as in the console: takeoff all 1.0, move mav1 0 1 1.2, formation triangle 1.6, land all, locate mav1. "
    "Nothing is shown ahead: `covey check` and the console do that. Land, hold and kill go at once, whoever operates; "
    "other orders need control, which is taken when nobody has it and given back at the end. Exit status: 0 every "
    "vehicle did it; 1 none did; 2 wrong input, nothing sent; 10 nobody answered; 50 some did; 130 interrupted."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Give one order; the exit status. ConfigError where nothing was sent."""
    parser = argparse.ArgumentParser(prog="covey order", description="Give a flying fleet one order.", epilog=_EPILOG)
    parser.add_argument("words", nargs="+", metavar="WORD", help="the order")
    parser.add_argument("--fleet", metavar="FILE", required=True, help="fleet file")
    parser.add_argument(
        "--timeout", type=float, metavar="S", default=60.0, help="wait so long for its end (default 60)"
    )
    parser.add_argument("--json", action="store_true", help="a list with one object per vehicle")
    options = parser.parse_args(argv)
    fleet = load_fleet(options.fleet)
    try:
        intent = parse(" ".join(options.words), fleet)
    except OrderError as error:
        raise ConfigError(str(error)) from None
    if not 0.0 < options.timeout <= 3600.0:
        raise ConfigError(f"--timeout is {options.timeout:g}; give seconds between 0 and 3600.")
    try:
        results = asyncio.run(give(fleet, intent, options.timeout))
    except BusError as error:
        raise ConfigError(str(error)) from None
    if options.json:
        rows = [{"vehicle": one.vehicle, "phase": one.phase, "sentence": one.sentence} for one in results.values()]
        print(json.dumps(rows, indent=2))
    else:
        for one in results.values():
            print(
                f"{one.vehicle}: {one.phase}. {one.sentence}".rstrip(), file=sys.stdout if one.is_done else sys.stderr
            )
    return exit_status(results)


async def give(fleet: FleetConfig, intent: Intent, timeout_s: float) -> dict[str, VehicleResult]:
    """Connect, give the order, wait for its end."""
    client = FleetClient(fleet)
    await client.start()
    try:

        def is_heard(state: FleetState) -> bool:
            views = [state.vehicles[name] for name in intent.vehicles if name in state.vehicles]
            knows_operator = client.control.is_operator or client.control.refusal(intent.verb) is not None
            return all(view.telemetry is not None for view in views) and (intent.verb in EMERGENCY or knows_operator)

        await client.wait_for(is_heard, CONNECT_S)
        return await client.order(intent, timeout_s)
    finally:
        await client.stop()


def exit_status(results: dict[str, VehicleResult]) -> int:
    """What the results mean for a script."""
    done = sum(one.is_done for one in results.values())
    if done == len(results):
        return EXIT_OK
    if done:
        return EXIT_MIXED
    return EXIT_NO_ANSWER if all(one.phase == "no answer" for one in results.values()) else EXIT_FAILED
