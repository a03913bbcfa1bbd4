"""Detects contact with the ground from two signs that have held for a moment. Pure.

A vehicle stands on the ground if both are true:

    it is low and its thrust is less than its weight, or its thrust is much less;
    it does not move vertically, or PX4 reports the ground.

PX4's report of the ground counts at any time for a low vehicle. For another one it counts only if
it came after the thrust became little.

Little thrust together with no vertical motion needs neither a height nor PX4. In the air, a vehicle
with so little thrust would, within a third of a second, move more than "no vertical motion" allows.

PX4's own height from satellites has an error of half a metre, so a low height is not a sign there.
Only the thrust shows the contact. The setpoint keeps sinking and the thrust falls, but the vehicle
does not sink. PX4's land detector does not help either. With attitude setpoints it reports the
ground only after a while without thrust (MPC_MANTHR_MIN in its MulticopterLandDetector.cpp).
"""

from __future__ import annotations

import math

from msgspec import Struct

from onboard.config.fleet_config import Vehicle
from onboard.constants import GRAVITY_M_S2
from onboard.control.vertical_limits import baseline_m_s2
from onboard.flight.types import FlightView
from onboard.frames import body_up

AGREED_S = 0.35  # both signs must hold for this time

# Less lift than this share of the hover thrust is little. A vehicle with little lift reserve may
# accelerate only little, also downwards. So for it this share of that acceleration is enough.
_LIGHT_SHARE = 0.8
_LIGHT_OF_LIMIT = 0.8
_STILL_M = 0.02  # a vehicle is still if its height changes by less within AGREED_S
_STILL_PX4_M_S = 0.15  # without a mocap the height is noisier, so the vertical speed counts
LOW_M = 0.06  # below this height above the ground, the landing gear may touch it
# Below this height a vehicle is low. If it does not stand but is still for a moment, at the top of
# a short climb, its thrust ends, and it touches down with 0.8 m/s at most.
_STANDS_BELOW_M = 0.03
# This far below the expected ground a vehicle is not low, because it flies above lower ground. A
# goal below that ground is reached to within 0.05 m in wind, so the limit is above it.
UNDER_GROUND_M = -0.02
# A vehicle with more than this share of the hover thrust hovers. For instance, the law may keep a
# landing vehicle a few centimetres above the ground.
_HOVERS_SHARE = 0.97

# A vehicle without a mocap that lies below its goal, for instance after a crash, pushes upwards and
# does not move. In the air, so much vertical thrust would climb 8 m within this time.
_PUSHES_SHARE = 1.2
_STUCK_S = 3.0
_STUCK_M_S = 0.3  # it does not move horizontally below this speed
_STUCK_BELOW_M = 0.5  # its goal is at least this much higher

# Without a mocap PX4's velocity may err by more than _STILL_PX4_M_S. After _LIGHT_LONG_S with
# little thrust, a vehicle in the air would sink at 3 m/s, and one with little lift reserve after
# longer. A vehicle slower than _LIGHT_SLOW_M_S has landed.
_LIGHT_LONG_S = 1.5
_LIGHT_SLOW_M_S = 0.7

# A vehicle that should have landed a while ago stands if it is this low and still for this time.
_STALLED_M = 0.30
_STALLED_S = 1.5

# Without poses, only PX4's height is known, which is wrong by up to a third of a metre. A better
# sign is that the vehicle, which sinks at 0.8 m/s, stops sinking at the ground. PX4 may mistake the
# impact for a climb, so rising counts as standing, too.
_WITHOUT_POSES_LOW_M = 0.6  # the ground may be below this height
_WITHOUT_POSES_SINKS_M_S = 0.25  # a vehicle that sinks more slowly than this stands
_WITHOUT_POSES_STANDS_S = 0.26  # a vehicle that stands for this time has landed
_WITHOUT_POSES_TOUCHES_S = 0.06  # a vehicle that stands for this time may have landed
# no error explains a height this low, so the vehicle has landed
_WITHOUT_POSES_UNDER_GROUND_M = -1.0


