"""This ground's own link to the vehicles.

When several vehicles in flight all fall silent at once, not all of them have failed: this ground
has lost its link. Then the mission waits, because the vehicles are safe. Their agents hear each
other, so the avoidance law goes on, and they land when no ground was heard for
``ground_lost_land_s``. An agent that is dead or hangs sends no setpoints, and its PX4 lands.

What cuts off this ground may cut off the agents as well: from each other, if it is the fleet's
router, and from poses that come over the bus. Then they land within seconds, which this ground
cannot see.
"""

from __future__ import annotations

import asyncio
import math

from groundstation.client.client import FleetClient
from groundstation.fleet.own_stall import AFTER_STALL_S
from groundstation.fleet.state import VehicleView
from onboard.config.fleet import FleetConfig
from onboard.plain_text import listed

SILENT_S = 2.0  # age of the last telemetry of an agent that hangs or is cut off in flight
_LOOK_PERIOD_S = 0.2
_COUNTDOWN_PERIOD_S = 10.0  # time between two warnings that the agents will land
_ENDS_OF_FLIGHT = frozenset(("landing", "landed", "failed"))


def silent_in_flight(client: FleetClient) -> list[str]:
    """Return the vehicles whose last telemetry was armed and is older than SILENT_S.

    After a stall of this ground itself, no vehicle counts as silent.
    """
    now_ns = client.now_ns()
    if client.state.is_after_stall(now_ns):
        return []

    silent = []
    for name, view in client.state.vehicles.items():
        if not view.is_armed:
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
        self.cause = _cause(client.fleet)  # why no vehicle is heard, while none is
        self._exception = _exception(client.fleet)
        self._is_lost = False
        self._ordered: dict[str, str] = {}  # vehicles in flight at the loss -> kind of their order
        self._heard_ns = 0  # reception of the last telemetry before the loss
        self._back_ns = 0  # reception of the first telemetry after the loss; 0: none yet
        self._said_s = 0.0  # length of the silence at the last warning
        self._lost_before_s = 0.0  # total length of earlier losses
        # Until this time after a loss, vehicles that are not heard again do not count as silent.
        self._settled_ns = 0

    @property
    def is_lost(self) -> bool:
        """Whether no vehicle is heard, or not all vehicles are heard again after such a loss."""
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
        """Whether the link has just returned, and single vehicles may not be heard yet."""
        return self._client.now_ns() < self._settled_ns

    def update(self) -> None:
        """Notice that the link is lost or back, and say so; call it several times a second."""
        if self._is_lost:
            self._update_return()
        elif self._hears_nobody():
            self._lose()

    async def wait_while_lost(self) -> bool:
        """Wait while the link is lost, at most until the agents land by themselves.

        Returns:
            Whether the link was lost and is back now.
        """
        self.update()
        has_waited = False
        while self._has_to_wait():
            has_waited = True
            await asyncio.sleep(_LOOK_PERIOD_S)
            self.update()
        return has_waited and not self._is_lost

    # -- the loss ----------------------------------------------------------------------------------

    def _hears_nobody(self) -> bool:
        """Whether no vehicle is fresh, and one has been silent for SILENT_S in flight."""
        return bool(silent_in_flight(self._client)) and self._is_nobody_fresh()

    def _has_to_wait(self) -> bool:
        """Whether the link is lost or about to be, and the agents do not land by themselves yet."""
        if self._is_lost:
            return self.landing_in_s > 0.0
        return self._is_nobody_fresh()  # not yet long enough for the link to count as lost

    def _is_nobody_fresh(self) -> bool:
        """Whether two or more vehicles were last heard in flight, and no telemetry is fresh."""
        now_ns = self._client.now_ns()
        views = self._client.state.vehicles.values()
        return len(self._in_flight()) >= 2 and not any(view.is_fresh(now_ns) for view in views)

    def _lose(self) -> None:
        vehicles = self._client.state.vehicles
        self._is_lost = True
        flying = self._in_flight()
        self._ordered = {name: _order_kind(vehicles[name]) for name in flying}
        self._heard_ns = max(vehicles[name].received_ns for name in flying)
        self._back_ns = 0
        self._said_s = self._silent_for_s()

        sentence = (
            f"This ground hears no vehicle: {self.cause}. The vehicles finish their orders and "
            f"hold; their agents land them in {self.landing_in_s:.0f} s{self._exception}. "
            "Check its network."
        )
        self._client.publish_event("critical", "own_link_lost", sentence)

    def _warn_of_landing(self) -> None:
        silent_for_s = self._silent_for_s()
        if silent_for_s - self._said_s < _COUNTDOWN_PERIOD_S or self.landing_in_s <= 0.0:
            return

        self._said_s = silent_for_s
        sentence = (
            f"This ground has heard no vehicle for {silent_for_s:.0f} s: {self.cause}. "
            f"The agents land in {self.landing_in_s:.0f} s{self._exception}."
        )
        self._client.publish_event("warning", "own_link_lost", sentence)

    # -- the return --------------------------------------------------------------------------------

    def _update_return(self) -> None:
        """End the loss when all flying vehicles are heard, or some time after the first is."""
        now_ns = self._client.now_ns()
        vehicles = self._client.state.vehicles
        if not self._back_ns:
            if not any(view.is_fresh(now_ns) for view in vehicles.values()):
                self._warn_of_landing()
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
        landing = self._landing_without_order()
        if landing:
            sentence = (
                f"The link is back after {silent_for_s:.1f} s. Meanwhile the flight has ended for "
                f"{listed(landing)}."
            )
        self._client.publish_event("warning", "own_link_back", sentence)

    def _landing_without_order(self) -> list[str]:
        """Return the vehicles that land or have landed, and had another order at the loss."""
        names = []
        for name, kind in self._ordered.items():
            telemetry = self._client.state.vehicles[name].telemetry
            if telemetry is None or kind == "land" or self._is_sent_home(name):
                continue
            if telemetry.state in _ENDS_OF_FLIGHT:
                names.append(name)
        return names

    def _is_sent_home(self, name: str) -> bool:
        """Whether a vehicle's newest order lets it land at its goal."""
        newest = self._client.newest_order(name)
        return newest is not None and newest.planned.orders[name].then_land

    def _silent_for_s(self) -> float:
        return (self._client.now_ns() - self._heard_ns) * 1e-9

    def _in_flight(self) -> list[str]:
        """Return the vehicles that were armed when last heard, and not disarmed by PX4 since."""
        return [name for name, view in self._client.state.vehicles.items() if view.is_armed]


def _order_kind(view: VehicleView) -> str:
    return "" if view.telemetry is None else view.telemetry.order_kind


def _cause(fleet: FleetConfig) -> str:
    """Return why no vehicle is heard, in words."""
    if fleet.fleet.routers:
        return "its own link is down, or the fleet's routers are"
    return "its own link is down"


def _exception(fleet: FleetConfig) -> str:
    """Return when the agents land at once, in words; empty if the ground's link changes nothing."""
    cut_off_from = []
    if fleet.fleet.routers:
        cut_off_from.append("each other")
    if not fleet.mocap.direct and any(
        fleet.vehicles[name].mocap_required for name in fleet.enabled_names
    ):
        cut_off_from.append("their poses")

    if not cut_off_from:
        return ""
    return f", or within seconds if they are cut off from {' or '.join(cut_off_from)}"
