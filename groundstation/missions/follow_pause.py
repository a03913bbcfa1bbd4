"""A pause of vehicles that follow another one, as `pause` stops the clock of paths.

They hold where they are; a leader that follows a path is paused by its own order. While the ground
hears the fleet, all are brought home at the last moment at which the weakest battery still can.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

from groundstation.client.client import FleetClient
from groundstation.mission_files.world_time import time_words
from groundstation.orders.battery_reserve import Discharge, Reserve, weakest
from groundstation.orders.intents import BringHome, Intent
from groundstation.orders.result import OrderFailed, Results

_LOOK_S = 0.5
_HOME_S = 90.0


class PausedGround(Protocol):
    """The part of a flight's ground that a pause needs."""

    client: FleetClient
    say: Callable[[str], None]
    pause_line: str

    async def order(self, intent: Intent, timeout_s: float) -> Results:
        """Give an order, wait for its end and log the results."""


def pause_line(reserve: Reserve | None) -> str:
    """Return a pause in a few words, for the title: the weakest battery and its limit."""
    if reserve is None:
        return "paused · r goes on"
    return (
        f"paused · {reserve.name} {reserve.has_pct:.0f} %: all home at {reserve.needs_pct:.0f} %, "
        f"in {time_words(reserve.left_s)} · r goes on"
    )


class FollowPause:
    """Whether some followers are paused.

    Args:
        ground: of the flight.
        names: of the followers.
    """

    def __init__(self, ground: PausedGround, names: tuple[str, ...]) -> None:
        self.names = names
        self.is_paused = False
        self.has_brought_home = False
        self._ground = ground
        self._discharge = Discharge()

    def look(self) -> Reserve | None:
        """Look at the batteries, and return the weakest one: call it once a second or so."""
        client = self._ground.client
        return weakest(
            client.fleet,
            client.state,
            self.names,
            discharge=self._discharge,
            now_ns=client.now_ns(),
        )

    async def wait(self) -> int:
        """Wait until the pause has ended, and return how long it was [ns].

        Raises:
            OrderFailed: the weakest battery could not wait any longer, and all were brought home.
        """
        ground = self._ground
        begin_ns = ground.client.now_ns()
        try:
            while self.is_paused:
                reserve = self.look()
                ground.pause_line = pause_line(reserve)
                if reserve is not None and reserve.is_used_up:
                    await self._bring_home(reserve)
                await asyncio.sleep(_LOOK_S)
        finally:
            ground.pause_line = ""
        return ground.client.now_ns() - begin_ns

    async def _bring_home(self, reserve: Reserve) -> None:
        self._ground.say(f"  The pause ends: {reserve}.")
        self.has_brought_home = True
        intent = BringHome(vehicles=self.names)
        raise OrderFailed(intent, await self._ground.order(intent, _HOME_S))
