"""This ground's own link to the vehicles: lost when nobody of several in flight is heard.

Vehicles that all fall silent at once have not all failed: this ground has lost its link. They go on
under the law, because agents hear each other, and land by themselves when no ground was heard for
``ground_lost_land_s``. An agent that is dead or hangs sends no setpoints, and its PX4 lands. So a
mission waits.
"""

from __future__ import annotations

import asyncio
import math

from groundstation.client.client import FleetClient
from groundstation.fleet.own_stall import AFTER_STALL_S

SILENT_S = 2.0  # in the air: the agent hangs, or is cut off
_LOOK_PERIOD_S = 0.2
_COUNTDOWN_PERIOD_S = 10.0


def silent_in_flight(client: FleetClient) -> list[str]:
    """Return the vehicles whose last telemetry was armed and is older than SILENT_S.

    There are none after a stall of this ground itself.
    """
    now_ns = client.now_ns()
    if client.state.is_after_stall(now_ns):
        return []

    silent = []
    for name, view in client.state.vehicles.items():
        if view.telemetry is None or not view.telemetry.is_armed:
            continue
        if view.age_s(now_ns) > SILENT_S:
            silent.append(name)
    return silent


class OwnLink:
    """The link of the ground that flies a mission.

    Args:
        client: fleet client that has been started.
    """

    def __init__(self, client: FleetClient) -> None:
        self._client = client
        self._is_lost = False
        self._heard_ns = 0  # last telemetry before the loss
        self._back_ns = 0  # first telemetry after the loss; 0: none yet
        self._said_s = 0.0  # time without anybody, when it was said last
        self._lost_before_s = 0.0  # length of earlier losses
        self._settled_ns = 0  # until then vehicles that come back later are not yet silent

    @property
    def is_lost(self) -> bool:
        """Whether nobody is heard, or not everybody again."""
        return self._is_lost

    @property
    def lost_s(self) -> float:
        """Time without a link so far [s]."""
        if not self._is_lost:
            return self._lost_before_s
        return self._lost_before_s + self._silent_for_s()

    @property
    def landing_in_s(self) -> float:
        """Time until the agents land by themselves [s]; infinite while the link is there."""
        if not self._is_lost or self._back_ns:
            return math.inf
        return self._client.fleet.fleet.ground_lost_land_s - self._silent_for_s()

    @property
    def is_settling(self) -> bool:
        """Whether the link came back just now: connections come back one after another."""
        return self._client.now_ns() < self._settled_ns

    def look(self) -> None:
        """Notice that the link is lost or back, and say so; call it several times a second."""
        if self._is_lost:
            self._look_for_return()
        elif self._hears_nobody():
            self._lose()

    async def heard(self) -> bool:
        """Wait while the link is lost, at most until the agents land by themselves.

        Returns:
            Whether there was something to wait for, and the link is back.
        """
        self.look()
        has_waited = False
        while self._is_losing() or (self._is_lost and self.landing_in_s > 0.0):
            has_waited = True
            await asyncio.sleep(_LOOK_PERIOD_S)
            self.look()
        return has_waited and not self._is_lost

    # -- the loss ----------------------------------------------------------------------------------

    def _hears_nobody(self) -> bool:
        """Whether two or more fly, by what was heard last, and nobody has been heard for long."""
        return bool(silent_in_flight(self._client)) and self._is_nobody_fresh()

    def _is_losing(self) -> bool:
        """Whether nobody is heard, but not for so long that the link counts as lost."""
        return not self._is_lost and self._is_nobody_fresh()

    def _is_nobody_fresh(self) -> bool:
        """Whether two or more fly, by what was heard last, and no telemetry is of the present.

        Telemetry of several vehicles never ends at the same moment: when the first has been silent
        for SILENT_S, those that fell silent with it have long been stale.
        """
        now_ns = self._client.now_ns()
        views = self._client.state.vehicles.values()
        return len(self._in_flight()) >= 2 and not any(view.is_fresh(now_ns) for view in views)

    def _lose(self) -> None:
        vehicles = self._client.state.vehicles
        self._is_lost = True
        self._heard_ns = max(vehicles[name].received_ns for name in self._in_flight())
        self._back_ns = 0
        self._said_s = self._silent_for_s()

        sentence = (
            "I hear nobody: my own link. The vehicles finish their orders and hold; "
            f"their agents land them in {self.landing_in_s:.0f} s."
        )
        self._client.publish_event("critical", "own_link_lost", sentence)

    def _count_down(self) -> None:
        silent_for_s = self._silent_for_s()
        if silent_for_s - self._said_s < _COUNTDOWN_PERIOD_S or self.landing_in_s <= 0.0:
            return

        self._said_s = silent_for_s
        sentence = (
            f"I have heard nobody for {silent_for_s:.0f} s: my own link. "
            f"The agents land in {self.landing_in_s:.0f} s."
        )
        self._client.publish_event("warning", "own_link_lost", sentence)

    # -- the return --------------------------------------------------------------------------------

    def _look_for_return(self) -> None:
        """End the loss when all who fly are heard, or some time after the first is heard."""
        now_ns = self._client.now_ns()
        vehicles = self._client.state.vehicles
        if not self._back_ns:
            if not any(view.is_fresh(now_ns) for view in vehicles.values()):
                self._count_down()
                return
            self._back_ns = now_ns
            self._client.notice_own_link()

        flying = self._in_flight()
        is_all_heard = all(vehicles[name].is_fresh(now_ns) for name in flying)
        waited_s = (now_ns - self._back_ns) * 1e-9
        if not is_all_heard and waited_s < AFTER_STALL_S:
            return

        silent_for_s = self._silent_for_s()
        self._lost_before_s += silent_for_s
        self._is_lost = False
        self._settled_ns = now_ns + round(SILENT_S * 1e9)
        self._client.notice_own_link()
        sentence = f"The link is back after {silent_for_s:.1f} s: the mission goes on."
        self._client.publish_event("warning", "own_link_back", sentence)

    def _silent_for_s(self) -> float:
        return (self._client.now_ns() - self._heard_ns) * 1e-9

    def _in_flight(self) -> list[str]:
        """Return the vehicles that were armed when last heard, and not disarmed by PX4 since."""
        return [name for name, view in self._client.state.vehicles.items() if view.is_armed]
