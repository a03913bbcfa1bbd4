"""Computes take-off spots from the positions that resting vehicles report. Pure.

Each spot is the mean of a vehicle's positions, and their spread tells how accurate the mean is.
Errors that change more slowly than the survey lasts do not show in the spread.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from onboard.config.fleet import ConfigError, FleetConfig, parking_distance_m
from onboard.tuples import Xyz

MIN_SAMPLES = 5


class SurveyedSpot(NamedTuple):
    """The spot on which one vehicle stands, and how well it is known."""

    name: str
    east_m: float
    north_m: float
    spread_m: float  # standard deviation of east and north together
    farthest_m: float  # greatest distance of a position from the mean
    samples: int
    moved_m: float  # distance from the spot of the fleet file


def surveyed(
    positions_enu_m: Mapping[str, Sequence[Xyz]], fleet: FleetConfig
) -> list[SurveyedSpot]:
    """Return the spots of vehicles.

    Args:
        positions_enu_m: name of a vehicle -> its reported positions; those that are not finite do
            not count.
        fleet: the fleet file with the present spots.

    Raises:
        ConfigError: a vehicle has reported too few positions.
    """
    spots = []
    for name, reported in positions_enu_m.items():
        positions_m = np.array(reported, np.float64).reshape(-1, 3)[:, :2]
        positions_m = positions_m[np.isfinite(positions_m).all(axis=-1)]
        samples = len(positions_m)
        if samples < MIN_SAMPLES:
            raise ConfigError(
                f"{name} has reported {samples} positions; {MIN_SAMPLES} are the least. "
                "Survey for longer, and see covey check vehicles."
            )
        east_m, north_m = positions_m.mean(axis=0)
        away_m = np.hypot(positions_m[:, 0] - east_m, positions_m[:, 1] - north_m)
        spots.append(
            SurveyedSpot(
                name=name,
                east_m=round(float(east_m), 2),
                north_m=round(float(north_m), 2),
                spread_m=float(np.sqrt((away_m**2).mean())),
                farthest_m=float(away_m.max()),
                samples=samples,
                moved_m=math.dist((east_m, north_m), fleet.vehicles[name].start_enu_m[:2]),
            )
        )
    return spots


def refuse_poor_spots(
    spots: Sequence[SurveyedSpot], fleet: FleetConfig, most_spread_m: float
) -> None:
    """Refuse spots that are too inaccurate, or too near to each other to take off.

    Args:
        spots: the surveyed spots.
        fleet: the fleet file, with the spots of other vehicles and the distance of the law.
        most_spread_m: largest spread of a spot.

    Raises:
        ConfigError: a spot is refused; the message names the worst one, or the nearest two.
    """
    worst = max(spots, key=lambda spot: spot.spread_m)
    if worst.spread_m > most_spread_m:
        raise ConfigError(
            f"{worst.name}'s positions are spread by {worst.spread_m:.3f} m; {most_spread_m:g} m "
            "are the most. Wait for more satellites or for corrections, survey for longer, or "
            "allow more with --spread."
        )

    spots_m = {name: fleet.vehicles[name].start_enu_m[:2] for name in fleet.enabled_names}
    spots_m |= {spot.name: (spot.east_m, spot.north_m) for spot in spots}
    least_m = parking_distance_m(fleet)
    apart = [
        (math.dist(spots_m[first], spots_m[second]), first, second)
        for first, second in itertools.combinations(spots_m, 2)
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
    """Return the changes of the fleet file; the heights of spots are not changed.

    Args:
        spots: the surveyed spots.
        fleet: the fleet file with the present spots.
    """
    vehicles = {}
    for spot in spots:
        _, _, up_m = fleet.vehicles[spot.name].start_enu_m
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
