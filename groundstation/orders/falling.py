"""Finds the vehicles below others whose motors are about to be stopped. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection

from groundstation.fleet.state import FleetState
from onboard.config.fleet import FleetConfig

_MAX_NAMED = 4  # pairs that the sentence names


def below_words(names: Collection[str], fleet: FleetConfig, state: FleetState, now_ns: int) -> str:
    """Return which vehicles are below flying vehicles that are to be killed.

    A vehicle is below another one if it is lower, and their horizontal distance is smaller than the
    safety distance.

    Args:
        names: names of the vehicles to be killed.
        fleet: the fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        A sentence that begins with the smallest difference of height; empty if no vehicle is known
        to be below.
    """
    falls: list[tuple[float, str]] = []  # difference of height, and the text about the pair
    for name in names:
        upper = state.vehicles.get(name)
        if upper is None or not upper.is_airborne:
            continue
        upper_enu_m = upper.position_enu_m(now_ns)
        if upper_enu_m is None:
            continue

        for other, view in state.vehicles.items():
            lower_enu_m = view.position_enu_m(now_ns)
            if other == name or lower_enu_m is None:
                continue
            beside_m = math.dist(upper_enu_m[:2], lower_enu_m[:2])
            height_m = upper_enu_m[2] - lower_enu_m[2]
            if height_m > 0.0 and beside_m < fleet.fleet.safety_distance_m:
                falls.append((height_m, f"{name} falls on {other}, {height_m:.1f} m below"))

    if not falls:
        return ""
    texts = [text for _, text in sorted(falls)]
    sentence = "; ".join(texts[:_MAX_NAMED])
    if len(texts) > _MAX_NAMED:
        sentence += f"; and {len(texts) - _MAX_NAMED} more"
    return f"{sentence}."
