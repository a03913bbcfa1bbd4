"""Findings about single vehicles: thrust, tilt, attitude response, wind, battery, and PX4's own
failsafes. Pure.
"""

from __future__ import annotations

import math

from onboard.avoidance.constraints import FLEEING_FACTOR
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.wind_limit import (
    GUST_SHARE,
    GUSTY,
    largest_push_m_s2,
    tilt_acceleration_m_s2,
    wind_limit_m_s,
)
from onboard.constants import GRAVITY_M_S2, MAX_PLANNED_THRUST_FRAC
from onboard.control.backstepping import BacksteppingParams
from onboard.feasibility import bounds
from onboard.feasibility.bounds import Response
from onboard.feasibility.finding import Finding, at_least, at_most, rounded_down
from onboard.feasibility.lift_off import blown_aside_m
from onboard.plain_text import listed
from onboard.px4.required_params import silence_s, weakened
from onboard.safety.gust_margin import gust_margin_m

# largest gusts for which the disturbance observer was measured
GUST_M_S2 = 0.3

# In simulation, a person that walks so fast reaches vehicles that may flee more slowly.
_BRISK_WALK_M_S = 1.5

# least vertical part of the full thrust at the largest tilt, in units of the weight: 5 % in reserve
_MIN_LIFT = 1.05

# least upward acceleration, for climbing and gusts
_CLIMB_M_S2 = 1.0

# Growth rate of an oscillation of a vehicle alone, with its worst error of the lag. In 12 simulated
# flights with each response, all of 24 vehicles arrived at -0.2 and 0.15 1/s, and 2 of 12 in time
# at 0.2. None of 36 arrived in time at 0.3, 0.54 and 0.6: PX4 landed 23 of these, because their
# attitude did not follow. At 0.4, with a slow and well damped attitude, all of 12 arrived and
# wandered by 0.14 m.
_SLOW_GROWTH_1_S = 0.0  # a faster growth is a warning
_FAST_GROWTH_1_S = 0.25  # a faster growth is refused

# Dead time of the attitude of a vehicle alone. In simulation 12 of 12 arrived with 0.30 s, 9 with
# 0.35 s and 6 with 0.40 s; PX4 landed most of the others, because their attitude did not follow.
_LONG_DEAD_TIME_S = 0.25  # a longer dead time is a warning
_LONGEST_DEAD_TIME_S = 0.30  # a longer dead time is refused

# a wind limit that was computed from the largest push may exceed it by rounding
_ROUNDING_M_S2 = 1e-6

# default of BAT_CRIT_THR; at this level PX4 leaves OFFBOARD, even if setpoints arrive
_PX4_CRITICAL_FRAC = 0.07

# name of the finding about px4_params that weaken PX4's own failsafes
OWN_FAILSAFES = "PX4's own failsafes"

# gap from PX4's critical battery level up to the level at which the agent lands
_BATTERY_GAP_PCT = 3.0  # a smaller gap is a warning
_MIN_BATTERY_GAP_PCT = 0.5  # a smaller gap is refused
_ADVISED_BATTERY_PCT = 5.0  # further gap in the remedy

_MIN_ACCELERATION_M_S2 = 0.05  # avoids a division by zero for a vehicle that cannot tilt


def available_m_s2(vehicle: Vehicle) -> float:
    """Return the horizontal acceleration [m/s^2] that is available while the height is kept.

    It is at least 0.05 m/s^2.

    Args:
        vehicle: the vehicle.
    """
    available = bounds.available_acceleration_m_s2(vehicle.max_tilt_deg, vehicle.hover_thrust_frac)
    return max(_MIN_ACCELERATION_M_S2, available)


def response_of(vehicle: Vehicle) -> Response:
    """Return the configured response of a vehicle, from a command to the acceleration.

    Args:
        vehicle: the vehicle.
    """
    return Response(
        delay_s=vehicle.attitude_delay_s,
        wn_rad_s=vehicle.attitude_wn_rad_s,
        zeta=vehicle.attitude_zeta,
    )


def largest_growth_1_s(
    vehicle: Vehicle, rate_1_1_s: float, rate_2_1_s: float, *, is_predicted: bool
) -> float:
    """Return the growth rate [1/s] of an oscillation with the worst error of the configured lag.

    Args:
        vehicle: the vehicle.
        rate_1_1_s: one of the two rates at which the loop's errors decay without a lag [1/s].
        rate_2_1_s: the other one [1/s].
        is_predicted: whether the state is predicted over the lag.
    """
    return max(
        bounds.loop_growth_1_s(
            response_of(vehicle),
            rate_1_1_s,
            rate_2_1_s,
            lag_error_s=lag_error_s,
            is_predicted=is_predicted,
        )
        for lag_error_s in (-LAG_ERROR_S, 0.0, LAG_ERROR_S)
    )


