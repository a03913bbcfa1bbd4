"""How long vehicles may stay up: until the last moment at which the weakest still gets home.

Pure.

A vehicle needs a share of its battery for its way to a take-off spot and for the landing there. It
must leave before its charge has sunk to that share above the level at which it lands where it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from groundstation.fleet.places import spot_of
from groundstation.fleet.state import FleetState
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.tuples import Xyz

ASSUMED_HOVER_S = 300.0  # of a battery about which the fleet file says nothing: a short time
SPARE_PCT = 5.0  # that is left at home above the landing level

_LEAST_OBSERVED_S = 5.0  # of a discharge that is believed
_MEAN_SPEED_SHARE = 0.5  # of the top speed, over a way from rest to rest
_DESCENT_M_S = 0.4
_AROUND_OTHERS_S = 20.0  # for turning round, going aside and waiting above a spot


class Reserve(NamedTuple):
    """Charge of the weakest vehicle, and the charge that its way home takes."""

    name: str
    has_pct: float
    needs_pct: float  # at this charge it has to leave
    left_s: float  # until then, as its battery sinks

    @property
    def is_used_up(self) -> bool:
        """Whether it has to leave now."""
        return self.has_pct <= self.needs_pct

    def __str__(self) -> str:
        return (
            f"the weakest battery is {self.name}'s with {self.has_pct:.0f} %; "
            f"at {self.needs_pct:.0f} % all are brought home"
        )


class Discharge:
    """Fall of each battery since the paths began, as its vehicle reports it."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[int, float]] = {}  # vehicle -> time, share of a full battery

    def rate_1_s(self, name: str, now_ns: int, battery_frac: float) -> float:
        """Return the share of a full battery that a second takes; 0 in the first seconds.

        Args:
            name: name of the vehicle.
            now_ns: the ground's clock.
            battery_frac: charge that is reported now, as a fraction of a full battery.
        """
        begin_ns, first_frac = self._first.setdefault(name, (now_ns, battery_frac))
        since_s = (now_ns - begin_ns) * 1e-9
        if since_s < _LEAST_OBSERVED_S:
            return 0.0
        return max(0.0, first_frac - battery_frac) / since_s


def weakest(
    fleet: FleetConfig,
    state: FleetState,
    names: Sequence[str],
    discharge: Discharge,
    now_ns: int,
) -> Reserve | None:
    """Return the vehicle whose charge is nearest to what it needs; None where nobody reports any.

    Args:
        fleet: the fleet file.
        state: the fleet as known now.
        names: names of the vehicles in the air.
        discharge: discharge of their batteries until now.
        now_ns: the ground's clock.
    """
    reserves = []
    for name in names:
        telemetry = state.vehicles[name].telemetry
        if telemetry is None or not math.isfinite(telemetry.battery_frac):
            continue

        spot_enu_m = spot_of(name, fleet, state)
        way_s = way_home_s(fleet.vehicles[name], spot_enu_m, telemetry.position_enu_m)
        hover_s = fleet.vehicles[name].hover_time_s or ASSUMED_HOVER_S
        seen_1_s = discharge.rate_1_s(name, now_ns, telemetry.battery_frac)
        rate_pct_s = 100.0 * max(1.0 / hover_s, seen_1_s)

        has_pct = 100.0 * telemetry.battery_frac
        needs_pct = fleet.fleet.battery_land_pct + SPARE_PCT + way_s * rate_pct_s
        left_s = max(0.0, has_pct - needs_pct) / rate_pct_s
        reserves.append(Reserve(name, has_pct, needs_pct, left_s))
    return min(reserves, key=lambda one: one.has_pct - one.needs_pct, default=None)


def way_home_s(vehicle: Vehicle, spot_enu_m: Xyz, position_enu_m: Sequence[float]) -> float:
    """Return how long the way to the take-off spot and the landing there take [s].

    Args:
        vehicle: entry of the vehicle in the fleet file.
        spot_enu_m: take-off spot of the vehicle [m], ENU.
        position_enu_m: position of the vehicle [m], ENU.
    """
    x, y, z = spot_enu_m
    distance_m = math.dist(position_enu_m[:2], (x, y))
    height_m = max(0.0, position_enu_m[2] - z)
    return (
        distance_m / (_MEAN_SPEED_SHARE * vehicle.max_speed_m_s)
        + height_m / _DESCENT_M_S
        + _AROUND_OTHERS_S
    )
