"""Landing of all vehicles at the end of a mission, whatever has happened before.

An order to land can end before its vehicle is down: a failsafe may have taken over, a link may have
broken, PX4 may have landed by itself. So this asks the vehicles, not the orders: whoever is not
down, and does not land, is ordered to land again, until all are down or the time is over.

While this ground hears nobody, a mission waits for its link, and a person does not.

Vehicles that a pilot flies by hand are left to him, and not waited for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.descent import longest_descent_s
from groundstation.fleet.state import FleetState
from groundstation.missions.own_link import OwnLink, silent_in_flight
from groundstation.missions.taken import FleetWatch, flown_by_hand
from groundstation.orders.intents import Land
from groundstation.orders.result import OrderResult, Results

LAND_AGAIN_S = 6.0
TELEMETRY_WITHIN_S = 0.3
_LAST_TELEMETRY_S = 1.0  # after the end of the last order
# Times the descent: a vehicle that lands waits for others below, and goes aside for others.
_PATIENCE = 2.0
_MAY_FLY_STATES = ("armed", "taking off", "flying", "holding", "landing")


async def land_all(
    client: FleetClient,
    superseded: Sequence[str],
    timeout_s: float,
    *,
    say: Callable[[str], None],
    link: OwnLink,
    watch: FleetWatch,
    is_by_person: bool = False,
) -> bool:
    """Land all vehicles that are not down yet.

    A landing under way goes on: no new order replaces an operator's.

    Args:
        client: fleet client that has been started.
        superseded: vehicles whose last order another ground has replaced; that may have been by a
            landing.
        timeout_s: longest wait beyond twice the time that the descent from their heights takes [s].
        say: progress in words.
        link: link of this ground.
        watch: watch of the mission's fleet: once somebody has taken it, only a person lands it.
        is_by_person: a person wants it, and not only the mission: it waits for no link, and goes
            straight to PX4s whose agents do not answer.

    Returns:
        Whether all are landed and disarmed that no pilot flies by hand.
    """
    up = tuple(name for name in client.fleet.enabled_names if _may_fly(client, name))
    for name in flown_by_hand(client):
        say(f"{name} is flown by hand: `land {name}` takes it.")
    descent_s = longest_descent_s(client.fleet, client.state)
    end_ns = client.now_ns() + int((timeout_s + _PATIENCE * descent_s) * 1e9)

    if superseded:
        # The next telemetry shows whether the new order is to land.
        await client.wait_for(
            lambda _: all(_is_landing(client, name) for name in superseded), TELEMETRY_WITHIN_S
        )

    said: set[str] = set()

    def say_once(line: str) -> None:
        if line not in said:
            said.add(line)
            say(line)

    left = up
    while left and client.now_ns() < end_ns:
        pilots = flown_by_hand(client)
        left = tuple(name for name in left if name not in pilots)
        if not left:
            return True

        if not is_by_person:
            lost_s = link.lost_s
            await link.heard()
            end_ns += round((link.lost_s - lost_s) * 1e9)
            if watch.look() is not None:
                return False

        ordered = tuple(name for name in left if not _is_landing(client, name))
        if not ordered:
            if await client.wait_for(_all_down(client, up), LAND_AGAIN_S):
                return True
            left = tuple(name for name in left if not _is_down(client, name))
            continue

        say_once(f"Landing {', '.join(ordered)}.")
        planned = client.plan(Land(vehicles=ordered, is_everybody=True))
        order = client.send(planned, is_by_mission=not is_by_person)
        await client.wait_for(_has_ended(client, order), (end_ns - client.now_ns()) * 1e-9)

        # An order can end before the vehicle is down: when a failsafe has taken over, PX4 lands by
        # itself. A vehicle that PX4 itself reports as disarmed, on the direct path, has no agent
        # left to send telemetry.
        left = tuple(
            name for name in left if name not in order.results or not order.results[name].is_done
        )
        if await client.wait_for(
            _all_down(client, up), LAND_AGAIN_S if left else _LAST_TELEMETRY_S
        ):
            return True

        _say_failures(client, order.results, say_once)
        left = tuple(name for name in left if not _is_down(client, name))

    return not left


def _say_failures(client: FleetClient, results: Results, say: Callable[[str], None]) -> None:
    """Say which vehicles have not landed by the last order, and why."""
    silent = silent_in_flight(client)
    for name, result in results.items():
        if result.phase == "accepted" and name in silent:
            say(f"  {name} accepted it, and fell silent. Landing it again.")
        elif result.sentence and not result.is_done:
            say(f"  {name} {result.phase}: {result.sentence}")


def _has_ended(client: FleetClient, order: OrderResult) -> Callable[[FleetState], bool]:
    """Return whether an order has ended, or an agent has accepted it and fallen silent."""

    def has_ended(_: FleetState) -> bool:
        if order.is_final:
            return True
        silent = silent_in_flight(client)
        return any(
            result.phase == "accepted" and name in silent for name, result in order.results.items()
        )

    return has_ended


def _all_down(client: FleetClient, names: Sequence[str]) -> Callable[[FleetState], bool]:
    return lambda _: all(_is_down(client, name) for name in names)


def _is_down(client: FleetClient, name: str) -> bool:
    """Whether it is landed and nothing may take it up again, or a pilot's."""
    if name in flown_by_hand(client):
        return True
    return client.state.is_landed(name) and not client.may_start(name)


def _may_fly(client: FleetClient, name: str) -> bool:
    """Whether it flies or is about to: an order to take off comes before its telemetry."""
    telemetry = client.state.vehicles[name].telemetry
    if telemetry is None:
        return client.may_start(name)
    return not _is_down(client, name) or telemetry.state in _MAY_FLY_STATES


def _is_landing(client: FleetClient, name: str) -> bool:
    view = client.state.vehicles[name]
    if view.telemetry is None or not view.is_fresh(client.now_ns()):
        return False
    return view.telemetry.state == "landing"
