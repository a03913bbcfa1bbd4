"""Contact with the ground: never by one signal alone, and only by what has lasted for a moment.
Pure.

A vehicle is down when it is low, or carried by much less thrust than flight takes, and at the same
time does not move vertically, or is on the ground by a report of PX4 that is not old. In free fall
a third of a second at that thrust moves it by more than stillness allows, so thrust and stillness
together need neither a height nor PX4.
"""

from __future__ import annotations

from msgspec import Struct

from onboard.flight.types import FlightView

AGREED_S = 0.35  # how long the signals have to agree
_LIGHT_SHARE = 0.8  # of the thrust that carries it
_STILL_M = 0.02  # of height, while AGREED_S passes
_STILL_PX4_M_S = 0.15  # for vehicles without a mocap, whose height has more noise than that
_LOW_M = 0.06
_STALLED_M, _STALLED_S = 0.30, 1.5
# without poses the height is PX4's, which reads too high by up to half a metre; but it shows when
# the sinking ends
_BLIND_LOW_M, _BLIND_STILL_M_S, _BLIND_STILL_S = 0.5, 0.25, 0.3


class ContactSigns(Struct, frozen=True):
    """Times [ns] since which each sign of contact has lasted."""

    height_m: float = 0.0  # from which it has not moved
    still_ns: int = 0
    light_ns: int = 0
    reported_ns: int = 0


def observe(signs: ContactSigns, view: FlightView, has_mocap: bool) -> ContactSigns:
    """Return the signs as of this tick.

    Args:
        signs: as of the last tick.
        view: of this tick.
        has_mocap: whether the height is measured to millimetres.
    """
    now_ns, z = view.now_ns, view.position_enu_m[2]
    if view.is_blind:
        is_still, height_m = abs(view.snapshot.velocity_local_ned_m_s[2]) < _BLIND_STILL_M_S, z
    elif has_mocap:
        is_still, height_m = abs(z - signs.height_m) < _STILL_M, signs.height_m
    else:
        is_still, height_m = abs(view.snapshot.velocity_local_ned_m_s[2]) < _STILL_PX4_M_S, z
    return ContactSigns(
        height_m if is_still else z,
        signs.still_ns if is_still else now_ns,
        signs.light_ns if view.thrust_share < _LIGHT_SHARE else now_ns,
        signs.reported_ns if view.is_on_ground else now_ns,
    )


def is_agreed_blind(signs: ContactSigns, view: FlightView, ground_z_m: float) -> bool:
    """Whether PX4's motion and height say that a vehicle without poses, which is told to sink,
    stands.

    Args:
        signs: as of this tick.
        view: of this tick.
        ground_z_m: height of the ground where it took off [m].
    """
    is_low = view.position_enu_m[2] - ground_z_m < _BLIND_LOW_M
    return is_low and view.now_ns - signs.still_ns > 1e9 * _BLIND_STILL_S


def is_agreed(signs: ContactSigns, view: FlightView, ground_z_m: float, is_late: bool) -> bool:
    """Whether the signs say that the vehicle stands.

    Args:
        signs: as of this tick.
        view: of this tick.
        ground_z_m: height of the ground where it took off [m].
        is_late: whether it should have been down for a while.
    """
    since_ns = view.now_ns - round(1e9 * AGREED_S)
    height_m = view.position_enu_m[2] - ground_z_m
    is_still, is_light = signs.still_ns < since_ns, signs.light_ns < since_ns
    if (is_light or height_m < _LOW_M) and (is_still or signs.reported_ns < since_ns):
        return True
    return is_late and height_m < _STALLED_M and view.now_ns - signs.still_ns > 1e9 * _STALLED_S