class ContactSigns(Struct, frozen=True):
    """Signs of contact, and since when [ns] each of them has held: now while it does not hold."""

    height_m: float = 0.0  # height at which the vehicle has been still
    still_since_ns: int = 0  # the vehicle does not move vertically
    light_since_ns: int = 0  # its thrust is much less than its weight
    reported_since_ns: int = 0  # PX4 reports the ground
    slow_since_ns: int = 0  # its vertical speed is much less than in a fall with little thrust
    pushing_since_ns: int = 0  # its thrust is much more than its weight, and it does not move along
    # The times for which little lift must last are longer by this factor for a vehicle that may
    # sink with little acceleration only. In the air it would gain the same speed within them.
    time_factor: float = 1.0


def light_share(hover_thrust_frac: float) -> float:
    """Return the share of the hover thrust below which a vehicle's lift is little.

    Args:
        hover_thrust_frac: throttle at which the vehicle hovers.
    """
    largest_g = baseline_m_s2(hover_thrust_frac) / GRAVITY_M_S2
    return max(_LIGHT_SHARE, 1.0 - _LIGHT_OF_LIMIT * largest_g)


def observe(
    signs: ContactSigns, view: FlightView, vehicle: Vehicle, *, sinks_without_poses: bool
) -> ContactSigns:
    """Return the signs of contact at this tick.

    Args:
        signs: signs of contact at the last tick.
        view: what the flight sees at this tick.
        vehicle: the vehicle; a mocap measures its height to within millimetres.
        sinks_without_poses: whether the vehicle descends without poses; single poses may still
            come.
    """
    now_ns = view.now_ns
    _, _, height_m = view.position_enu_m
    _, _, sinking_m_s = view.snapshot.velocity_local_ned_m_s

    still_height_m = height_m
    if view.is_dead_reckoned or sinks_without_poses:
        is_still = sinking_m_s < _WITHOUT_POSES_SINKS_M_S
    elif not vehicle.mocap_required:
        is_still = abs(sinking_m_s) < _STILL_PX4_M_S
    else:
        is_still = abs(height_m - signs.height_m) < _STILL_M
        if is_still:
            still_height_m = signs.height_m

    little = light_share(vehicle.hover_thrust_frac)
    is_light = view.lift_share < little
    is_slow = abs(sinking_m_s) < _LIGHT_SLOW_M_S
    along_m_s = math.hypot(*view.velocity_enu_m_s[:2])
    _, _, up_share = body_up(view.attitude_wxyz)
    is_pushing = view.thrust_share * up_share > _PUSHES_SHARE and along_m_s < _STUCK_M_S
    return ContactSigns(
        height_m=still_height_m,
        still_since_ns=_since_ns(signs.still_since_ns, is_still, now_ns),
        light_since_ns=_since_ns(signs.light_since_ns, is_light, now_ns),
        reported_since_ns=_since_ns(signs.reported_since_ns, view.is_on_ground, now_ns),
        slow_since_ns=_since_ns(signs.slow_since_ns, is_slow, now_ns),
        pushing_since_ns=_since_ns(signs.pushing_since_ns, is_pushing, now_ns),
        # how much longer a vehicle with little lift reserve takes to gain the same speed
        time_factor=(1.0 - _LIGHT_SHARE) / (1.0 - little),
    )


def _since_ns(began_ns: int, holds: bool, now_ns: int) -> int:
    """Return since when a sign holds: now while it does not hold."""
    if holds:
        return began_ns
    return now_ns


def has_ground_contact(
    signs: ContactSigns, view: FlightView, ground_z_m: float, is_late: bool
) -> bool:
    """Return whether the vehicle stands on the ground, by its height, motion and thrust.

    Args:
        signs: signs of contact at this tick.
        view: what the flight sees at this tick.
        ground_z_m: height of the expected ground [m].
        is_late: whether the vehicle should have landed a while ago.
    """
    needed_since_ns = view.now_ns - round(1e9 * AGREED_S)
    is_still = signs.still_since_ns < needed_since_ns
    is_reported = signs.reported_since_ns < needed_since_ns

    _, _, z_m = view.position_enu_m
    height_m = z_m - ground_z_m
    is_low = UNDER_GROUND_M < height_m < _STANDS_BELOW_M and view.lift_share < _HOVERS_SHARE
    if is_low and (is_still or is_reported):
        return True
    if _is_light_at_rest(signs, view):
        return True

    has_stalled = view.now_ns - signs.still_since_ns > 1e9 * _STALLED_S
    return is_late and UNDER_GROUND_M < height_m < _STALLED_M and has_stalled