def attitude_response(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check that an oscillation of the vehicle about its setpoint decays, by the baseline alone.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    gains = BacksteppingParams()
    k1 = gains.position_gain_1_s
    k2 = gains.velocity_gain_1_s

    # the rates of the baseline's linear loop, s^2 + (k1 + k2) s + (k1 k2 + c)
    mean_1_s = 0.5 * (k1 + k2)
    apart_1_s = math.sqrt(mean_1_s * mean_1_s - (k1 * k2 + gains.coupling_1_s2))

    return at_most(
        name="attitude response",
        value=largest_growth_1_s(
            vehicle,
            mean_1_s - apart_1_s,
            mean_1_s + apart_1_s,
            is_predicted=fleet.law.prediction == "lag",
        ),
        bound=_SLOW_GROWTH_1_S,
        unit="1/s",
        sentence=(
            f"With attitude_wn_rad_s = {vehicle.attitude_wn_rad_s:g}, attitude_zeta = "
            f"{vehicle.attitude_zeta:g} and attitude_delay_s = {vehicle.attitude_delay_s:g} an "
            f"oscillation of {vehicle.name} about its setpoint (lag known to "
            f"{1e3 * LAG_ERROR_S:.0f} ms) grows with <value>, also alone; it dies out with "
            "<relation> <bound>"
        ),
        remedy=(
            "Tune its attitude control to be faster and well damped, and let covey identify "
            "measure it."
        ),
        refuse_above=_FAST_GROWTH_1_S,
    )


def dead_time(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check the dead time after which the attitude begins to follow.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    return at_most(
        name="dead time",
        value=vehicle.attitude_delay_s,
        bound=_LONG_DEAD_TIME_S,
        unit="s",
        sentence=(
            f"{vehicle.name} begins to follow a command <value> later (attitude_delay_s); also "
            f"alone it should be <relation> <bound>, and beyond {_LONGEST_DEAD_TIME_S:.2f} s "
            "PX4 has landed vehicles in simulation, because their attitude did not follow"
        ),
        remedy="Find what delays its setpoints, and let covey identify measure it.",
        refuse_above=_LONGEST_DEAD_TIME_S,
    )


def height_at_tilt(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check that the height is kept at the largest tilt.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    # vertical part of the full thrust, in units of the weight
    lift = (
        MAX_PLANNED_THRUST_FRAC
        / vehicle.hover_thrust_frac
        * math.cos(math.radians(vehicle.max_tilt_deg))
    )
    cos_allowed_tilt = _MIN_LIFT * vehicle.hover_thrust_frac / MAX_PLANNED_THRUST_FRAC
    allowed_deg = math.degrees(math.acos(min(1.0, cos_allowed_tilt)))

    return at_least(
        name="height at full tilt",
        value=lift,
        bound=_MIN_LIFT,
        unit="",
        sentence=(
            f"{vehicle.name} at its max_tilt_deg = {vehicle.max_tilt_deg:g} and full throttle "
            "lifts <value> of its weight; to keep the height it must be <relation> <bound>"
        ),
        remedy=(
            f"Set max_tilt_deg = {rounded_down(allowed_deg, 0):.0f} or less, or make the vehicle "
            "lighter."
        ),
        refuse_below=1.0,
    )


def thrust_reserve(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check the upward acceleration that full throttle leaves.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    upwards_m_s2 = (MAX_PLANNED_THRUST_FRAC / vehicle.hover_thrust_frac - 1.0) * GRAVITY_M_S2

    return at_least(
        name="thrust reserve",
        value=upwards_m_s2,
        bound=_CLIMB_M_S2,
        unit="m/s^2",
        sentence=(
            f"{vehicle.name} hovers at {vehicle.hover_thrust_frac:.2f} of its throttle, which "
            "leaves <value> upwards; to climb and to resist gusts it needs <relation> <bound>"
        ),
        remedy="Make the vehicle lighter, or use stronger motors and a fresh battery.",
    )


def gust_reserve(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check the horizontal acceleration that trajectories and drag leave for gusts.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    drag_m_s2 = vehicle.drag_1_s * vehicle.max_speed_m_s

    return at_least(
        name="gust reserve",
        value=available_m_s2(vehicle) - vehicle.max_acceleration_m_s2 - drag_m_s2,
        bound=GUST_M_S2,
        unit="m/s^2",
        sentence=(
            f"{vehicle.name}: tilt and thrust leave <value> beside trajectories of "
            f"{vehicle.max_acceleration_m_s2:g} m/s^2 and drag at full speed; gusts need "
            "<relation> <bound>"
        ),
        remedy="Lower max_acceleration_m_s2 or max_speed_m_s, or raise max_tilt_deg.",
    )


def wind(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check the push of the strongest wind that the fleet file allows, with its gusts.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding. Without drag_1_s, it says that the vehicle cannot estimate the wind.
    """
    limit_m_s = wind_limit_m_s(fleet, vehicle)
    if math.isnan(limit_m_s):
        return at_most(
            name="wind",
            value=0.0,
            bound=largest_push_m_s2(vehicle),
            unit="m/s^2",
            sentence=(
                f"{vehicle.name} has no drag_1_s, so it does not know the wind; it leans against "
                "pushes of up to <bound>"
            ),
            remedy="Let covey identify measure drag_1_s.",
        )

    gust_m_s2 = GUST_SHARE * vehicle.drag_1_s * limit_m_s
    wider_m = gust_margin_m(gust_m_s2, vehicle, fleet.law)
    advised_m_s = 0.95 * largest_push_m_s2(vehicle) / (GUSTY * vehicle.drag_1_s)
    spots = ""
    if vehicle.drag_1_s * limit_m_s < tilt_acceleration_m_s2(vehicle):
        aside_m = blown_aside_m(vehicle, limit_m_s)
        apart_m = fleet.fleet.safety_distance_m + aside_m
        spots = (
            f". At a lift-off in it a vehicle is blown aside by about {aside_m:.1f} m: "
            f"put them down {apart_m:.1f} m apart along the wind, or across it"
        )
    return at_most(
        name="wind",
        value=GUSTY * vehicle.drag_1_s * limit_m_s,
        bound=largest_push_m_s2(vehicle) + _ROUNDING_M_S2,
        unit="m/s^2",
        sentence=(
            f"{vehicle.name} may fly in a wind of {limit_m_s:.1f} m/s (max_wind_m_s), which pushes "
            "with <value> in gusts; against wind it leans with <relation> <bound>, and in these "
            f"gusts the others keep {wider_m:.2f} m beyond fleet.safety_distance_m{spots}"
        ),
        remedy=(
            f"Set max_wind_m_s = {rounded_down(advised_m_s, 1):.1f} or less, or raise max_tilt_deg."
        ),
        refuse_above=tilt_acceleration_m_s2(vehicle),
    )


def beside_people(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check that a vehicle can flee from a person as fast as people walk.

    Args:
        fleet: the fleet file, with at least one person.
        vehicle: one of its vehicles.
    """
    people = listed(tuple(fleet.people), most=3)
    return at_least(
        name="people",
        value=FLEEING_FACTOR * vehicle.max_speed_m_s,
        bound=_BRISK_WALK_M_S,
        unit="m/s",
        sentence=(
            f"{vehicle.name} may flee from {people} with <value>, twice its max_speed_m_s; "
            "people walk with up to <bound>, and reach a vehicle that flees more slowly"
        ),
        remedy=f"Set max_speed_m_s = {_BRISK_WALK_M_S / FLEEING_FACTOR:.2f} or more.",
        refuse_below=-math.inf,  # it flies, where people walk slowly
    )


def battery(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check the landing level against the level at which PX4 lands by itself.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    critical_frac = float(vehicle.px4_params.get("BAT_CRIT_THR", _PX4_CRITICAL_FRAC))
    critical_pct = 100.0 * critical_frac
    advised_pct = critical_pct + _BATTERY_GAP_PCT + _ADVISED_BATTERY_PCT

    return at_least(
        name="battery",
        value=fleet.fleet.battery_land_pct,
        bound=critical_pct + _BATTERY_GAP_PCT,
        unit="%",
        sentence=(
            f"fleet.battery_land_pct is <value>; PX4 lands {vehicle.name} by itself at "
            f"{critical_pct:.0f} %, so the landing under the law must begin at <bound> or above"
        ),
        remedy=f"Set fleet.battery_land_pct = {advised_pct:.0f} or more, or lower BAT_CRIT_THR.",
        refuse_below=critical_pct + _MIN_BATTERY_GAP_PCT,
    )


def silence(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check how long PX4 continues to fly without setpoints.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    return at_most(
        name="silence",
        value=silence_s(vehicle),
        bound=0.5,
        unit="s",
        sentence=(
            f"Without setpoints PX4 keeps {vehicle.name}'s last tilt for <value> "
            "(COM_OF_LOSS_T) before it lands; so that the vehicle does not drift into the others "
            "this must be <relation> <bound>"
        ),
        remedy="Set px4_params.COM_OF_LOSS_T = 0.3.",
        refuse_above=1.0,
    )


def own_failsafes(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check that the fleet file does not weaken PX4's own failsafes.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    Returns:
        the finding.
    """
    sentences = weakened(fleet, vehicle)
    sentence = f"{vehicle.name}'s px4_params weaken no demand about PX4's own failsafes"
    if sentences:
        sentence = " ".join(sentences).removesuffix(".")

    return at_most(
        name=OWN_FAILSAFES,
        value=float(len(sentences)),
        bound=0.0,
        unit="",
        sentence=sentence,
        remedy="Remove them from px4_params: docs/px4.md says what PX4 does on its own.",
    )
