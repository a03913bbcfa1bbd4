"""How the client programs begin and end: connect by MAVSDK, wait for something, print what was seen
as JSON.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from mavsdk import logging as mavsdk_logging
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk


async def connected(endpoint: str, kind: ComponentType) -> tuple[Mavsdk, Any]:
    """MAVSDK, to be kept as long as its system is used, and the first autopilot at an endpoint."""
    mavsdk_logging.log_subscribe(lambda *_: True)
    client = Mavsdk(Configuration.create_with_component_type(kind))
    await client.add_any_connection(endpoint)
    system = await client.first_autopilot(timeout_s=30)
    if system is None:
        raise SystemExit(f"no autopilot at {endpoint}")
    return client, system


async def first(
    stream: AsyncIterator[Any], timeout_s: float, accept: Callable[[Any], bool] = lambda _: True
) -> Any:
    """The first value of a stream that is accepted."""
    async with asyncio.timeout(timeout_s):
        async for value in stream:
            if accept(value):
                return value
    raise SystemExit("a stream ended")


def run(program: Callable[[str, dict[str, Any]], Awaitable[None]]) -> None:
    """Run a program on the endpoint of the command line; what it saw goes to stdout."""
    seen: dict[str, Any] = {}
    asyncio.run(_whole(program, seen))
    print(json.dumps(seen))


async def _whole(
    program: Callable[[str, dict[str, Any]], Awaitable[None]], seen: dict[str, Any]
) -> None:
    await program(sys.argv[1], seen)
