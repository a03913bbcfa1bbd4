"""The ways of a fleet file's vehicles to their goals: whether there are any, and how long they are.

The map of what stands in a vehicle's way is computed once, and kept for later questions.
"""

from __future__ import annotations

from functools import lru_cache

from onboard.avoidance.params import Capsule, LawParams, law_params, still
from onboard.config.fleet import FleetConfig
from onboard.control import router
from onboard.control.reachability import no_way
from onboard.tuples import Xyz


def unreachable(fleet: FleetConfig, name: str, begin_enu_m: Xyz, goal_enu_m: Xyz) -> str:
    """Return the words that say why a vehicle finds no way to a goal; empty if it finds one.

    Args:
        fleet: the fleet file.
        name: one of its vehicles.
        begin_enu_m, goal_enu_m: position of the vehicle, and the goal [m], ENU.
    """
    return no_way(_around(fleet, name), name, begin_enu_m, goal_enu_m)


def way_m(fleet: FleetConfig, name: str, begin_enu_m: Xyz, goal_enu_m: Xyz) -> float:
    """Return the length [m] of a vehicle's way to a goal, around what stands still.

    Args:
        fleet: the fleet file.
        name: one of its vehicles.
        begin_enu_m, goal_enu_m: position of the vehicle, and the goal [m], ENU.
    """
    return router.route_length_m(_around(fleet, name), begin_enu_m, goal_enu_m)


def _around(fleet: FleetConfig, name: str) -> router.Surroundings:
    """Return what surrounds a vehicle of a fleet file."""
    return _surroundings(still(fleet), law_params(fleet, name))


@lru_cache(maxsize=16)
def _surroundings(things: tuple[Capsule, ...], law: LawParams) -> router.Surroundings:
    return router.surroundings(things, law)
