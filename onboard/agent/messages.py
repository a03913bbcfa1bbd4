"""What the agent publishes, built from one tick. No decisions here."""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec.structs import replace

from onboard.bus.authority import Roles
from onboard.bus.schema import StateMessage, Telemetry, TickSample, Vec3, Vec4
from onboard.config.fleet import Vehicle
from onboard.events import LoopTimed
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from onboard.localization.px4_position_check import STD_M, STD_M_S
from onboard.types import LawStatus, Tick


def law_status(tick: Tick) -> str:
    """The law's status in a word."""
    return LawStatus(tick.law.status).name.lower()


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
        position_enu_m=state.position_enu_m,
        velocity_enu_m_s=state.velocity_enu_m_s,
        acceleration_enu_m_s2=state.acceleration_enu_m_s2,
        predicted_position_enu_m=law.predicted_position_enu_m,
        predicted_velocity_enu_m_s=law.predicted_velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=law.commanded_acceleration_enu_m_s2,
        lead_time_s=law.lead_time_s,
        position_std_m=state.position_std_m,
        velocity_std_m_s=state.velocity_std_m_s,
        crowd_count=law.crowd_count,
        intent_enu_m_s=law.intent_enu_m_s,
    )


def by_px4(told: StateMessage, position_enu_m: Vec3, velocity_enu_m_s: Vec3) -> StateMessage:
    """The same from a vehicle that has no pose and whose PX4 lands it: where PX4 believes it to be, and no promise."""
    still = 0.0, 0.0, 0.0
    return replace(
        told,
        is_valid=True,
        is_cooperative=False,
        position_enu_m=position_enu_m,
        velocity_enu_m_s=velocity_enu_m_s,
        acceleration_enu_m_s2=still,
        predicted_position_enu_m=position_enu_m,
        predicted_velocity_enu_m_s=velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=still,
        lead_time_s=0.0,
        position_std_m=STD_M,
        velocity_std_m_s=STD_M_S,
        crowd_count=0.0,
        intent_enu_m_s=velocity_enu_m_s,
    )


def tick_sample(
    tick: Tick,
    told: StateMessage,
    *,
    period_s: float,
    doing: str,
    active_neighbour: str,
    distances_m: dict[str, float],
    ages_s: dict[str, float],
    attitude_enu_flu_wxyz: Vec4,
    attitude_age_s: float,
) -> TickSample:
    """Every intermediate value of one pass, for the record; ``told`` is what the neighbours were told of it."""
    law = tick.law
    return TickSample(
        stamp_ns=told.stamp_ns,
        period_s=period_s,
        state=doing,
        position_enu_m=told.position_enu_m,
        velocity_enu_m_s=told.velocity_enu_m_s,
        acceleration_enu_m_s2=told.acceleration_enu_m_s2,
        yaw_rad=tick.state.yaw_rad,
        setpoint_position_enu_m=tick.setpoint.position_enu_m,
        setpoint_velocity_enu_m_s=tick.setpoint.velocity_enu_m_s,
        setpoint_acceleration_enu_m_s2=tick.setpoint.acceleration_enu_m_s2,
        thrust_baseline_enu_m_s2=tick.thrust_baseline.thrust_enu_m_s2,
        thrust_safe_enu_m_s2=law.thrust.thrust_enu_m_s2,
        predicted_position_enu_m=told.predicted_position_enu_m,
        predicted_velocity_enu_m_s=told.predicted_velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=told.commanded_acceleration_enu_m_s2,
        law_status=law_status(tick),
        intervention_m_s2=law.intervention_m_s2,
        slack_m_s2=law.slack_m_s2,
        active_neighbour=active_neighbour,
        neighbour_distances_m=distances_m,
        neighbour_ages_s=ages_s,
        setpoint_quaternion_enu_flu_wxyz=tick.attitude.quaternion_wxyz,
        setpoint_thrust_frac=tick.attitude.thrust_frac,
        attitude_quaternion_enu_flu_wxyz=attitude_enu_flu_wxyz,
        hover_thrust_frac=tick.hover_thrust_frac,
        attitude_age_s=attitude_age_s,
    )


def telemetry(
    tick: Tick,
    now_ns: int,
    *,
    vehicle: Vehicle,
    boot_id: int,
    sequence: int,
    flight: FlightContext,
    view: FlightView,
    not_ready: tuple[str, ...],
    is_airborne: bool,
    distances_m: Mapping[str, float],
    law: str,
    state_age_s: float,
    mocap_delay_s: float,
    neighbour_age_s: float,
    loop: LoopTimed,
    malformed: int,
    config_hash: str,
    conditions: tuple[str, ...],
    roles: Roles,
    doubles: tuple[str, ...],
    avoids: str,
    action: str,
) -> Telemetry:
    """All that a person looks at."""
    snapshot, order = view.snapshot, flight.order
    nearest = min(distances_m, key=distances_m.__getitem__, default="")
    return Telemetry(
        vehicle=vehicle.name,
        boot_id=boot_id,
        sequence=sequence,
        stamp_ns=now_ns,
        state=flight.state,
        reason=flight.reason,
        not_ready=not_ready,
        is_armed=snapshot.is_armed,
        is_airborne=is_airborne,
        mode=snapshot.mode,
        position_enu_m=view.position_enu_m,
        velocity_enu_m_s=view.velocity_enu_m_s,
        yaw_deg=math.degrees(tick.state.yaw_rad),
        is_position_valid=view.has_position,
        setpoint_position_enu_m=tick.setpoint.position_enu_m,
        goal_position_enu_m=flight.goal_position_enu_m if flight.is_under_law else view.position_enu_m,
        battery_frac=snapshot.battery_frac,
        battery_voltage_v=snapshot.battery_voltage_v,
        law=law,
        law_status=law_status(tick),
        intervention_m_s2=tick.law.intervention_m_s2,
        nearest_vehicle=nearest,
        nearest_distance_m=distances_m.get(nearest, math.inf),
        order_id=order.order_id if order is not None else "",
        order_kind=order.kind if order is not None else "",
        order_phase=flight.step.text,
        state_age_s=state_age_s,
        mocap_delay_s=mocap_delay_s,
        autopilot_age_s=(now_ns - snapshot.last_packet_ns) * 1e-9 if snapshot.last_packet_ns else math.inf,
        neighbour_age_s=neighbour_age_s,
        loop_period_p50_ms=loop.p50_ms,
        loop_period_p99_ms=loop.p99_ms,
        loop_period_max_ms=loop.max_ms,
        late_ticks=loop.late_ticks,
        loop_lateness_p99_ms=loop.lateness_p99_ms,
        missed_ticks=loop.missed_ticks,
        malformed_messages=malformed,
        hover_thrust_frac=tick.hover_thrust_frac,
        config_hash=config_hash,
        system_id=vehicle.system_id,
        conditions=conditions,
        action=action,
        operator=roles.operator,
        roles=roles.others,
        avoids=avoids,
        doubles=doubles,
    )
