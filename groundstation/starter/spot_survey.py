"""Take-off spots where the vehicles stand, from positions that they report while they rest. Pure.

Each spot is the mean of a vehicle's positions. How far they are spread says how much it is worth:
satellites wander by decimetres within a minute, with corrections by centimetres. What wanders
slower than the survey took is not seen, and neither is what is wrong for all alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from onboard.config.fleet import ConfigError, FleetConfig, parking_distance_m
from onboard.tuples import Xyz

LEAST_SAMPLES = 5


class SurveyedSpot(NamedTuple):
    """The spot on which one vehicle stands, and how well it is known."""

    name: str
    east_m: float
    north_m: float
    spread_m: float  # standard deviation, of east and north together
    farthest_m: float  # of a position from the mean
    samples: int
    moved_m: float  # from the spot of the fleet file


def surveyed(
    positions_enu_m: Mapping[str, Sequence[Xyz]], fleet: FleetConfig
) -> list[SurveyedSpot]:
    """Return the spots of vehicles.

    Args:
        positions_enu_m: by name, as reported.
        fleet: with the spots until now.

    Raises:
        ConfigError: a vehicle has reported too few positions.
    """
    spots = []
    for name, reported in positions_enu_m.items():
        if len(reported) < LEAST_SAMPLES:
            raise ConfigError(
                f"{name} has reported {len(reported)} positions; {LEAST_SAMPLES} are the least. "
                "Survey for longer, and see covey check vehicles."
            )
        places = np.array(reported)[:, :2]
        mean = places.mean(axis=0)
        away_m = np.hypot(*(places - mean).T)
        spots.append(
            SurveyedSpot(
                name=name,
                east_m=round(float(mean[0]), 2),
                north_m=round(float(mean[1]), 2),
                spread_m=float(np.sqrt((away_m**2).mean())),
                farthest_m=float(away_m.max()),
                samples=len(reported),
                moved_m=math.dist(mean, fleet.vehicles[name].start_enu_m[:2]),
            )
        )
    return spots


def refuse_poor_spots(
    spots: Sequence[SurveyedSpot], fleet: FleetConfig, most_spread_m: float
) -> None:
    """Refuse spots that are not known well enough, or too near to each other to take off.

    Args:
        spots: all that were surveyed.
        fleet: the others' spots, and the distance that its law needs.
        most_spread_m: that a spot may have.

    Raises:
        ConfigError: naming the worst one, or the nearest two.
    """
    worst = max(spots, key=lambda spot: spot.spread_m)
    if worst.spread_m > most_spread_m:
        raise ConfigError(
            f"{worst.name}'s positions are spread by {worst.spread_m:.3f} m; {most_spread_m:g} m "
            "are the most. Wait for more satellites or for corrections, survey for longer, or "
            "allow more with --spread."
        )

    places = {name: fleet.vehicles[name].start_enu_m[:2] for name in fleet.enabled_names}
    places |= {spot.name: (spot.east_m, spot.north_m) for spot in spots}
    least_m = parking_distance_m(fleet)
    apart = [
        (math.dist(places[first], places[second]), first, second)
        for first, second in itertools.combinations(places, 2)
    ]
    if not apart:
        return
    apart_m, first, second = min(apart)
    if apart_m < least_m:
        raise ConfigError(
            f"{first} and {second} stand {apart_m:.2f} m apart; to take off, the law needs "
            f"{least_m:.2f} m. Move them apart, and survey again."
        )


def changes_of(spots: Sequence[SurveyedSpot], fleet: FleetConfig) -> dict[str, Any]:
    """Return what changes in the fleet file; heights of spots stay as they are.

    Args:
        spots: surveyed.
        fleet: with the spots until now.
    """
    vehicles = {}
    for spot in spots:
        up_m = fleet.vehicles[spot.name].start_enu_m[2]
        vehicles[spot.name] = {"start_enu_m": [spot.east_m, spot.north_m, up_m]}
    return {"vehicles": vehicles}


def spot_lines(spots: Sequence[SurveyedSpot]) -> list[str]:
    """Return the spots as a table."""
    lines = ["vehicle        east m   north m   spread m   farthest m   samples   moved m"]
    for spot in spots:
        lines.append(
            f"{spot.name[:12]:12} {spot.east_m:8.2f}  {spot.north_m:8.2f}   {spot.spread_m:8.3f}"
            f"   {spot.farthest_m:10.3f}   {spot.samples:7d}   {spot.moved_m:7.2f}"
        )
    return lines
