"""A fleet that somebody has taken from its mission, by an order or by control of the fleet.

A vehicle reports the newest order that it has accepted. When this is not an order of the mission,
somebody else has taken the fleet, and the mission ends. Its ``[on_failure]`` is not carried out,
because it would replace the order that somebody has just given. Vehicles that this order did not
name finish their present order, and hold.

* Every order from another ground takes the fleet, except `locate`.
* An order from the console in which the mission flies takes the fleet if it is to hold, to land, to
  kill or to fly home, or if it replaces an order without which the mission cannot go on. Other
  orders are flown alongside the mission.
* Control of the fleet by another ground takes the fleet, if this ground had control before.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState, VehicleView
from groundstation.orders.result import Results, VehicleResult
from onboard.bus.control_token import EMERGENCY, ORDER_STAYS

_ENDS = (*EMERGENCY, "home", "bring_home")  # verbs of a person here that end the mission
# Longest wait for telemetry about an order that has replaced an order of the mission.
HEARD_S = 1.0
# Longest wait for the telemetry of all vehicles about the order that has taken the fleet.
_GATHER_S = 0.3
_REPEAT_S = 10.0  # time between two lines about the new operator of the fleet
_LOOK_S = 0.5  # time between two checks of a fleet that was taken
# longest flight of a vehicle without hover_time_s in the fleet file
_ASSUMED_FLIGHT_S = 3600.0


_VehiclesByOrder = dict[tuple[str, str], list[str]]  # author and verb -> vehicles


@dataclass(frozen=True, slots=True)
class Taken:
    """The taking of a fleet from its mission."""

    by: str  # author and node that have taken the fleet
    words: str  # their action: "has ordered ..." or "has taken control"
    since_ns: int  # time of the taking, on the ground's clock
    # Whether another ground has taken the fleet, and not the console in which the mission flies.
    is_by_other: bool

    @property
    def sentence(self) -> str:
        """The end of the mission in a sentence."""
        return f"{self.by} {self.words}: that stays, and the mission has ended."


class FleetTaken(RuntimeError):
    """A mission's order was not given, because somebody has taken the fleet."""

    def __init__(self, taken: Taken) -> None:
        self.taken = taken
        super().__init__(taken.sentence)


