"""Parameters of the pipeline's stages for one vehicle, computed from the fleet file."""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.params import COVEY, LawParams, law_params
from onboard.config.fleet import FleetConfig
from onboard.config.ground import lowest_ground_in_fence_m
from onboard.config.wind_limit import largest_push_m_s2
from onboard.constants import GRAVITY_M_S2
from onboard.control import (
    allocation,
    backstepping,
    passing,
    sinking,
    trajectory,
    vertical_limits,
)
from onboard.control.path import MAX_TURN_RAD_S
from onboard.estimation import disturbance_observer, hover_thrust

# share of the horizontal acceleration that may compensate drag and wind; the rest stays for the law
_COMPENSATION_SHARE = 0.75
_LIFT_COMPENSATION_SHARE = 0.5  # the same for the vertical acceleration

_PURSUIT_FACTOR = 1.25  # largest speed of a return to the setpoint, relative to the top speed


class PipelineParams(NamedTuple):
    """Parameters of every stage for one vehicle, and the pipeline's own limits."""

    trajectory: trajectory.TrajectoryParams
    backstepping: backstepping.BacksteppingParams
    sinking: sinking.SinkingParams
    law: LawParams
    observer: disturbance_observer.ObserverParams
    hover_thrust: hover_thrust.HoverThrustParams
    allocation: allocation.AllocationParams
    drag_1_s: float
    pursuit_speed_m_s: float  # limit of setpoint speed plus the speed for the position error

    # bounds of the acceleration that compensates drag and disturbance
    max_compensation_m_s2: float  # horizontal
    max_lift_compensation_m_s2: float  # vertical

    # While the law is active, the trajectory's clock slows with the lag behind the setpoint.
    clock_slack_m: float = 0.3  # lag at which it starts to slow
    clock_stop_m: float = 1.5  # lag at which it stands still
    activity_time_s: float = 0.5  # the "recent past" in which the law was active
    clock_time_s: float = 0.2  # time constant of the clock's rate

    max_yaw_rate_rad_s: float = MAX_TURN_RAD_S  # at which the heading turns to that of a goal


def pipeline_params(
    fleet: FleetConfig, vehicle_name: str, law: str | None = None
) -> PipelineParams:
    """Return the parameters of one vehicle of a fleet.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
        law: "covey", "paper" or "off", which overrides the fleet file.
    Raises:
        ValueError: There is no law of that name.
    """
    vehicle = fleet.vehicles[vehicle_name]
    law_numbers = law_params(fleet, vehicle_name, law)

    # a fleet file may say 1 for 1.0, but compiled code accepts only floats here
    hover_frac = float(vehicle.hover_thrust_frac)
    drag_1_s = float(vehicle.drag_1_s)

    max_tilt_rad = math.radians(vehicle.max_tilt_deg)
    max_acceleration_m_s2 = GRAVITY_M_S2 * math.tan(max_tilt_rad)

    rise_m = 0.0  # without Covey's law the legs are straight
    if law_numbers.law == COVEY:
        rise_m = passing.rise_m(fleet, vehicle_name)

    return PipelineParams(
        trajectory=trajectory.TrajectoryParams(
            max_speed_m_s=law_numbers.max_speed_m_s,
            max_acceleration_m_s2=float(vehicle.max_acceleration_m_s2),
            max_vertical_m_s2=vertical_limits.planned_m_s2(hover_frac),
            lead_s=law_numbers.lead_time_s,
            rise_m=rise_m,
            highest_m=passing.highest_m(fleet),
        ),
        backstepping=backstepping.BacksteppingParams(
            max_acceleration_m_s2=max_acceleration_m_s2,
            max_vertical_acceleration_m_s2=vertical_limits.baseline_m_s2(hover_frac),
        ),
        sinking=sinking.sinking_params(
            float(vehicle.max_acceleration_m_s2), hover_frac, has_mocap=vehicle.mocap_required
        ),
        law=law_numbers,
        observer=disturbance_observer.ObserverParams(
            delay_s=float(vehicle.attitude_delay_s),
            wn_rad_s=float(vehicle.attitude_wn_rad_s),
            zeta=float(vehicle.attitude_zeta),
            drag_1_s=drag_1_s,
            max_disturbance_m_s2=largest_push_m_s2(vehicle),
        ),
        hover_thrust=hover_thrust.HoverThrustParams(
            configured_frac=hover_frac,
            min_height_m=float(lowest_ground_in_fence_m(fleet)) + hover_thrust.MIN_HEIGHT_M,
        ),
        allocation=allocation.AllocationParams(
            max_tilt_rad=max_tilt_rad,
            fallback_hover_thrust_frac=hover_frac,
        ),
        drag_1_s=drag_1_s,
        pursuit_speed_m_s=_PURSUIT_FACTOR * law_numbers.max_speed_m_s,
        max_compensation_m_s2=_COMPENSATION_SHARE * max_acceleration_m_s2,
        max_lift_compensation_m_s2=_LIFT_COMPENSATION_SHARE
        * (law_numbers.max_thrust_m_s2 - GRAVITY_M_S2),
    )
