"""What the agent publishes, built from one tick. No decisions here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from onboard.bus.schema import StateMessage, TickSample, Vec3, Vec4
from onboard.types import Array, LawStatus, Tick


def vec3(array: Array) -> Vec3:
    """Three floats."""
    return cast(Vec3, tuple(array.tolist()))


def vec4(array: Array) -> Vec4:
    """Four floats."""
    return cast(Vec4, tuple(array.tolist()))


def law_status(tick: Tick) -> str:
    """The law's status in a word."""
    return LawStatus(int(tick.law.status)).name.lower()


def state_message(
    tick: Tick,
    *,
    vehicle: str,
    boot_id: int,
    sequence: int,
    stamp_ns: int,
    is_valid: bool,
    is_airborne: bool,
    is_cooperative: bool,
) -> StateMessage:
    """What the neighbours need, 50 Hz."""
    state, law = tick.state, tick.law
    return StateMessage(
        vehicle=vehicle,
        boot_id=boot_id,
        sequence=sequence,
        stamp_ns=stamp_ns,
        is_valid=is_valid,
        is_airborne=is_airborne,
        is_cooperative=is_cooperative,
        position_enu_m=vec3(state.position_enu_m),
        velocity_enu_m_s=vec3(state.velocity_enu_m_s),
        acceleration_enu_m_s2=vec3(state.acceleration_enu_m_s2),
        predicted_position_enu_m=vec3(law.predicted_position_enu_m),
        predicted_velocity_enu_m_s=vec3(law.predicted_velocity_enu_m_s),
        commanded_acceleration_enu_m_s2=vec3(law.commanded_acceleration_enu_m_s2),
        lead_time_s=float(law.lead_time_s),
        position_std_m=float(state.position_std_m),
        velocity_std_m_s=float(state.velocity_std_m_s),
        crowd_count=float(law.crowd_count),
    )


def tick_sample(
    tick: Tick,
    *,
    stamp_ns: int,
    period_s: float,
    state: str,
    active_neighbour: str,
    distances_m: Mapping[str, float],
    ages_s: Mapping[str, float],
    attitude_enu_flu: Array,
) -> TickSample:
    """Every intermediate value of one pass, for the record."""
    law = tick.law
    return TickSample(
        stamp_ns=stamp_ns,
        period_s=period_s,
        state=state,
        position_enu_m=vec3(tick.state.position_enu_m),
        velocity_enu_m_s=vec3(tick.state.velocity_enu_m_s),
        acceleration_enu_m_s2=vec3(tick.state.acceleration_enu_m_s2),
        yaw_rad=float(tick.state.yaw_rad),
        setpoint_position_enu_m=vec3(tick.setpoint.position_enu_m),
        setpoint_velocity_enu_m_s=vec3(tick.setpoint.velocity_enu_m_s),
        setpoint_acceleration_enu_m_s2=vec3(tick.setpoint.acceleration_enu_m_s2),
        thrust_baseline_enu_m_s2=vec3(tick.thrust_baseline.thrust_enu_m_s2),
        thrust_safe_enu_m_s2=vec3(law.thrust.thrust_enu_m_s2),
        predicted_position_enu_m=vec3(law.predicted_position_enu_m),
        predicted_velocity_enu_m_s=vec3(law.predicted_velocity_enu_m_s),
        commanded_acceleration_enu_m_s2=vec3(law.commanded_acceleration_enu_m_s2),
        law_status=law_status(tick),
        intervention_m_s2=float(law.intervention_m_s2),
        slack_m_s2=float(law.slack_m_s2),
        active_neighbour=active_neighbour,
        neighbour_distances_m=dict(distances_m),
        neighbour_ages_s=dict(ages_s),
        setpoint_quaternion_enu_flu_wxyz=vec4(tick.attitude.quaternion_wxyz),
        setpoint_thrust_frac=float(tick.attitude.thrust_frac),
        attitude_quaternion_enu_flu_wxyz=vec4(np.asarray(attitude_enu_flu)),
        hover_thrust_frac=float(tick.hover_thrust_frac),
    )
