"""ORCA with priorities: the vehicle further west makes nearly all of a pair's change.

In van den Berg, Guy, Lin, Manocha: Reciprocal n-Body Collision Avoidance, ISRR 2009, section 4,
each vehicle makes half of the change u; we add the priority. A vehicle with priority still makes a
small part, because estimate errors may make both believe that they have it.
"""

from __future__ import annotations

from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from sitl.monte_carlo.open_benchmark.laws.around import (
    Body,
    bodies,
    nearest,
    own_velocity,
    preferred_velocity,
    steered,
)
from sitl.monte_carlo.open_benchmark.laws.orca import orca_row

_HORIZON_S = 4.0
_WITH_PRIORITY = 0.2  # shares of the change
_WITHOUT = 0.8


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the thrust towards the nearest velocity that all rows allow."""
    around = bodies(inputs)
    velocity = own_velocity(inputs)
    rows = [orca_row(body, velocity, _share(body), _HORIZON_S) for body in around]
    return None, steered(inputs, nearest(preferred_velocity(inputs, around), rows))


def _share(body: Body) -> float:
    """Return the share of the change that this vehicle makes."""
    if body.share == 1.0:
        return 1.0  # the body makes no part of the change
    if body.e_m > (0.0, 0.0):  # this vehicle is further east, or as far and further north
        return _WITH_PRIORITY
    return _WITHOUT
