"""A pause of vehicles that follow another one, as `pause` stops the clock of paths.

They hold where they are; a leader that follows a path is paused by its own order. While the ground
hears the fleet, all are brought home at the last moment at which the weakest battery still can:
pause_watch.py.
"""

from __future__ import annotations

import asyncio
from typing import Protocol

from groundstation.missions.pause_watch import PausedGround, PauseWatch
from groundstation.missions.taken import FleetWatch
from groundstation.orders.battery_reserve import Reserve
from groundstation.orders.result import OrderFailed

_LOOK_S = 0.5
_HOME_S = 90.0


class FollowGround(PausedGround, Protocol):
    """The part of a flight's ground that a pause of followers needs."""

    watch: FleetWatch


class FollowPause:
    """Whether some followers are paused, by any ground: they tell it themselves.

    Args:
        ground: the mission's ground in this flight.
        names: names of the followers.
    """

    def __init__(self, ground: FollowGround, names: tuple[str, ...]) -> None:
        self.has_brought_home = False
        self._names = names
        self._ground = ground
        self._watch = PauseWatch(ground)
        self._have_followed: set[str] = set()

    @property
    def is_paused(self) -> bool:
        """Whether one of them holds until `resume`."""
        for name in self._names:
            telemetry = self._ground.client.state.vehicles[name].telemetry
            if telemetry is not None and telemetry.follows and telemetry.is_path_paused:
                return True
        return False

    def look(self) -> Reserve | None:
        """Look at all followers, and return the weakest battery: call it once a second or so."""
        for name in self._names:
            telemetry = self._ground.client.state.vehicles[name].telemetry
            if telemetry is not None and telemetry.follows:
                self._have_followed.add(name)
        return self._watch.look(self._names)

    def skipped(self) -> tuple[str, ...]:
        """Return those who have followed and were ordered to skip the rest: they hold."""
        skipped = []
        for name in self._have_followed:
            telemetry = self._ground.client.state.vehicles[name].telemetry
            holds = telemetry is not None and telemetry.state == "holding"
            if telemetry is not None and holds and not telemetry.follows:
                skipped.append(name)
        return tuple(skipped)

    def leave_out(self, names: tuple[str, ...]) -> None:
        """Look at these no more: they follow nobody any longer.

        Args:
            names: names of followers.
        """
        self._names = tuple(name for name in self._names if name not in names)
        self._have_followed.difference_update(names)

    async def wait(self) -> int:
        """Wait until the pause has ended, and return how long it was [ns].

        Raises:
            OrderFailed: the weakest battery could not wait any longer, and all were brought home.
        """
        ground = self._ground
        begin_ns = ground.client.now_ns()
        reserve = self.look()
        if reserve is not None:
            ground.say(f"  paused; {reserve}")

        try:
            while self.is_paused and ground.watch.look() is None:
                self._watch.show(reserve)
                if reserve is not None and reserve.is_used_up:
                    self.has_brought_home = True
                    intent, results = await self._watch.bring_home(self._names, reserve, _HOME_S)
                    raise OrderFailed(intent, results)

                await asyncio.sleep(_LOOK_S)
                reserve = self.look()
        finally:
            self._watch.hide()

        return ground.client.now_ns() - begin_ns
