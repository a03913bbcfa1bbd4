"""Converts the pipeline's values to those of the law, and the law's answer back.

Every number that enters the law is made finite here, so the law itself needs no such checks.

The law calculates for the time t + L, at which a command given now takes effect. It limits the
thrust by half-planes, its rows: one for each neighbour, obstacle and wall. README.md beside this
file lists the lines of the algorithm (P1 to O) and the deviations from the paper (D1 to D18).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.half_planes import into_disc
from onboard.avoidance.heights import INTENT_S, Climb
from onboard.avoidance.pairs import Own, margin_2
from onboard.avoidance.params import LawParams
from onboard.avoidance.prediction import LARGEST, Motion, known_std
from onboard.avoidance.projection import INACTIVE
from onboard.constants import GRAVITY_M_S2
from onboard.types import LawOutput, LawStatus, State, Thrust
from onboard.vectors import (
    ZERO_XY,
    Vec2,
    Vec3,
    horizontal,
    horizontal_within,
    is_within,
    length_xy,
    within,
)

# values used instead of the index of a neighbour
NOBODY = -1  # no row changes the thrust
NOT_A_VEHICLE = -2  # an obstacle, or the fence

INFEASIBLE = int(LawStatus.INFEASIBLE)
_LEVEL = Vec3(0.0, 0.0, GRAVITY_M_S2)
_UNKNOWN = Vec3(math.nan, math.nan, math.nan)


class Baseline(NamedTuple):
    """Input of the law: thrust and velocity that the vehicle would have if it were alone."""

    thrust: Thrust
    # added to the safe thrust afterwards to cancel drag and disturbance (line O)
    compensation_enu_m_s2: Vec3
    intent_enu_m_s: Vec3  # velocity straight to the goal


class Answer(NamedTuple):
    """Result for the horizontal thrust."""

    thrust_m_s2: Vec2  # safe thrust, the compensation included
    status: int  # a LawStatus
    slack_m_s2: float  # amount by which all rows had to be relaxed; 0 if some thrust satisfies them
    crowd_count: float  # number of neighbours near this vehicle, which decides how it turns
    active: int  # index of the neighbour that binds most, NOBODY or NOT_A_VEHICLE


def own_at(baseline: Baseline, predicted: Motion, state: State, params: LawParams) -> Own:
    """Return this vehicle at t + L in the form that the rows need, with every number finite.

    Args:
        baseline: thrust, compensation and intent.
        predicted: own motion from :func:`oist.predict`.
        state: own estimate; its height and standard deviations are used.
    """
    f = baseline.thrust.thrust_enu_m_s2
    has_motion = (
        is_within(f, LARGEST)
        and is_within(predicted.position_enu_m, LARGEST)
        and is_within(predicted.velocity_enu_m_s, LARGEST)
    )
    if not has_motion:
        f = _LEVEL

    s = ZERO_XY  # compensation
    has_compensation = is_within(baseline.compensation_enu_m_s2, LARGEST)
    if has_compensation:
        s = horizontal(baseline.compensation_enu_m_s2)

    radius_m_s2 = horizontal_limit(f.z, params)
    climb = Climb(
        height_m=state.position_enu_m.z,
        ahead_m=predicted.position_enu_m.z,
        velocity_m_s=predicted.velocity_enu_m_s.z,
        intended_climb_m=INTENT_S * baseline.intent_enu_m_s.z,
        position_std_m=state.position_std_m,
    )
    return Own(
        position_m=horizontal_within(predicted.position_enu_m, LARGEST),
        velocity_m_s=horizontal_within(predicted.velocity_enu_m_s, LARGEST),
        velocity_std_m_s=known_std(state.velocity_std_m_s),
        intent_m_s=horizontal_within(baseline.intent_enu_m_s, LARGEST),
        margin_2_m2=margin_2(state.position_std_m, state.velocity_std_m_s, params.spacing),
        thrust_m_s2=into_disc(Vec2(f.x + s.x, f.y + s.y), radius_m_s2),
        thrust_z_m_s2=f.z,
        compensation_m_s2=s,
        radius_m_s2=radius_m_s2,
        climb=climb,
        has_motion=has_motion,
        is_usable=has_motion and has_compensation,
    )


def output_of(
    answer: Answer, own: Own, baseline: Baseline, predicted: Motion, params: LawParams
) -> LawOutput:
    """Return the output for an answer; its status is INFEASIBLE if the input could not be used.

    Args:
        answer: answer of the law.
        own: this vehicle at this tick.
        baseline, predicted: input of this tick, not yet made finite.
    """
    # the output excludes the compensation, because line O of the pipeline adds it again
    u = answer.thrust_m_s2
    s = own.compensation_m_s2
    command = Vec3(u.x - s.x, u.y - s.y, own.thrust_z_m_s2 - GRAVITY_M_S2)

    change = Vec2(u.x - own.thrust_m_s2.x, u.y - own.thrust_m_s2.y)
    climb_m_s = within(baseline.intent_enu_m_s.z, LARGEST)
    intent = Vec3(own.intent_m_s.x, own.intent_m_s.y, climb_m_s)

    return LawOutput(
        thrust=Thrust(Vec3(command.x, command.y, own.thrust_z_m_s2)),
        predicted_position_enu_m=predicted.position_enu_m if own.has_motion else _UNKNOWN,
        predicted_velocity_enu_m_s=predicted.velocity_enu_m_s if own.has_motion else _UNKNOWN,
        commanded_acceleration_enu_m_s2=command,
        status=answer.status if own.is_usable else INFEASIBLE,
        intervention_m_s2=length_xy(change),
        slack_m_s2=answer.slack_m_s2,
        crowd_count=answer.crowd_count,
        active_neighbour=answer.active,
        lead_time_s=params.lead_time_s,
        intent_enu_m_s=intent,
    )


def unchanged(
    thrust: Thrust, predicted: Motion, intent_enu_m_s: Vec3, params: LawParams
) -> LawOutput:
    """Return the output of a law that changes nothing, and does not even limit the tilt.

    Args:
        thrust: thrust of the baseline, which is returned unchanged.
        predicted: own motion at t + L, which is published.
        intent_enu_m_s: velocity straight to the goal, which is published.
    """
    f = thrust.thrust_enu_m_s2
    return LawOutput(
        thrust=thrust,
        predicted_position_enu_m=predicted.position_enu_m,
        predicted_velocity_enu_m_s=predicted.velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=Vec3(f.x, f.y, f.z - GRAVITY_M_S2),
        status=INACTIVE,
        intervention_m_s2=0.0,
        slack_m_s2=0.0,
        crowd_count=0.0,
        active_neighbour=NOBODY,
        lead_time_s=params.lead_time_s,
        intent_enu_m_s=intent_enu_m_s,
    )


def horizontal_limit(thrust_z_m_s2: float, params: LawParams) -> float:
    """Return the largest horizontal thrust [m/s^2] at a vertical thrust. DEVIATION D8.

    Args:
        thrust_z_m_s2: vertical thrust.
        params: limits of tilt and thrust.
    """
    vertical = min(max(thrust_z_m_s2, 0.0), params.max_thrust_m_s2)
    by_thrust = math.sqrt(params.max_thrust_m_s2 * params.max_thrust_m_s2 - vertical * vertical)
    return min(vertical * math.tan(params.max_tilt_rad), by_thrust)
