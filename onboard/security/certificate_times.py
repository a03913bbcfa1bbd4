"""Rules for the end of certificates: until when a flight may begin, and when links are closed.

Zenoh checks a certificate when a link is opened. It could also close the link in the second in
which the certificate ends. Covey does not use that option: the certificates of a fleet end
together, and from that second on a vehicle in flight would receive nothing. Instead:

* a flight begins only if all certificates are valid for the longest flight and one more hour;
* a node whose certificate has ended cannot open a link, arm or order a take-off;
* agents on the ground and routers close all of their links one flight and one hour after the end.

Pure: ``certificate_ends.py`` reads the files.
"""

from __future__ import annotations

import datetime

from onboard.config.fleet import FleetConfig, Vehicle

_SPARE_S = 3600.0  # added to the longest flight
_UNKNOWN_FLIGHT_S = 7200.0  # flight and spare time of a vehicle without hover_time_s
SOON_S = 30.0 * 86400.0  # a certificate that ends within this time should be renewed
_IN_HOURS_S = 2.0 * 86400.0  # a shorter time is printed in hours


def flight_s(vehicle: Vehicle) -> float:
    """Return how long [s] a certificate must still be valid when a vehicle takes off.

    Args:
        vehicle: a vehicle of the fleet file.
    Returns:
        its longest flight plus an hour.
    """
    if vehicle.hover_time_s is None:
        return _UNKNOWN_FLIGHT_S
    return vehicle.hover_time_s + _SPARE_S


def longest_flight_s(fleet: FleetConfig) -> float:
    """Return the longest :func:`flight_s` of a fleet.

    Links are closed this long after the end of a certificate.
    """
    return max((flight_s(vehicle) for vehicle in fleet.vehicles.values()), default=0.0)


def left_words(left_s: float) -> str:
    """Return a remaining time in words: "3.5 h" if less than two days, else "12 days"."""
    if left_s < _IN_HOURS_S:
        return f"{left_s / 3600.0:.1f} h"
    return f"{left_s / 86400.0:.0f} days"


def end_words(end: datetime.datetime, now: datetime.datetime) -> str:
    """Return until when a certificate is valid, in words; the last two days also in hours.

    Args:
        end: end of the certificate's validity.
        now: time by this computer's clock.
    """
    left_s = (end - now).total_seconds()
    if left_s < _IN_HOURS_S:
        return f"{end:%Y-%m-%d %H:%M} UTC, {left_words(left_s)} from now"
    return f"{end:%Y-%m-%d}"
