"""Wind facts for the failsafes: the wind against the vehicle's limit, and its effects.

There are three separate signs: the estimated wind, a disturbance observer at its bound, and gusts
that push the vehicle about. Only the first sign needs a known drag.

The limit is for the mean wind. The estimate is a mean over only two seconds, so gusts change it.
The wind counts as above its limit only if gusts cannot explain the estimate.

A rising wind is expected to rise for ten more seconds, because the estimate lags by three seconds,
a landing takes three more, and the rise itself is detected late. If the expected wind needs nearly
all of the tilt, the wind counts as above its limit now.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.wind_limit import (
    GUSTY,
    largest_push_m_s2,
    tilt_acceleration_m_s2,
    wind_limit_m_s,
)
from onboard.estimation.wind import COVERED_M_S2
from onboard.localization.own_state import OwnState
from onboard.safety.gust_margin import gust_margin_m
from onboard.supervision.tick_context import TickContext

_PERIOD_S = 0.1  # time between two calls of facts
_RISE_S = 6.0  # a rise of the mean is measured over this time
_GOES_ON_S = 10.0  # a rise is expected to continue for this time
# A wind above this share of its limit counts as strong, and so does a rising wind that will soon be
# above its limit. A vehicle in a strong wind lands when another vehicle lands because of the wind.
_STRONG_SHARE = 0.75
_SPENT_SHARE = 0.9  # "nearly all of the tilt": this share of the wind that takes all of it
_SCATTER_TIME_S = 2.0  # averaging time of the squared scatter
_RETURN_S = 3.0  # longest time of the return to the setpoint, after the law has moved the vehicle
_AT_BOUND_SHARE = 0.99  # the observer is at its bound from this share of the bound

# gusts of this share of the largest horizontal acceleration push a vehicle beyond its margin
_LARGEST_GUST_SHARE = 0.15


@dataclass(frozen=True, slots=True)
class WindFacts:
    """Effects of the wind on one vehicle; the defaults are those of calm air."""

    speed_m_s: float = math.nan  # mean wind; NaN: not known
    limit_m_s: float = math.nan  # NaN: not known
    # the wind is above three quarters of its limit, or will soon be above all of it
    is_strong: bool = False
    is_near: bool = False  # the estimated wind is above its limit
    is_above: bool = False  # the wind is above its limit, or will be soon
    is_rising: bool = False  # it rises so fast that it will soon take nearly all of the tilt
    is_at_bound: bool = False  # the disturbance observer has reached its bound
    gust_m_s2: float = 0.0  # standard deviation of the gusts, per axis
    scatter_m: float = 0.0  # rms distance of the position from its setpoint in hover
    is_pushed_about: bool = False  # gusts move the vehicle by more than its margin

    @property
    def words(self) -> str:
        """Wind and limit, for people."""
        rising_words = ""
        if self.is_rising:
            rising_words = " and rising fast"
        return f"{self.speed_m_s:.1f} m/s{rising_words}, its limit is {self.limit_m_s:.1f} m/s"

    @property
    def gust_words(self) -> str:
        """Gusts and scatter, for people."""
        return f"gusts of {self.gust_m_s2:.1f} m/s^2, {self.scatter_m:.2f} m in hover"


class WindMonitor:
    """Memory of one vehicle.

    Call :meth:`update` at every tick of a hover, :meth:`reset` at every other tick, and
    :meth:`facts` ten times a second.

    Args:
        fleet: the fleet file.
        vehicle: a vehicle of that file.
    """

    def __init__(self, fleet: FleetConfig, vehicle: Vehicle) -> None:
        self._limit_m_s = wind_limit_m_s(fleet, vehicle)
        self._bound_m_s2 = _AT_BOUND_SHARE * largest_push_m_s2(vehicle)
        self._law = fleet.law
        self._vehicle = vehicle
        self._largest_gust_m_s2 = _LARGEST_GUST_SHARE * tilt_acceleration_m_s2(vehicle)

        self._too_much_m_s = math.inf  # the wind that takes nearly all of the tilt
        if vehicle.drag_1_s > 0.0:
            full_tilt_wind_m_s = tilt_acceleration_m_s2(vehicle) / vehicle.drag_1_s
            self._too_much_m_s = _SPENT_SHARE * full_tilt_wind_m_s

        self._mean_square_m2 = 0.0  # mean squared distance from the setpoint in hover
        self._return_s = 0.0  # longest remaining time of the return to the setpoint
        self._earlier_enu_m_s = (0.0, 0.0)  # the wind about _RISE_S ago
        self._known_count = 0  # number of calls in a row at which the wind was known

    def reset(self) -> None:
        """Forget the hover."""
        self._mean_square_m2 = 0.0
        self._return_s = 0.0

    def update(self, context: TickContext, dt_s: float) -> None:
        """Take one tick of a hover.

        While the law moves the vehicle, and during its return, the distance from the setpoint is
        not caused by gusts and does not count. The return ends when the vehicle is as near to its
        setpoint as before, or at the latest after ``_RETURN_S``.
        """
        square_m2 = context.setpoint_miss_m * context.setpoint_miss_m
        if not math.isfinite(square_m2):
            return

        if context.is_law_active:
            self._return_s = _RETURN_S
            return

        self._return_s = max(0.0, self._return_s - dt_s)
        has_returned = self._return_s <= 0.0 or square_m2 <= self._mean_square_m2
        if not has_returned:
            return

        self._return_s = 0.0
        blend = min(1.0, dt_s / _SCATTER_TIME_S)
        self._mean_square_m2 += blend * (square_m2 - self._mean_square_m2)

    def facts(self, own: OwnState, context: TickContext) -> WindFacts:
        """Return the wind facts at this time."""
        speed_m_s = math.hypot(*own.wind_enu_m_s)
        self._remember(own.wind_enu_m_s)
        soon_m_s = self._soon_m_s(own.wind_enu_m_s)
        is_rising = soon_m_s > self._too_much_m_s
        is_strong = speed_m_s > _STRONG_SHARE * self._limit_m_s or soon_m_s > self._limit_m_s

        gust_m_s2 = own.gust_m_s2
        scatter_m = math.sqrt(self._mean_square_m2)
        is_scattered = gust_m_s2 > COVERED_M_S2 and scatter_m > self._margin_m(gust_m_s2)

        push_east_m_s2, push_north_m_s2, _ = context.disturbance_enu_m_s2
        largest_push_axis_m_s2 = max(abs(push_east_m_s2), abs(push_north_m_s2))

        # gusts explain an estimate up to GUSTY times the limit; comparisons with NaN are False
        return WindFacts(
            speed_m_s=speed_m_s,
            limit_m_s=self._limit_m_s,
            is_strong=is_strong,
            is_near=speed_m_s > self._limit_m_s,
            is_above=is_rising or speed_m_s > GUSTY * self._limit_m_s,
            is_rising=is_rising,
            is_at_bound=largest_push_axis_m_s2 > self._bound_m_s2,
            gust_m_s2=gust_m_s2,
            scatter_m=scatter_m,
            is_pushed_about=is_scattered or gust_m_s2 > self._largest_gust_m_s2,
        )

    def _remember(self, wind_enu_m_s: tuple[float, float]) -> None:
        """Update the earlier wind with the present wind; reset it if the wind is not known."""
        east_m_s, north_m_s = wind_enu_m_s
        if not math.isfinite(east_m_s + north_m_s):
            self._known_count = 0
            return

        # a plain mean at first, then a low-pass
        self._known_count += 1
        blend = max(_PERIOD_S / _RISE_S, 1.0 / self._known_count)
        east_before_m_s, north_before_m_s = self._earlier_enu_m_s
        east_before_m_s += blend * (east_m_s - east_before_m_s)
        north_before_m_s += blend * (north_m_s - north_before_m_s)
        self._earlier_enu_m_s = (east_before_m_s, north_before_m_s)

    def _soon_m_s(self, wind_enu_m_s: tuple[float, float]) -> float:
        """Return the wind [m/s] after _GOES_ON_S if it continues to rise; NaN while not known."""
        if self._known_count == 0:
            return math.nan

        east_m_s, north_m_s = wind_enu_m_s
        east_before_m_s, north_before_m_s = self._earlier_enu_m_s

        share = _GOES_ON_S / _RISE_S
        east_soon_m_s = east_m_s + share * (east_m_s - east_before_m_s)
        north_soon_m_s = north_m_s + share * (north_m_s - north_before_m_s)
        return math.hypot(east_soon_m_s, north_soon_m_s)

    def _margin_m(self, gust_m_s2: float) -> float:
        """Return the margin that others keep from a vehicle in such gusts."""
        return gust_margin_m(gust_m_s2, self._vehicle, self._law)
