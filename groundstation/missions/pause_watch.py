"""Watches the batteries of vehicles that a pause keeps in the air.

A pause may last until the weakest battery has just enough charge for the way home. Then the pause
ends, and all vehicles are brought home. The title of the flight shows the remaining time.

The same rule holds for both kinds of pause: for paths whose clock stands still (path_following.py)
and for vehicles that follow another vehicle (follow_pause.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from groundstation.client.client import FleetClient
from groundstation.mission_files.wall_time import time_words
from groundstation.missions.going_home import way_home_s
from groundstation.orders.battery_reserve import Discharge, Reserve, weakest
from groundstation.orders.intents import BringHome, Intent
from groundstation.orders.result import Results


class PauseGround(Protocol):
    """What a pause needs from the flight's :class:`MissionGround`, which gives its orders."""

    client: FleetClient
    say: Callable[[str], None]
    pause_line: str

    async def order(self, intent: Intent, timeout_s: float) -> Results:
        """Give an order, wait for its end and log the results."""


class PauseWatch:
    """Watches the batteries of some vehicles, before a pause and during it.

    Args:
        ground: gives the orders of the mission, and shows its lines and its title.
    """

    def __init__(self, ground: PauseGround) -> None:
        self._ground = ground
        self._discharge = Discharge()
        self._pause_begin_ns: int | None = None

    @property
    def paused_s(self) -> float:
        """Time for which the title has shown this pause [s]; 0 without one."""
        if self._pause_begin_ns is None:
            return 0.0
        return (self._ground.client.now_ns() - self._pause_begin_ns) * 1e-9

    def weakest_battery(self, names: Sequence[str]) -> Reserve | None:
        """Return the weakest battery, its charge and the charge that its way home needs.

        The result is None if no vehicle reports its battery.

        Call it about once a second, even before a pause, because it measures the rate of discharge.

        Args:
            names: names of the vehicles in the air.
        """
        client = self._ground.client
        return weakest(
            client.fleet,
            client.state,
            names,
            discharge=self._discharge,
            now_ns=client.now_ns(),
            paused_s=self.paused_s,
        )

    def show(self, reserve: Reserve | None) -> None:
        """Show in the title that vehicles are paused, and for how long they can be."""
        if self._pause_begin_ns is None:
            self._pause_begin_ns = self._ground.client.now_ns()
        self._ground.pause_line = pause_line(reserve)

    def hide(self) -> None:
        """Show in the title that no vehicle is paused."""
        self._pause_begin_ns = None
        self._ground.pause_line = ""

    async def bring_home(
        self, names: Sequence[str], reserve: Reserve, timeout_s: float
    ) -> tuple[BringHome, Results]:
        """End the pause: say why, and bring all home.

        Args:
            names: names of the vehicles.
            reserve: the weakest battery, which ends the pause.
            timeout_s: longest wait for their landing [s], in addition to the time of their way.

        Returns:
            The order and its results.
        """
        self._ground.say(f"  The pause ends: {reserve}.")
        intent = BringHome(vehicles=tuple(names))
        client = self._ground.client
        way_s = way_home_s(client, client.plan(intent))
        return intent, await self._ground.order(intent, way_s + timeout_s)


def pause_line(reserve: Reserve | None) -> str:
    """Return a pause in a few words, for the title: the weakest battery and its limit."""
    if reserve is None:
        return "paused"
    return (
        f"paused · {reserve.name} {reserve.has_pct:.0f} %: all home at {reserve.needs_pct:.0f} %, "
        f"in {time_words(reserve.left_s)}"
    )
