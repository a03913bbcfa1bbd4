"""A pause of vehicles that follow another one, as `pause` stops the clock of paths.

They hold where they are; a leader that follows a path is paused by its own order. While the ground
hears the fleet, all are brought home at the last moment at which the weakest battery still can:
pause_watch.py.
"""

from __future__ import annotations

import asyncio

from groundstation.missions.pause_watch import PausedGround, PauseWatch
from groundstation.orders.battery_reserve import Reserve
from groundstation.orders.result import OrderFailed

_LOOK_S = 0.5
_HOME_S = 90.0


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
        self._watch = PauseWatch(ground)

    def look(self) -> Reserve | None:
        """Return the weakest battery: call it once a second or so, also before a pause."""
        return self._watch.look(self.names)

    async def wait(self) -> int:
        """Wait until the pause has ended, and return how long it was [ns].

        Raises:
            OrderFailed: the weakest battery could not wait any longer, and all were brought home.
        """
        client = self._ground.client
        begin_ns = client.now_ns()
        try:
            while self.is_paused:
                reserve = self.look()
                self._watch.show(reserve)

                if reserve is not None and reserve.is_used_up:
                    self.has_brought_home = True
                    intent, results = await self._watch.bring_home(self.names, reserve, _HOME_S)
                    raise OrderFailed(intent, results)

                await asyncio.sleep(_LOOK_S)
        finally:
            self._watch.hide()

        return client.now_ns() - begin_ns
