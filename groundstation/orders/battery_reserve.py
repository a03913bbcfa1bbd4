"""Time that vehicles may stay in the air until the weakest battery requires a return. Pure.

A vehicle needs a share of its battery for its way to a take-off spot and for the landing there. It
must leave while its charge is at least that share above the level at which it lands where it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from groundstation.fleet.slot_owners import spot_of
from groundstation.fleet.state import FleetState
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.tuples import Xyz

# Hover time of a full battery if the fleet file has none; a short time, to be safe.
ASSUMED_HOVER_S = 300.0
SPARE_PCT = 5.0  # charge that is left at home, above the landing level

_MIN_OBSERVED_S = 5.0  # shortest observation from which a rate of discharge is computed
_MEAN_SPEED_SHARE = 0.5  # mean speed divided by top speed, on a way from rest to rest
_DESCENT_M_S = 0.4
_AROUND_OTHERS_S = 20.0  # time to turn round, to avoid others and to wait above a spot


class Reserve(NamedTuple):
    """Charge of the weakest vehicle, and the charge at which it must go home."""

    name: str
    has_pct: float  # present charge
    needs_pct: float  # charge at which it has to leave
    left_s: float  # time until then, at the present rate of discharge

    @property
    def is_used_up(self) -> bool:
        """Whether the vehicle has to leave now."""
        return self.has_pct <= self.needs_pct

    def __str__(self) -> str:
        return (
            f"the weakest battery is {self.name}'s with {self.has_pct:.0f} %; "
            f"at {self.needs_pct:.0f} % all are brought home"
        )


class Discharge:
    """Rate of discharge of each battery since the first call, as its vehicle reports it."""

    def __init__(self) -> None:
        # vehicle -> time [ns] and charge [fraction] of its first report
        self._first: dict[str, tuple[int, float]] = {}

    def rate_1_s(self, name: str, now_ns: int, battery_frac: float) -> float:
        """Return the fraction of a full battery that is used per second; 0 in the first seconds.

        Args:
            name: name of the vehicle.
            now_ns: the ground's clock [ns].
            battery_frac: charge that is reported now, as a fraction of a full battery.
        """
        begin_ns, first_frac = self._first.setdefault(name, (now_ns, battery_frac))
        since_s = (now_ns - begin_ns) * 1e-9
        if since_s < _MIN_OBSERVED_S:
            return 0.0
        return max(0.0, first_frac - battery_frac) / since_s


def weakest(
    fleet: FleetConfig,
    state: FleetState,
    names: Sequence[str],
    discharge: Discharge,
    now_ns: int,
) -> Reserve | None:
    """Return the vehicle whose charge exceeds the charge for its return by the smallest margin.

    Return None if no vehicle reports its charge.

    Args:
        fleet: the fleet file.
        state: the fleet as known now.
        names: names of the vehicles in the air.
        discharge: discharge of their batteries until now.
        now_ns: the ground's clock [ns].
    """
    reserves = []
    for name in names:
        view = state.vehicles[name]
        telemetry = view.telemetry
        if telemetry is None or not math.isfinite(telemetry.battery_frac):
            continue

        position_enu_m = telemetry.position_enu_m
        if not telemetry.is_position_valid:
            position_enu_m = view.seen_enu_m  # where it was last seen
        spot_enu_m = spot_of(name, fleet, state)
        return_s = way_home_s(fleet.vehicles[name], spot_enu_m, position_enu_m)
        hover_s = fleet.vehicles[name].hover_time_s or ASSUMED_HOVER_S
        observed_1_s = discharge.rate_1_s(name, now_ns, telemetry.battery_frac)
        rate_pct_s = 100.0 * max(1.0 / hover_s, observed_1_s)  # the faster one, to be safe

        has_pct = 100.0 * telemetry.battery_frac
        needs_pct = fleet.fleet.battery_land_pct + SPARE_PCT + return_s * rate_pct_s
        left_s = max(0.0, has_pct - needs_pct) / rate_pct_s
        reserves.append(Reserve(name, has_pct, needs_pct, left_s))
    return min(reserves, key=lambda reserve: reserve.has_pct - reserve.needs_pct, default=None)


def way_home_s(vehicle: Vehicle, spot_enu_m: Xyz, position_enu_m: Sequence[float]) -> float:
    """Return the time of the way to the take-off spot and of the landing there [s].

    Args:
        vehicle: entry of the vehicle in the fleet file.
        spot_enu_m: take-off spot of the vehicle [m], ENU.
        position_enu_m: position of the vehicle [m], ENU.
    """
    x, y, z = spot_enu_m
    distance_m = math.dist(position_enu_m[:2], (x, y))
    height_m = max(0.0, position_enu_m[2] - z)
    mean_speed_m_s = _MEAN_SPEED_SHARE * vehicle.max_speed_m_s
    return distance_m / mean_speed_m_s + height_m / _DESCENT_M_S + _AROUND_OTHERS_S
