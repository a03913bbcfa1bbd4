"""A fleet that somebody has taken from its mission, by an order or by control of the fleet.

A mission gives orders of its own only. As soon as a vehicle has taken another one, the fleet is no
longer the mission's: the mission ends, and its ``[on_failure]`` does not count, because that would
replace the order that somebody has just given. Vehicles that the order did not name finish what
they do, and hold.

* Another ground's order counts whatever it is; `locate` is none.
* An order from the console in which the mission flies counts when it is to hold, to land or to
  kill. Others are flown beside the mission, as they always were.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState, VehicleView
from groundstation.orders.result import Results, VehicleResult
from onboard.bus.control_token import EMERGENCY, ORDER_STAYS

HEARD_S = 1.0  # longest wait for the telemetry about an order that has ended one of the mission's
_REPEAT_S = 10.0  # from one line about who has the fleet to the next
_LOOK_S = 0.5


@dataclass(frozen=True, slots=True)
class Taken:
    """The taking of a fleet from its mission: by whom, and by what."""

    by: str  # author and node
    words: str  # of the order, or of control
    since_ns: int  # on the ground's clock
    is_by_other: bool  # by another ground, and not from the console in which the mission flies

    @property
    def sentence(self) -> str:
        """The mission's end in a sentence."""
        return f"{self.by} {self.words}: that stays, and the mission has ended."


class FleetTaken(RuntimeError):
    """A mission's order was not given, because somebody has taken the fleet."""

    def __init__(self, taken: Taken) -> None:
        self.taken = taken
        super().__init__(taken.sentence)


class FleetWatch:
    """Notices that somebody takes the fleet of one mission.

    Args:
        client: fleet client that has been started.
    """

    def __init__(self, client: FleetClient) -> None:
        self.taken: Taken | None = None
        self._client = client
        self._begin: dict[str, str] = {}  # vehicle -> newest order before the mission

    def begin(self) -> None:
        """Take the fleet as it is for the mission's."""
        self.taken = None
        for name, view in self._client.state.vehicles.items():
            self._begin[name] = _order_id(view)

    def look(self) -> Taken | None:
        """Return who has taken the fleet, from the first time on; None while it is the mission's.

        Call it before each order, and several times a second.
        """
        if self.taken is not None:
            return self.taken

        found: dict[str, list[str]] = {}  # what was ordered, by whom -> vehicles
        is_by_other = False
        for name, view in self._client.state.vehicles.items():
            if not self._is_others(name, view) or view.telemetry is None:
                continue
            telemetry = view.telemetry
            is_by_other = is_by_other or not self._client.is_own(telemetry.taken_order_id)
            key = f"{telemetry.taken_order_from}\0{telemetry.taken_order_kind}"
            found.setdefault(key, []).append(name)

        if found:
            key = max(found, key=lambda one: len(found[one]))
            by, _, kind = key.partition("\0")
            words = f"has ordered {kind} {','.join(found[key])}"
            self.taken = Taken(by, words, self._client.now_ns(), is_by_other)
        return self.taken

    async def after_failure(self, results: Results) -> Taken | None:
        """Return who has taken the fleet, where that explains how an order of the mission ended.

        Args:
            results: results of that order.
        """

        def is_explained(_: FleetState) -> bool:
            return self.look() is not None

        if any(self._is_replaced(result) for result in results.values()):
            await self._client.wait_for(is_explained, HEARD_S)

        if self.look() is None and not all(result.is_done for result in results.values()):
            self.taken = self._new_operator()
        return self.taken

    def _is_replaced(self, result: VehicleResult) -> bool:
        """Whether somebody else's order has ended or forestalled the mission's."""
        if result.phase == "refused":
            return result.sentence.endswith(ORDER_STAYS)
        is_newest = self._client.is_newest_of_mission(result.vehicle, result.order_id)
        return result.phase == "superseded" and is_newest

    def _is_others(self, name: str, view: VehicleView) -> bool:
        """Whether a vehicle's newest order is neither the mission's nor older than the mission."""
        order_id = _order_id(view)
        if not order_id or order_id == self._begin.get(name, ""):
            return False
        if self._client.is_of_mission(order_id):
            return False
        if not self._client.is_own(order_id):
            return True

        kind = "" if view.telemetry is None else view.telemetry.taken_order_kind
        ends_it = kind in EMERGENCY or self._client.ends_missions(order_id)
        return self._client.has_person and ends_it

    def _new_operator(self) -> Taken | None:
        """Return another ground that operates the fleet now: the mission's orders are refused."""
        control = self._client.control
        if control.is_operator or control.holder is None:
            return None
        return Taken(control.holder.label, "has taken control", self._client.now_ns(), True)


def flown_by_hand(client: FleetClient) -> list[str]:
    """Return the vehicles that a pilot flies by hand, as they report it themselves.

    Args:
        client: fleet client that has been started.
    """
    now_ns = client.now_ns()
    pilots = []
    for name, view in client.state.vehicles.items():
        is_reported = view.telemetry is not None and view.telemetry.is_flown_by_hand
        if is_reported and view.is_fresh(now_ns):
            pilots.append(name)
    return pilots


def pilot_words(names: list[str]) -> str:
    """Return who has vehicles that are flown by hand.

    Args:
        names: names of the vehicles; at least one.
    """
    pilots = "A pilot has" if len(names) == 1 else "Pilots have"
    return f"{pilots} {', '.join(names)}."


async def stay(
    client: FleetClient, taken: Taken, begin_ns: int, say: Callable[[str], None]
) -> None:
    """Stay beside a fleet that somebody has taken, until nobody flies who is not flown by hand.

    The vehicles hear a ground meanwhile. It says who has them, since when, and what ends that.

    Args:
        client: fleet client that has been started.
        taken: who has taken the fleet.
        begin_ns: begin of the mission, on the ground's clock.
        say: called with each line of text.
    """
    limits = client.fleet.fleet
    since_s = (taken.since_ns - begin_ns) * 1e-9
    if taken.is_by_other and client.control.is_operator:
        client.control.hand_over()

    say(
        f"{taken.by} {taken.words}, {since_s:.1f} s after the mission's begin, and has the fleet. "
        "Nobody is landed from here; Ctrl-C lands all."
    )
    say(
        "It ends by their orders; by each battery at its landing level "
        f"({limits.battery_land_pct:g} %); or, once no ground is left that may order, after "
        f"{limits.ground_lost_land_s:g} s."
    )

    said_ns = client.now_ns()
    while up := _up(client):
        await asyncio.sleep(_LOOK_S)
        if (client.now_ns() - said_ns) * 1e-9 >= _REPEAT_S:
            said_ns = client.now_ns()
            for_s = (said_ns - taken.since_ns) * 1e-9
            say(f"{taken.by} has the fleet for {for_s:.0f} s; up: {', '.join(up)}.")


def _up(client: FleetClient) -> list[str]:
    """Return the vehicles that fly or are armed, by their last telemetry, but not by hand."""
    pilots = flown_by_hand(client)
    return [
        name
        for name, view in client.state.vehicles.items()
        if (view.is_airborne or view.is_armed) and name not in pilots
    ]


def _order_id(view: VehicleView) -> str:
    return "" if view.telemetry is None else view.telemetry.taken_order_id
