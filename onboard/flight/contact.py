"""Contact with the ground: never by one sign alone, and only by what has lasted for a moment. Pure.

A vehicle is down when

    it is low, or much less thrust carries it than flight takes,
    and at the same time
    it does not move vertically, or PX4 reports the ground, and the report is not old.

Thrust and stillness together need neither a height nor PX4: in free fall a third of a second at
that thrust moves the vehicle by more than stillness allows.
"""

from __future__ import annotations

from msgspec import Struct

from onboard.flight.types import FlightView

AGREED_S = 0.35  # how long the signs have to agree

_LIGHT_SHARE = 0.8  # of the thrust that carries it
_STILL_M = 0.02  # of height, while AGREED_S passes
_STILL_PX4_M_S = 0.15  # for vehicles without a mocap, whose height has more noise than that
_LOW_M = 0.06

# A vehicle that should have been down for a while, and does not move any more.
_STALLED_M = 0.30
_STALLED_S = 1.5

# Without poses the height is PX4's, which reads too high by up to half a metre. But it shows when
# the sinking ends.
_BLIND_LOW_M = 0.5
_BLIND_STILL_M_S = 0.25
_BLIND_STILL_S = 0.3


class ContactSigns(Struct, frozen=True):
    """Since when each sign of contact has lasted."""

    height_m: float = 0.0  # from which it has not moved
    still_ns: int = 0  # it does not move vertically
    light_ns: int = 0  # less thrust carries it than flight takes
    reported_ns: int = 0  # PX4 reports the ground


def observe(signs: ContactSigns, view: FlightView, has_mocap: bool) -> ContactSigns:
    """Return the signs as of this tick.

    Args:
        signs: as of the last tick.
        view: of this tick.
        has_mocap: whether the height is measured to millimetres.
    """
    now_ns = view.now_ns
    height_m = view.position_enu_m[2]

    if has_mocap and not view.is_blind:
        is_still = abs(height_m - signs.height_m) < _STILL_M
        still_height_m = signs.height_m if is_still else height_m
    else:
        limit_m_s = _BLIND_STILL_M_S if view.is_blind else _STILL_PX4_M_S
        is_still = abs(view.snapshot.velocity_local_ned_m_s[2]) < limit_m_s
        still_height_m = height_m

    is_light = view.thrust_share < _LIGHT_SHARE
    return ContactSigns(
        height_m=still_height_m,
        still_ns=signs.still_ns if is_still else now_ns,
        light_ns=signs.light_ns if is_light else now_ns,
        reported_ns=signs.reported_ns if view.is_on_ground else now_ns,
    )


def is_agreed(signs: ContactSigns, view: FlightView, ground_z_m: float, is_late: bool) -> bool:
    """Return whether the signs say that the vehicle stands.

    Args:
        signs: as of this tick.
        view: of this tick.
        ground_z_m: height of the ground where it took off [m].
        is_late: whether it should have been down for a while.
    """
    since_ns = view.now_ns - round(1e9 * AGREED_S)
    is_still = signs.still_ns < since_ns
    is_light = signs.light_ns < since_ns
    is_reported = signs.reported_ns < since_ns

    height_m = view.position_enu_m[2] - ground_z_m
    if (is_light or height_m < _LOW_M) and (is_still or is_reported):
        return True

    has_stalled = view.now_ns - signs.still_ns > 1e9 * _STALLED_S
    return is_late and height_m < _STALLED_M and has_stalled


def is_agreed_blind(signs: ContactSigns, view: FlightView, ground_z_m: float) -> bool:
    """Return whether PX4's motion and height say that a vehicle stands that sinks without poses.

    Args:
        signs: as of this tick.
        view: of this tick.
        ground_z_m: height of the ground where it took off [m].
    """
    is_low = view.position_enu_m[2] - ground_z_m < _BLIND_LOW_M
    return is_low and view.now_ns - signs.still_ns > 1e9 * _BLIND_STILL_S
