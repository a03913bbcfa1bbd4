"""Landing of all vehicles at the end of a mission, whatever has happened before.

An order to land can end before its vehicle is down: a failsafe may have taken over, a link may
have broken, PX4 may have landed by itself. So the telemetry of the vehicles decides, and not the
result of the order. A vehicle that is neither down nor landing is ordered to land again, until all
are down or the time is over.

While this ground hears no vehicle, a mission waits until the link is back. A person's order to land
does not wait.

Vehicles that a pilot flies by hand are left to the pilot; the landing does not wait for them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.descent import longest_descent_s
from groundstation.fleet.state import FleetState
from groundstation.missions.own_link import OwnLink, silent_in_flight
from groundstation.missions.taken import FleetWatch, flown_by_hand
from groundstation.orders.intents import Land
from groundstation.orders.result import OrderResult, Results
from onboard.plain_text import listed

LAND_AGAIN_S = 6.0  # wait for vehicles that land, before the next order
TELEMETRY_WITHIN_S = 0.3  # longest wait for telemetry that shows the newest order
_LAST_TELEMETRY_S = 1.0  # longest wait for telemetry after all orders are done
# Factor on the time of the descent, because a landing vehicle may wait for others below it, and may
# have to avoid others.
_DESCENT_FACTOR = 2.0
_EVER_S = 1e9  # wait in place of an infinite one
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
    names: Sequence[str] | None = None,
) -> bool:
    """Land all vehicles that are not down yet.

    A landing that is under way goes on; it is not ordered again.

    Args:
        client: fleet client that has been started.
        superseded: vehicles whose last order another ground has replaced, perhaps by a landing.
        timeout_s: longest wait [s], in addition to twice the time of the descent from the vehicles'
            heights.
        say: function that receives each line of progress.
        link: link of this ground.
        watch: watch of the mission's fleet. Once somebody has taken the fleet, only a person may
            land it.
        is_by_person: whether a person, and not only the mission, has ordered the landing. Then the
            order does not wait for the link, and goes straight to PX4s whose agents do not answer.
        names: vehicles to land; None: all of the fleet.

    Returns:
        Whether all these vehicles are landed and disarmed, except those that a pilot flies by hand.
    """
    is_everybody = names is None
    if names is None:
        names = client.fleet.enabled_names
    up = tuple(name for name in names if _may_fly(client, name))
    for name in flown_by_hand(client):
        say(f"{name} is flown by hand: `land {name}` takes it.")
    end_ns = client.now_ns() + int(_landing_limit_s(client, timeout_s) * 1e9)

    # Vehicles that somebody else may have ordered to land, or the console in which the mission
    # flies: the next telemetry shows whether they land.
    ordered_before = {*superseded, *(name for name in up if client.has_open_landing(name))}
    if ordered_before:
        await client.wait_for(
            lambda _: all(_is_landing(client, name) for name in ordered_before), TELEMETRY_WITHIN_S
        )

    shown_lines: set[str] = set()

    def say_once(line: str) -> None:
        if line not in shown_lines:
            shown_lines.add(line)
            say(line)

    remaining = up  # vehicles that this landing still has to bring down
    while remaining and client.now_ns() < end_ns:
        remaining = _without(remaining, flown_by_hand(client))
        if not remaining:
            return True

        if not is_by_person:
            # The time without a link does not count.
            lost_before_s = link.lost_s
            await link.wait_while_lost()
            end_ns += round((link.lost_s - lost_before_s) * 1e9)
            if watch.takeover() is not None:
                return False

        results: Results = {}
        ordered = tuple(name for name in remaining if not _is_landing(client, name))
        if ordered:
            say_once(f"Landing {listed(ordered)}.")
            planned = client.plan(Land(vehicles=ordered, is_everybody=is_everybody))
            order = client.send(planned, is_by_mission=not is_by_person)
            await client.wait_for(_has_ended(client, order), (end_ns - client.now_ns()) * 1e-9)
            results = order.results

        # A vehicle whose order is done may no longer send telemetry: its agent may have ended, and
        # PX4 itself has reported the landing over the direct link. A vehicle whose order is not
        # done may still come down: when a failsafe has taken over, PX4 lands by itself.
        remaining = _without(remaining, [name for name in results if results[name].is_done])
        wait_s = LAND_AGAIN_S if remaining else _LAST_TELEMETRY_S
        if await client.wait_for(_all_down(client, up), wait_s):
            return True

        _say_failures(client, results, say_once)
        remaining = _without(remaining, [name for name in remaining if _is_down(client, name)])

    return not remaining


async def wait_for_landings(client: FleetClient, timeout_s: float) -> None:
    """Wait until no vehicle lands any more; nothing is ordered.

    Args:
        client: fleet client that has been started.
        timeout_s: longest wait [s], in addition to twice the time of the descent from the vehicles'
            heights.
    """

    def lands_nobody(_: FleetState) -> bool:
        return not any(_is_landing(client, name) for name in client.fleet.enabled_names)

    await client.wait_for(lands_nobody, _landing_limit_s(client, timeout_s))


def _without(names: Sequence[str], excluded: Collection[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name not in excluded)


def _landing_limit_s(client: FleetClient, timeout_s: float) -> float:
    """Return a timeout [s] with twice the time of the descent from the vehicles' heights added."""
    descent_s = longest_descent_s(client.fleet, client.state)
    return min(timeout_s + _DESCENT_FACTOR * descent_s, _EVER_S)


def _say_failures(client: FleetClient, results: Results, say: Callable[[str], None]) -> None:
    """Say which vehicles the last order has not landed, and why."""
    silent = silent_in_flight(client)
    for name, result in results.items():
        if result.phase == "accepted" and name in silent:
            say(f"  {name} accepted it, and fell silent. Landing it again.")
        elif result.sentence and not result.is_done:
            say(f"  {result.words}")


def _has_ended(client: FleetClient, order: OrderResult) -> Callable[[FleetState], bool]:
    """Return a predicate: an order has ended, or a vehicle that accepted it has fallen silent."""

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
    """Whether a vehicle is landed and no order may start it again, or a pilot flies it."""
    if name in flown_by_hand(client):
        return True
    return client.state.is_landed(name) and not client.may_start(name)


def _may_fly(client: FleetClient, name: str) -> bool:
    """Whether a vehicle flies, or may be about to.

    An order to take off may be under way although the telemetry does not show it yet.
    """
    telemetry = client.state.vehicles[name].telemetry
    if telemetry is None:
        return client.may_start(name)
    return not _is_down(client, name) or telemetry.state in _MAY_FLY_STATES


def _is_landing(client: FleetClient, name: str) -> bool:
    view = client.state.vehicles[name]
    if view.telemetry is None or not view.is_fresh(client.now_ns()):
        return False
    return view.telemetry.state == "landing"
