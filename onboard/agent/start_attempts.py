"""Attempts to open what an agent needs, repeated while a computer that boots may still mend it.

A serial device, the address of a network interface, a router and the time of day may come after the
agent's process. The agent then waits for them, instead of ending for good: the service of the agent
starts no process again that ended because of wrong input.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable

from onboard.autopilot import EndpointAbsentError
from onboard.bus.protocol import AddressAbsentError, NoRouterError
from onboard.security.certificate_times import NotYetValidError

_RETRY_S = 2.0  # time from one attempt to the next

# what may still come without a change of the fleet file
_MAY_COME = (EndpointAbsentError, AddressAbsentError, NoRouterError, NotYetValidError)


async def started(name: str, start: Callable[[], object], stop_requested: asyncio.Event) -> bool:
    """Call ``start`` until it succeeds or the agent is asked to stop.

    The first error that may mend itself is printed; all other errors are raised.

    Args:
        name: name of the vehicle.
        start: opens something, on the caller's thread.
        stop_requested: set when the agent is asked to stop.
    Returns:
        Whether it succeeded.
    """
    is_reported = False
    while not stop_requested.is_set():
        try:
            start()
            return True
        except _MAY_COME as error:
            if not is_reported:
                # on a line of its own, because some errors end with a command to type
                print(
                    f"agent {name}: {error}\n"
                    f"agent {name}: it waits for this, and tries again every {_RETRY_S:g} s.",
                    file=sys.stderr,
                    flush=True,
                )
            is_reported = True

        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(stop_requested.wait(), _RETRY_S)
    return False