class FleetWatch:
    """Notices when somebody takes the fleet of one mission.

    Args:
        client: fleet client that has been started.
    """

    def __init__(self, client: FleetClient) -> None:
        self.taken: Taken | None = None
        self._client = client
        self.has_begun = False  # whether the mission has begun
        self._earlier_order_ids: dict[str, str] = {}  # vehicle -> newest order before the mission
        self._had_control = False  # whether this ground operated the fleet when the mission began

    def begin(self) -> None:
        """Begin to watch for a mission; orders that the vehicles have already do not count."""
        self.taken = None
        self.has_begun = True
        self._had_control = self._client.control.is_operator
        self._earlier_order_ids.clear()
        self.note_earlier_orders()

    def note_earlier_orders(self) -> None:
        """Note the newest order of each vehicle that is heard for the first time.

        Call it several times a second before the mission begins.

        A vehicle whose agent has just started may report an order of an earlier flight.
        """
        for name, view in self._client.state.vehicles.items():
            if view.telemetry is not None:
                self._earlier_order_ids.setdefault(name, _newest_order_id(view))

    def kill_before_begin(self, names: Collection[str]) -> str:
        """Return who has killed one of these vehicles since it was first heard; empty if nobody.

        Args:
            names: vehicles of the mission, which has not begun.
        """
        self.note_earlier_orders()
        for name in names:
            view = self._client.state.vehicles[name]
            telemetry = view.telemetry
            if telemetry is None or telemetry.taken_order_kind != "kill":
                continue
            if _newest_order_id(view) != self._earlier_order_ids[name]:
                return f"{telemetry.taken_order_from} has killed {name}"
        return ""

    def takeover(self) -> Taken | None:
        """Return who took the fleet first; None while the mission has it.

        Call it before each order, and several times a second.
        """
        if self.taken is not None:
            return self.taken

        if self.has_begun:
            self.note_earlier_orders()
        self.taken = self._taken_by_order()
        if self.taken is None and self._had_control:
            self.taken = self._new_operator()
        return self.taken

    def taken_by_person(self, results: Results) -> Taken | None:
        """Return the person here whose orders alone explain how an order of the mission ended.

        Call it if the mission cannot go on without the vehicles that did not do its order.

        Args:
            results: results of these vehicles.
        """
        ordered = self.ordered_by_person(results)
        if len(ordered) < len(results):
            return None
        vehicles_by_order: _VehiclesByOrder = {}
        for name, order in ordered.items():
            vehicles_by_order.setdefault(order, []).append(name)
        self.taken = self._taken(vehicles_by_order, is_by_other=False)
        return self.taken

    def ordered_by_person(self, results: Results) -> dict[str, tuple[str, str]]:
        """Return the vehicles whose order a person here has replaced: name -> author and verb.

        Args:
            results: results of an order of the mission.
        """
        ordered: dict[str, tuple[str, str]] = {}
        if not self._client.has_person:
            return ordered
        for name, result in results.items():
            telemetry = self._client.state.vehicles[name].telemetry
            if result.phase != "superseded" or telemetry is None:
                continue
            verb = self._client.persons_verb(telemetry.taken_order_id)
            if verb:
                ordered[name] = (telemetry.taken_order_from, verb)
        return ordered

    async def whole_takeover(self, first: Taken) -> Taken:
        """Return a takeover with all vehicles of its order, which report it one after the other.

        Args:
            first: the takeover as it was noticed, by the telemetry of the first vehicles.
        """

        def is_reported_by_all(state: FleetState) -> bool:
            return all(
                self._has_order_of_others(name, view) for name, view in state.vehicles.items()
            )

        await self._client.wait_for(is_reported_by_all, _GATHER_S)
        whole = self._taken_by_order()
        if whole is not None:
            self.taken = replace(whole, since_ns=first.since_ns)
        return self.taken or first

    def _taken_by_order(self) -> Taken | None:
        """Return who has the fleet by an order, as the vehicles report now; None if nobody has."""
        vehicles_by_order: _VehiclesByOrder = {}
        is_by_other = False  # whether one of these orders came from another ground
        for name, view in self._client.state.vehicles.items():
            telemetry = view.telemetry
            if telemetry is None or not self._has_order_of_others(name, view):
                continue
            if not self._client.is_own(telemetry.taken_order_id):
                is_by_other = True
            verb = self._client.persons_verb(telemetry.taken_order_id)
            order = (telemetry.taken_order_from, verb or telemetry.taken_order_kind)
            vehicles_by_order.setdefault(order, []).append(name)
        return self._taken(vehicles_by_order, is_by_other=is_by_other)

    def _taken(self, vehicles_by_order: _VehiclesByOrder, *, is_by_other: bool) -> Taken | None:
        """Return the takeover by these orders; None if there are none.

        If there are several orders, the one to the most vehicles is named.
        """
        if not vehicles_by_order:
            return None
        (author, verb), names = max(vehicles_by_order.items(), key=lambda item: len(item[1]))
        return Taken(
            by=author,
            words=f"has ordered {verb.replace('_', ' ')} {','.join(names)}",
            since_ns=self._client.now_ns(),
            is_by_other=is_by_other,
        )

    async def after_failure(self, results: Results) -> Taken | None:
        """Return who has taken the fleet, if that explains how an order of the mission ended.

        Telemetry about the other order may come later than the result, so this waits for it.

        Args:
            results: results of that order.
        """

        def is_explained(_: FleetState) -> bool:
            return self.takeover() is not None

        if any(self._is_replaced(result) for result in results.values()):
            await self._client.wait_for(is_explained, HEARD_S)

        if self.takeover() is None and not all(result.is_done for result in results.values()):
            self.taken = self._new_operator()
        return self.taken

    def _is_replaced(self, result: VehicleResult) -> bool:
        """Whether somebody else's order has replaced or prevented the mission's order."""
        if result.phase == "refused":
            return result.sentence.endswith(ORDER_STAYS)  # the words about somebody else's order
        is_newest = self._client.is_newest_of_mission(result.vehicle, result.order_id)
        return result.phase == "superseded" and is_newest

    def _has_order_of_others(self, name: str, view: VehicleView) -> bool:
        """Whether somebody else gave a vehicle's newest order after the mission began.

        An order of this ground counts only if it ends missions and a person may have given it.
        """
        order_id = _newest_order_id(view)
        if not order_id or order_id == self._earlier_order_ids.get(name, ""):
            return False
        if self._client.is_of_mission(order_id):
            return False
        if not self._client.is_own(order_id):
            return True

        kind = "" if view.telemetry is None else view.telemetry.taken_order_kind
        verb = self._client.persons_verb(order_id) or kind
        return self._client.has_person and verb in _ENDS

    def _new_operator(self) -> Taken | None:
        """Return another ground that operates the fleet now; None if there is none.

        Its control of the fleet explains why the mission's orders are refused.
        """
        control = self._client.control
        if control.is_operator or control.holder is None:
            return None
        return Taken(
            by=control.holder.label,
            words="has taken control",
            since_ns=self._client.now_ns(),
            is_by_other=True,
        )