def has_ground_contact_by_thrust(signs: ContactSigns, view: FlightView) -> bool:
    """Return whether a vehicle stands on the ground, by its motion and thrust, not its height.

    Args:
        signs: signs of contact at this tick.
        view: what the flight sees at this tick.
    """
    if _is_light_at_rest(signs, view):
        return True

    needed_since_ns = view.now_ns - round(1e9 * signs.time_factor * _LIGHT_LONG_S)
    is_light = signs.light_since_ns < needed_since_ns
    is_slow = signs.slow_since_ns < needed_since_ns
    return is_light and is_slow


def _is_light_at_rest(signs: ContactSigns, view: FlightView) -> bool:
    """Return whether a vehicle has little lift and does not sink, or PX4 reports the ground.

    PX4 reports the ground after a while with little thrust. A report from before, for instance the
    last one before the lift-off, does not count.
    """
    agreed_ns = round(1e9 * AGREED_S)
    needed_since_ns = view.now_ns - round(signs.time_factor * agreed_ns)
    is_light = signs.light_since_ns < needed_since_ns
    is_still = signs.still_since_ns < needed_since_ns
    is_reported = signs.light_since_ns <= signs.reported_since_ns < view.now_ns - agreed_ns
    return is_light and (is_still or is_reported)


def is_stuck(signs: ContactSigns, view: FlightView, goal_z_m: float) -> bool:
    """Return whether a vehicle pushes upwards to its goal for a while, and does not move.

    Args:
        signs: signs of contact at this tick.
        view: what the flight sees at this tick.
        goal_z_m: height of its goal [m].
    """
    needed_since_ns = view.now_ns - round(1e9 * _STUCK_S)
    _, _, z_m = view.position_enu_m
    is_below = z_m < goal_z_m - _STUCK_BELOW_M
    is_still = signs.still_since_ns < needed_since_ns
    is_pushing = signs.pushing_since_ns < needed_since_ns
    return is_below and is_still and is_pushing


def has_ground_contact_without_poses(
    signs: ContactSigns, view: FlightView, ground_z_m: float, lowest_ground_m: float
) -> bool:
    """Return whether a vehicle that descends without poses stands, by PX4's speed and height.

    Args:
        signs: signs of contact at this tick.
        view: what the flight sees at this tick.
        ground_z_m: height of the expected ground [m].
        lowest_ground_m: height of the lowest ground that it may land on [m].
    """
    _, _, z_m = view.position_enu_m
    if z_m - lowest_ground_m < _WITHOUT_POSES_UNDER_GROUND_M:
        return True
    return _has_stood_low(signs, view, z_m - ground_z_m, _WITHOUT_POSES_STANDS_S)


def may_have_ground_contact_without_poses(
    signs: ContactSigns, view: FlightView, ground_z_m: float
) -> bool:
    """Return whether a vehicle that descends without poses may have met the ground.

    This is known earlier than :func:`has_ground_contact_without_poses`, and does not end the
    flight. It ends dead reckoning, because that model has no contact forces.

    Args:
        signs: signs of contact at this tick.
        view: what the flight sees at this tick.
        ground_z_m: height of the expected ground [m].
    """
    _, _, z_m = view.position_enu_m
    height_m = z_m - ground_z_m
    return _has_stood_low(signs, view, height_m, _WITHOUT_POSES_TOUCHES_S)


def _has_stood_low(signs: ContactSigns, view: FlightView, height_m: float, for_s: float) -> bool:
    """Return whether a vehicle without poses has stopped sinking, where the ground may be.

    If poses come and go, PX4's vertical speed jumps by some decimetres per second. While they are
    there, the height is known.
    """
    low_m = _WITHOUT_POSES_LOW_M if view.is_dead_reckoned else LOW_M
    stands_s = (view.now_ns - signs.still_since_ns) * 1e-9
    return height_m < low_m and stands_s > for_s
