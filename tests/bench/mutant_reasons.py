"""Mutants that no test can notice, or that none needs to notice, each with its reason.

A mutant is named by its file, its line of code and its change, so that a reason does not outlive
the code that it speaks of: a test fails for one whose line is gone.
"""

from __future__ import annotations

from typing import NamedTuple


class Accepted(NamedTuple):
    """Mutants that survive for the same reason."""

    reason: str
    file: str  # below onboard
    mutants: tuple[tuple[str, str], ...]  # line of code, and change of it


_LARGER = "Gt becomes GtE"
_SMALLER = "Lt becomes LtE"

ACCEPTED = (
    Accepted(
        "who does not move along an axis needs no distance to stop, whichever wall is ahead",
        "safety/geofence.py",
        (
            ("ahead_x_m = east - x if vx > 0.0 else x - west", _LARGER),
            ("ahead_y_m = north - y if vy > 0.0 else y - south", _LARGER),
        ),
    ),
    Accepted(
        "who does not climb needs no distance to stop below the ceiling",
        "safety/geofence.py",
        (("or (vz > 0.0 and self._is_near(top - z, vz, brake_z))", _LARGER),),
    ),
    Accepted(
        "no measured number lies on its limit for good",
        "supervision/wind_monitor.py",
        (
            ("is_rising = self._soon_m_s(own.wind_enu_m_s) > self._too_much_m_s", _LARGER),
            (
                "is_scattered = gust_m_s2 > COVERED_M_S2 and scatter_m > self._margin_m(gust_m_s2)",
                _LARGER,
            ),
            ("is_near=speed_m_s > self._limit_m_s,", _LARGER),
            ("is_above=is_rising or speed_m_s > GUSTY * self._limit_m_s,", _LARGER),
            ("is_at_bound=max(abs(push[0]), abs(push[1])) > self._bound_m_s2,", _LARGER),
            ("is_pushed_about=is_scattered or gust_m_s2 > self._largest_gust_m_s2,", _LARGER),
        ),
    ),
    Accepted(
        "the first look replaces it",
        "supervision/wind_monitor.py",
        (
            (
                "self._earlier_enu_m_s = (0.0, 0.0)  # the mean wind, later by the time of a rise",
                "0.0 becomes larger",
            ),
        ),
    ),
    Accepted(
        "as a float, the time of the limit lies beside the number that stands in the code",
        "flight/contact.py",
        (("return height_m < _BLIND_LOW_M and stands_s > for_s", _LARGER),),
    ),
)

REASONS = {
    (accepted.file, code, change): accepted.reason
    for accepted in ACCEPTED
    for code, change in accepted.mutants
}
