"""Contact with the ground: never by one sign alone, and only by what has lasted for a moment. Pure.

A vehicle is down when

    it is low, or much less thrust carries it than flight takes,
    and at the same time
    it does not move vertically, or PX4 reports the ground, and the report is not old.

Thrust and stillness together need neither a height nor PX4: in free fall a third of a second at
that thrust moves the vehicle by more than stillness allows.

PX4's own height, by satellites, errs by half a metre. There low is no sign at all, and only thrust
tells: the setpoint goes on sinking, and the vehicle does not although hardly anything carries it.
PX4's land detector cannot decide either: with attitude setpoints it reports the ground only when
there has been no thrust for a while (MPC_MANTHR_MIN in its MulticopterLandDetector.cpp).
"""

from __future__ import annotations

from msgspec import Struct

from onboard.flight.types import FlightView

AGREED_S = 0.35  # how long the signs have to agree

_LIGHT_SHARE = 0.8  # of the thrust that carries it
_STILL_M = 0.02  # of height, while AGREED_S passes
_STILL_PX4_M_S = 0.15  # for vehicles without a mocap, whose height has more noise than that
_LOW_M = 0.06

# Without a mocap, where PX4's velocity errs by more than stillness allows: so long at so little
# thrust, a vehicle in the air sinks with 3 m/s.
_LIGHT_LONG_S = 1.5
_LIGHT_SLOW_M_S = 0.7

# A vehicle that should have been down for a while, and does not move any more.
_STALLED_M = 0.30
_STALLED_S = 1.5

# Without poses the height is PX4's, which is wrong by a third of a metre: it cannot tell where the
# ground is. But a vehicle that sinks at 0.8 m/s until it meets something shows when that happens.
# PX4 may take the impact for a climb, so that rising counts as standing.
_BLIND_LOW_M = 0.6
_BLIND_SINKS_M_S = 0.25
_BLIND_STANDS_S = 0.26
_BLIND_TOUCHES_S = 0.06  # after which it seems to stand
_BLIND_UNDER_GROUND_M = -1.0  # no error explains this height


class ContactSigns(Struct, frozen=True):
    """Since when each sign of contact has lasted."""

    height_m: float = 0.0  # from which it has not moved
    still_ns: int = 0  # it does not move vertically
    light_ns: int = 0  # less thrust carries it than flight takes
    reported_ns: int = 0  # PX4 reports the ground
    slow_ns: int = 0  # it sinks slower than a vehicle that nothing carries


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
        sinking_m_s = view.snapshot.velocity_local_ned_m_s[2]
        is_still = abs(sinking_m_s) < _STILL_PX4_M_S
        if view.is_blind:
            is_still = sinking_m_s < _BLIND_SINKS_M_S
        still_height_m = height_m

    is_light = view.thrust_share < _LIGHT_SHARE
    is_slow = abs(view.snapshot.velocity_local_ned_m_s[2]) < _LIGHT_SLOW_M_S
    return ContactSigns(
        height_m=still_height_m,
        still_ns=signs.still_ns if is_still else now_ns,
        light_ns=signs.light_ns if is_light else now_ns,
        reported_ns=signs.reported_ns if view.is_on_ground else now_ns,
        slow_ns=signs.slow_ns if is_slow else now_ns,
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


def is_agreed_by_thrust(signs: ContactSigns, view: FlightView) -> bool:
    """Return whether thrust and motion say that a vehicle stands, whatever its height reads.

    Args:
        signs: as of this tick.
        view: of this tick.
    """
    since_ns = view.now_ns - round(1e9 * AGREED_S)
    is_light = signs.light_ns < since_ns
    is_still = signs.still_ns < since_ns
    is_reported = signs.reported_ns < since_ns
    if is_light and (is_still or is_reported):
        return True

    long_ago_ns = view.now_ns - round(1e9 * _LIGHT_LONG_S)
    return signs.light_ns < long_ago_ns and signs.slow_ns < long_ago_ns


def is_agreed_blind(signs: ContactSigns, view: FlightView, ground_z_m: float) -> bool:
    """Return whether PX4's motion and height say that a vehicle stands that sinks without poses.

    Args:
        signs: as of this tick.
        view: of this tick.
        ground_z_m: height of the ground where it took off [m].
    """
    height_m = view.position_enu_m[2] - ground_z_m
    if height_m < _BLIND_UNDER_GROUND_M:
        return True
    return _has_stood_low(signs, view, height_m, _BLIND_STANDS_S)


def seems_to_stand_blind(signs: ContactSigns, view: FlightView, ground_z_m: float) -> bool:
    """Return whether a vehicle that sinks without poses seems to have met the ground.

    That comes sooner than :func:`is_agreed_blind`, and ends no flight: it says from when on dead
    reckoning must not go on.

    Args:
        signs: as of this tick.
        view: of this tick.
        ground_z_m: height of the ground where it took off [m].
    """
    height_m = view.position_enu_m[2] - ground_z_m
    return _has_stood_low(signs, view, height_m, _BLIND_TOUCHES_S)


def _has_stood_low(signs: ContactSigns, view: FlightView, height_m: float, for_s: float) -> bool:
    """Return whether a vehicle without poses has been still for so long where the ground may be."""
    stands_s = (view.now_ns - signs.still_ns) * 1e-9
    return height_m < _BLIND_LOW_M and stands_s > for_s
