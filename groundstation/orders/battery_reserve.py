"""Time that vehicles may stay in the air until the weakest battery requires a return. Pure.

A vehicle needs a share of its battery for its way to a take-off spot and for the landing there. It
must leave while its charge is at least that share above the level at which it lands where it is.

A charge that stands still during a pause is not believed: PX4's simulated battery stops at
SIM_BAT_MIN_PCT, above every level at which a vehicle goes home, and a broken sensor stops anywhere.
Then the charge is counted on by the clock, so that each pause ends.
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
_STANDS_S = 30.0  # a charge that has not changed for so long stands still
_MEAN_SPEED_SHARE = 0.5  # mean speed divided by top speed, on a way from rest to rest
_DESCENT_M_S = 0.4
_AROUND_OTHERS_S = 20.0  # time to turn round, to avoid others and to wait above a spot


class Reserve(NamedTuple):
    """Charge of the weakest vehicle, and the charge at which it must go home."""

    name: str
    has_pct: float  # present charge
    needs_pct: float  # charge at which it has to leave
    left_s: float  # time until then, at the present rate of discharge
    stands_at_pct: float | None = None  # charge that it reports, if that is not believed any more

    @property
    def is_used_up(self) -> bool:
        """Whether the vehicle has to leave now."""
        return self.has_pct <= self.needs_pct

    def __str__(self) -> str:
        counted = ""
        if self.stands_at_pct is not None:
            counted = f" by the clock, because its report stands at {self.stands_at_pct:.0f} %"
        return (
            f"the weakest battery is {self.name}'s with {self.has_pct:.0f} %{counted}; "
            f"at {self.needs_pct:.0f} % all are brought home"
        )


class Discharge:
    """Rate of discharge of each battery since the first call, as its vehicle reports it."""

    def __init__(self) -> None:
        # vehicle -> time [ns] and charge [fraction] of its first report, and of its last change
        self._first: dict[str, tuple[int, float]] = {}
        self._changed: dict[str, tuple[int, float]] = {}

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

    def stands_s(self, name: str, now_ns: int, battery_frac: float) -> float:
        """Return for how long the charge has been this one [s], as far as it was looked at.

        Args:
            name: name of the vehicle.
            now_ns: the ground's clock [ns].
            battery_frac: charge that is reported now, as a fraction of a full battery.
        """
        since_ns, last_frac = self._changed.get(name, (now_ns, battery_frac))
        if last_frac != battery_frac:
            since_ns = now_ns
        self._changed[name] = (since_ns, battery_frac)
        return (now_ns - since_ns) * 1e-9


def weakest(
    fleet: FleetConfig,
    state: FleetState,
    names: Sequence[str],
    discharge: Discharge,
    now_ns: int,
    *,
    paused_s: float = 0.0,
) -> Reserve | None:
    """Return the vehicle whose charge exceeds the charge for its return by the smallest margin.

    Return None if no vehicle reports its charge.

    Args:
        fleet: the fleet file.
        state: the fleet as known now.
        names: names of the vehicles in the air.
        discharge: discharge of their batteries until now.
        now_ns: the ground's clock [ns].
        paused_s: how long they have been paused [s].
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
        stands_at_pct = None
        stands_s = discharge.stands_s(name, now_ns, telemetry.battery_frac)
        counted_s = min(stands_s, paused_s) - _STANDS_S
        if counted_s > 0.0:
            stands_at_pct = has_pct
            has_pct = max(0.0, has_pct - rate_pct_s * counted_s)

        needs_pct = fleet.fleet.battery_land_pct + SPARE_PCT + return_s * rate_pct_s
        left_s = max(0.0, has_pct - needs_pct) / rate_pct_s
        reserve = Reserve(
            name=name,
            has_pct=has_pct,
            needs_pct=needs_pct,
            left_s=left_s,
            stands_at_pct=stands_at_pct,
        )
        reserves.append(reserve)
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
