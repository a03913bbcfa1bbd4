"""Rules for expiring certificates: until when a flight may start, and when links are closed.

Zenoh checks a certificate when a link is opened. It could also close the link in the second in
which the certificate expires. Covey does not use that option, because the certificates of a fleet
expire together, and a vehicle in flight would receive nothing from then on. Instead:

* a flight starts only if all certificates are valid for the longest flight and one more hour;
* a node with an expired certificate cannot open a link, arm or order a take-off;
* agents on the ground and routers close all of their links one flight and one hour after the end.

Pure: ``certificate_ends.py`` reads the files.
"""

from __future__ import annotations

import datetime

from onboard.config.fleet import ConfigError, FleetConfig, Vehicle

_SPARE_S = 3600.0  # spare time, added to the longest flight
_UNKNOWN_FLIGHT_S = 7200.0  # flight time plus spare time of a vehicle without hover_time_s
SOON_S = 30.0 * 86400.0  # a certificate that expires within this time should be renewed
_IN_HOURS_S = 2.0 * 86400.0  # a shorter time is printed in hours


class NotYetValidError(ConfigError):
    """By this computer's clock, a certificate is not valid yet; the clock may still be set."""


def required_validity_s(vehicle: Vehicle) -> float:
    """Return how long [s] a certificate must still be valid when a vehicle takes off.

    Args:
        vehicle: a vehicle of the fleet file.
    Returns:
        the vehicle's longest flight plus one hour of spare time.
    """
    if vehicle.hover_time_s is None:
        return _UNKNOWN_FLIGHT_S
    return vehicle.hover_time_s + _SPARE_S


def longest_required_validity_s(fleet: FleetConfig) -> float:
    """Return the longest :func:`required_validity_s` of a fleet.

    Links stay open for as long after a certificate has expired, so that they outlast every flight
    that was allowed to begin.
    """
    return max((required_validity_s(vehicle) for vehicle in fleet.vehicles.values()), default=0.0)


def left_words(left_s: float) -> str:
    """Return a remaining time in words: "3.5 h" if less than two days, otherwise "12 days"."""
    if left_s < _IN_HOURS_S:
        return f"{left_s / 3600.0:.1f} h"
    return f"{left_s / 86400.0:.0f} days"


def end_words(end: datetime.datetime, now: datetime.datetime) -> str:
    """Return until when a certificate is valid, in words. In the last two days, also give the
    hours.

    Args:
        end: end of the certificate's validity.
        now: time by this computer's clock.
    """
    left_s = (end - now).total_seconds()
    if left_s < _IN_HOURS_S:
        return f"{end:%Y-%m-%d %H:%M} UTC, {left_words(left_s)} from now"
    return f"{end:%Y-%m-%d}"