def flown_by_hand(client: FleetClient) -> list[str]:
    """Return the vehicles that report that a pilot flies them by hand.

    Args:
        client: fleet client that has been started.
    """
    now_ns = client.now_ns()
    by_hand = []
    for name, view in client.state.vehicles.items():
        is_reported = view.telemetry is not None and view.telemetry.is_flown_by_hand
        if is_reported and view.is_fresh(now_ns):
            by_hand.append(name)
    return by_hand


def pilot_words(names: Sequence[str]) -> str:
    """Return the sentence about vehicles that are flown by hand.

    Args:
        names: names of the vehicles; at least one.
    """
    pilots = "A pilot has" if len(names) == 1 else "Pilots have"
    return f"{pilots} {', '.join(names)}."


async def stay(
    client: FleetClient, taken: Taken, begin_ns: int, say: Callable[[str], None]
) -> None:
    """Stay connected to a fleet that somebody has taken, until no vehicle flies.

    Vehicles that a pilot flies by hand do not count. A crashed vehicle never reports that it is
    down, so a vehicle that has been silent for longer than its battery lasts does not count either.
    The vehicles hear this ground meanwhile, so they do not land because of a lost ground. Lines say
    who has the fleet, since when, and what brings the vehicles down.

    Args:
        client: fleet client that has been started.
        taken: who has taken the fleet.
        begin_ns: start of the mission, on the ground's clock [ns].
        say: function that receives each line of text.
    """
    limits = client.fleet.fleet
    since_s = (taken.since_ns - begin_ns) * 1e-9
    if taken.is_by_other and client.control.is_operator:
        client.control.hand_over()

    say(
        f"{taken.by} {taken.words}, {since_s:.1f} s after the mission began, and has the fleet. "
        "Nobody is landed from here; Ctrl-C lands all."
    )
    say(
        "It ends by their orders; by each battery at its landing level "
        f"({limits.battery_land_pct:g} %); or, once no ground is left that may order, after "
        f"{limits.ground_lost_land_s:g} s."
    )

    said_ns = client.now_ns()
    up = _still_up(client)
    while up:
        await asyncio.sleep(_LOOK_S)
        if (client.now_ns() - said_ns) * 1e-9 >= _REPEAT_S:
            said_ns = client.now_ns()
            for_s = (said_ns - taken.since_ns) * 1e-9
            say(f"{taken.by} has the fleet for {for_s:.0f} s; up: {', '.join(up)}.")
        up = _still_up(client)


def _still_up(client: FleetClient) -> list[str]:
    """Return the vehicles that last reported to be armed or in the air, and may still be so.

    Vehicles of pilots are left out.
    """
    by_hand = flown_by_hand(client)
    now_ns = client.now_ns()
    up = []
    for name, view in client.state.vehicles.items():
        longest_s = client.fleet.vehicles[name].hover_time_s
        if not longest_s:
            longest_s = _ASSUMED_FLIGHT_S
        if view.is_up and view.age_s(now_ns) <= longest_s and name not in by_hand:
            up.append(name)
    return up


def _newest_order_id(view: VehicleView) -> str:
    """Return the newest order that a vehicle reports; empty if it reports none."""
    return "" if view.telemetry is None else view.telemetry.taken_order_id
