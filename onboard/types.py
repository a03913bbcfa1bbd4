"""Values that pass between the stages of the control pipeline: plain floats in fleet ENU.

The pipeline computes one control tick of one vehicle: trajectory, baseline thrust, avoidance law,
attitude setpoint. :mod:`onboard.rollout.batch` packs the same values of many flights into arrays.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from onboard.vectors import ZERO_3, Vec3

TICK_S = 0.02  # period of the control loop


class LawStatus(IntEnum):
    """Effect of the avoidance law on the thrust of one tick.

    The law limits the thrust by linear inequalities ("rows"). Hard rows keep distances and the
    speed limit, and soft rows only make vehicles turn around each other.
    """

    INACTIVE = 0  # the baseline thrust already satisfies every row
    SATURATED = 1  # the thrust was changed, and satisfies all hard rows
    RELAXED = 2  # no thrust satisfies all hard rows, so they got the smallest common slack
    # the inputs cannot be used (for instance coincident vehicles), so the thrust is a bounded
    # fallback
    INFEASIBLE = 3


class State(NamedTuple):
    """Estimate of the vehicle's own motion, valid now."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    acceleration_enu_m_s2: Vec3
    yaw_rad: float
    age_s: float  # age of the estimate; 0 if it was propagated to now
    position_std_m: float  # per axis
    velocity_std_m_s: float  # per axis


NO_SEQUENCE = -(1 << 53)  # no goal has this sequence


class Goal(NamedTuple):
    """Input of the trajectory: a position to fly to, or the present point of a followed path."""

    position_enu_m: Vec3
    duration_s: float  # time for the flight to the position; 0: as fast as the limits allow
    sequence: int  # changes with each new goal, so that a new trajectory is planned

    is_on_path: bool = False  # whether the position is the present point of a followed path
    # motion of the path at a clock rate of 1; zero for a position to fly to
    velocity_enu_m_s: Vec3 = ZERO_3
    acceleration_enu_m_s2: Vec3 = ZERO_3

    # heading to turn to, counterclockwise from east; NaN: keep the present heading
    yaw_rad: float = math.nan
    clock_rate_frac: float = 1.0  # rate of the path's clock, as a share of real time


class TrajectorySetpoint(NamedTuple):
    """Motion that the trajectory commands, before any avoidance."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    acceleration_enu_m_s2: Vec3


class Thrust(NamedTuple):
    """Mass-normalised thrust F/m; hover is (0, 0, g)."""

    thrust_enu_m_s2: Vec3


class AttitudeSetpoint(NamedTuple):
    """Setpoint for PX4, in ENU/FLU; the link converts it to PX4's NED/FRD."""

    quaternion_wxyz: tuple[float, float, float, float]  # rotates FLU to ENU
    thrust_frac: float  # in [0, 1]


class Neighbour(NamedTuple):
    """One neighbour as received; NaN: not known. The law extrapolates its motion over its age."""

    position_enu_m: Vec3  # estimate without prediction, which the paper's law uses
    velocity_enu_m_s: Vec3
    acceleration_enu_m_s2: Vec3

    predicted_position_enu_m: Vec3  # predicted over the sender's own lag
    predicted_velocity_enu_m_s: Vec3
    commanded_acceleration_enu_m_s2: Vec3
    intent_enu_m_s: Vec3  # velocity that the neighbour would fly if it were alone

    age_s: float  # now minus the stamp
    lead_time_s: float  # from the stamp to the predicted state; NaN: the same as this vehicle's
    position_std_m: float
    velocity_std_m_s: float

    crowd_count: float  # number of vehicles near the neighbour
    is_cooperative: bool  # False: it does not avoid others, so this vehicle does all the avoiding
    # whether it is the only vehicle that the paper's law avoids: the next one in the fleet's order
    is_paper_obstacle: bool
    table_index: int  # index among all neighbours that this vehicle knows, for the record
    radius_m: float  # radius of a person's circle, to which the distance is kept; 0: a vehicle


class LawOutput(NamedTuple):
    """Result of the avoidance law: a thrust, and values that are published and recorded."""

    thrust: Thrust
    predicted_position_enu_m: Vec3  # our own position, predicted over our lag; published
    predicted_velocity_enu_m_s: Vec3  # published
    commanded_acceleration_enu_m_s2: Vec3  # published

    status: int  # a LawStatus
    intervention_m_s2: float  # |u - u_0|: how much the baseline thrust was changed
    slack_m_s2: float  # slack of the hard rows; 0 unless RELAXED
    crowd_count: float  # number of vehicles near this one; published
    # index of the neighbour whose row limits the thrust most; -1: none; -2: an obstacle or a fence
    active_neighbour: int

    lead_time_s: float  # from now to the predicted state; published
    intent_enu_m_s: Vec3  # velocity that this vehicle would fly if it were alone; published


class Tick(NamedTuple):
    """All results of the pipeline in one control tick."""

    state: State
    setpoint: TrajectorySetpoint
    thrust_baseline: Thrust
    law: LawOutput
    attitude: AttitudeSetpoint
    hover_thrust_frac: float
    is_finite: bool  # False: the input could not be used, and the attitude setpoint is level
