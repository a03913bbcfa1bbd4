"""The pause of vehicles that follow another vehicle.

The order `pause` lets vehicles that follow a leader hold where they are. The weakest battery limits
the pause, be it the leader's or a follower's: pause_watch.py brings all of them home that can fly
there, while that battery has enough charge for it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Protocol

from groundstation.missions.pause_watch import PauseGround, PauseWatch
from groundstation.missions.taken import FleetWatch, flown_by_hand
from groundstation.orders.battery_reserve import Reserve
from groundstation.orders.result import OrderFailed
from onboard.bus.schema import Telemetry

ORDERED = "ordered"  # the reason that a vehicle reports for what an order lets it do
_LOOK_S = 0.5  # period at which a pause is checked
_HOME_S = 90.0  # longest wait for vehicles that are brought home


class FollowGround(PauseGround, Protocol):
    """What a pause of followers needs from the flight's :class:`MissionGround`."""

    watch: FleetWatch  # its takeover() returns who has taken the fleet from this ground, or None


class FollowPause:
    """Knows from telemetry whether followers are paused, whichever ground station paused them.

    Args:
        ground: sends the mission's orders, and shows the mission's lines and title to the user.
        leader: name of the vehicle that they follow.
        names: names of the followers.
    """

    def __init__(self, ground: FollowGround, leader: str, names: tuple[str, ...]) -> None:
        self.has_brought_home = False
        self._leader = leader
        self._names = names
        self._ground = ground
        self._watch = PauseWatch(ground)
        self._have_followed: set[str] = set()

    @property
    def is_paused(self) -> bool:
        """Whether at least one follower holds until `resume`."""
        for name in self._names:
            telemetry = self._ground.client.state.vehicles[name].telemetry
            if telemetry is not None and telemetry.follows and telemetry.is_path_paused:
                return True
        return False

    def update(self) -> Reserve | None:
        """Note who follows, and return the weakest battery with its charge for the way home.

        Call it about once a second. The result is None if no vehicle reports its battery.
        """
        for name in self._names:
            telemetry = self._ground.client.state.vehicles[name].telemetry
            if telemetry is not None and telemetry.follows:
                self._have_followed.add(name)
        return self._watch.weakest_battery(self._can_go_home())

    def stopped(self) -> dict[str, Telemetry]:
        """Return the vehicles that have followed and were stopped: name -> telemetry.

        Its reason is ``ORDERED`` for a vehicle that holds because of an order to skip the rest.
        """
        stopped = {}
        for name in self._have_followed:
            telemetry = self._ground.client.state.vehicles[name].telemetry
            if telemetry is None or telemetry.follows or telemetry.state == "flying":
                continue
            stopped[name] = telemetry
        return stopped

    def begin_anew(self, names: Iterable[str]) -> None:
        """Forget that vehicles have followed, because they will follow again.

        Args:
            names: names of the vehicles.
        """
        self._have_followed.difference_update(names)

    def leave_out(self, names: tuple[str, ...]) -> None:
        """Forget these vehicles, which no longer follow.

        Args:
            names: names of the vehicles.
        """
        self._names = tuple(name for name in self._names if name not in names)
        self._have_followed.difference_update(names)

    async def wait(self) -> int:
        """Wait until the pause has ended, and return how long it was [ns].

        The wait also ends when somebody else takes the fleet.

        Raises:
            OrderFailed: the weakest battery had just enough charge for the way home, so all were
                brought home.
        """
        ground = self._ground
        begin_ns = ground.client.now_ns()
        reserve = self.update()
        if reserve is not None:
            ground.say(f"  paused; {reserve}")

        try:
            while self.is_paused:
                is_taken = ground.watch.takeover() is not None
                if is_taken:
                    break

                self._watch.show(reserve)
                if reserve is not None and reserve.is_used_up:
                    self.has_brought_home = True
                    intent, results = await self._watch.bring_home(
                        self._can_go_home(), reserve, _HOME_S
                    )
                    raise OrderFailed(intent, results)

                await asyncio.sleep(_LOOK_S)
                reserve = self.update()
        finally:
            self._watch.hide()

        return ground.client.now_ns() - begin_ns

    def _can_go_home(self) -> tuple[str, ...]:
        """Return who of leader and followers can be brought home.

        Whoever has lost its position lands by itself, and a pilot's vehicle takes no such order.
        """
        client = self._ground.client
        by_hand = flown_by_hand(client)
        names = []
        for name in (self._leader, *self._names):
            view = client.state.vehicles[name]
            knows_position = view.telemetry is not None and view.telemetry.is_position_valid
            if view.is_airborne and knows_position and name not in by_hand:
                names.append(name)
        return tuple(names)
