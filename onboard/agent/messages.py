"""Builds the messages of one tick (state, telemetry, record) from its results. Decides nothing."""

from __future__ import annotations

import math
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from onboard.agent.order_intake import OrderIntake
from onboard.agent_inputs import LoopTimed
from onboard.autopilot import FIX_KNOWN_NS, Snapshot
from onboard.bus.control_token import ControlTokens
from onboard.bus.schema import AgentState, StateMessage, Telemetry, TickSample
from onboard.config.fleet import Vehicle
from onboard.control import router
from onboard.corrections.fix import words_of
from onboard.corrections.status import CorrectionsStatus
from onboard.flight import sentences
from onboard.flight.context import FlightContext
from onboard.flight.path_flight import PathFlight
from onboard.flight.types import FlightView
from onboard.localization.own_state import OwnState
from onboard.localization.px4_position_check import Px4Motion
from onboard.message_counts import MessageCounts
from onboard.neighbours.duplicate_agents import DuplicateAgents
from onboard.neighbours.table import NeighbourTable
from onboard.safety.failsafe_table import Situation
from onboard.supervision.failsafe_supervisor import FailsafeSupervisor
from onboard.tuples import Xyz
from onboard.types import LawStatus, Tick

_MAX_CHARACTERS = 60  # longest text taken from an order


class AgentIdentity(Struct, frozen=True):
    """Facts of one run of an agent that never change."""

    vehicle: Vehicle
    boot_id: int
    config_hash: str
    law: str
    max_wind_m_s: float  # NaN: not known


class TelemetrySources(Struct, frozen=True):
    """Parts of an agent that its messages describe."""

    own: OwnState
    neighbours: NeighbourTable
    flight: FlightContext
    failsafes: FailsafeSupervisor
    roles: ControlTokens
    duplicates: DuplicateAgents
    orders: OrderIntake  # holds the counts of refused orders, and the newest accepted order
    corrections_counts: tuple[MessageCounts, ...] = ()  # of corrections that did not reach PX4


class TickResult(Struct, frozen=True):
    """Facts of one tick."""

    tick: Tick
    view: FlightView
    state: AgentState  # state of the flight, for people
    is_cooperative: bool  # whether the others may count on this vehicle to avoid them
    period_s: float  # time since the previous tick
    is_airborne: bool
    may_touch_the_ground: bool  # whether it lifts off or touches down
    ages_s: dict[str, float]  # age of the state of each followed neighbour
    distances_m: dict[str, float]  # separation from each neighbour and person
    not_ready: tuple[str, ...]  # sentences of the preflight check
    corrections: CorrectionsStatus | None = None  # None: the vehicle uses no corrections
    waits_for: int = router.NOBODY  # index of the neighbour to which it has given way


class RunCounters(Struct, frozen=True):
    """Counts and statistics since the agent's start."""

    sequence: int  # number of ticks
    loop: LoopTimed  # newest statistics of the loop
    messages: MessageCounts  # messages that were not used


def state_message(identity: AgentIdentity, result: TickResult, sequence: int) -> StateMessage:
    """Return the state message for the neighbours, as of this tick."""
    state = result.tick.state
    law = result.tick.law

    # Friction and wind briefly accelerate a vehicle on the ground. Other vehicles would expect this
    # acceleration to continue, and would flee from it.
    acceleration_enu_m_s2: Xyz = state.acceleration_enu_m_s2
    if result.may_touch_the_ground:
        acceleration_enu_m_s2 = (0.0, 0.0, 0.0)

    return StateMessage(
        vehicle=identity.vehicle.name,
        boot_id=identity.boot_id,
        sequence=sequence,
        stamp_ns=result.view.now_ns,
        is_valid=result.view.has_position,
        is_airborne=result.is_airborne,
        is_cooperative=result.is_cooperative,
        position_enu_m=state.position_enu_m,
        velocity_enu_m_s=state.velocity_enu_m_s,
        acceleration_enu_m_s2=acceleration_enu_m_s2,
        predicted_position_enu_m=law.predicted_position_enu_m,
        predicted_velocity_enu_m_s=law.predicted_velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=law.commanded_acceleration_enu_m_s2,
        lead_time_s=law.lead_time_s,
        position_std_m=state.position_std_m,
        velocity_std_m_s=state.velocity_std_m_s,
        crowd_count=law.crowd_count,
        intent_enu_m_s=law.intent_enu_m_s,
    )


def px4_state_message(state: StateMessage, motion: Px4Motion) -> StateMessage:
    """Return the state of a vehicle without poses that PX4 lands or has landed.

    Its position and velocity come from PX4, and it does not cooperate.
    """
    still = (0.0, 0.0, 0.0)
    return replace(
        state,
        is_valid=True,
        is_cooperative=False,
        position_enu_m=motion.position_enu_m,
        velocity_enu_m_s=motion.velocity_enu_m_s,
        acceleration_enu_m_s2=still,
        predicted_position_enu_m=motion.position_enu_m,
        predicted_velocity_enu_m_s=motion.velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=still,
        lead_time_s=0.0,
        position_std_m=motion.position_std_m,
        velocity_std_m_s=motion.velocity_std_m_s,
        crowd_count=0.0,
        intent_enu_m_s=motion.velocity_enu_m_s,
    )


def law_status(tick: Tick) -> str:
    """Return the law's status as a word."""
    return LawStatus(tick.law.status).name.lower()


def neighbour_name(index: int, neighbours: NeighbourTable) -> str:
    """Return the name of the vehicle or person with this index; empty if there is none."""
    if not 0 <= index < len(neighbours.avoided_names):
        return ""
    return neighbours.avoided_names[index]


def tick_sample(result: TickResult, state: StateMessage, sources: TelemetrySources) -> TickSample:
    """Return every intermediate value of one tick, for the record.

    Args:
        result: result of the tick.
        state: state message of the tick, as the neighbours receive it.
        sources: parts of the agent.
    """
    tick = result.tick
    law = tick.law
    view = result.view

    attitude_age_s = 0.0
    if view.snapshot.attitude_ns:
        attitude_age_s = (view.now_ns - view.snapshot.attitude_ns) * 1e-9

    return TickSample(
        stamp_ns=state.stamp_ns,
        period_s=result.period_s,
        state=result.state,
        position_enu_m=state.position_enu_m,
        velocity_enu_m_s=state.velocity_enu_m_s,
        acceleration_enu_m_s2=state.acceleration_enu_m_s2,
        yaw_rad=tick.state.yaw_rad,
        setpoint_position_enu_m=tick.setpoint.position_enu_m,
        setpoint_velocity_enu_m_s=tick.setpoint.velocity_enu_m_s,
        setpoint_acceleration_enu_m_s2=tick.setpoint.acceleration_enu_m_s2,
        thrust_baseline_enu_m_s2=tick.thrust_baseline.thrust_enu_m_s2,
        thrust_safe_enu_m_s2=law.thrust.thrust_enu_m_s2,
        predicted_position_enu_m=state.predicted_position_enu_m,
        predicted_velocity_enu_m_s=state.predicted_velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=state.commanded_acceleration_enu_m_s2,
        law_status=law_status(tick),
        intervention_m_s2=float(law.intervention_m_s2),
        slack_m_s2=float(law.slack_m_s2),
        active_neighbour=neighbour_name(law.active_neighbour, sources.neighbours),
        neighbour_distances_m=result.distances_m,
        neighbour_ages_s=result.ages_s,
        setpoint_quaternion_enu_flu_wxyz=tick.attitude.quaternion_wxyz,
        setpoint_thrust_frac=tick.attitude.thrust_frac,
        attitude_quaternion_enu_flu_wxyz=view.attitude_wxyz,
        hover_thrust_frac=tick.hover_thrust_frac,
        attitude_age_s=attitude_age_s,
    )


def telemetry(
    identity: AgentIdentity, result: TickResult, sources: TelemetrySources, counters: RunCounters
) -> Telemetry:
    """Return the telemetry of a tick: everything that people see of a vehicle."""
    tick = result.tick
    view = result.view
    now_ns = view.now_ns
    snapshot = view.snapshot
    flight = sources.flight

    autopilot_age_s = math.inf
    if snapshot.last_packet_ns:
        autopilot_age_s = (now_ns - snapshot.last_packet_ns) * 1e-9

    goal_enu_m = view.position_enu_m
    if flight.step.is_under_law:
        goal_enu_m = flight.goal_position_enu_m

    not_ready: tuple[str, ...] = ()
    if flight.step.situation is Situation.GROUND:
        not_ready = _not_ready(result.not_ready, flight)

    order_id = ""
    order_kind = ""
    if flight.order is not None:
        order_id = flight.order.order_id
        order_kind = flight.order.kind

    nearest = min(result.distances_m, key=result.distances_m.__getitem__, default="")
    conditions, action = sources.failsafes.in_words()
    battery_frac, battery_voltage_v = snapshot.battery(now_ns)
    loop = counters.loop

    avoided = tick.law.active_neighbour
    if result.waits_for != router.NOBODY:
        avoided = result.waits_for

    return Telemetry(
        vehicle=identity.vehicle.name,
        boot_id=identity.boot_id,
        sequence=counters.sequence,
        stamp_ns=now_ns,
        state=result.state,
        reason=flight.reason,
        not_ready=not_ready,
        is_armed=snapshot.is_armed,
        is_airborne=result.is_airborne,
        mode=snapshot.mode,
        position_enu_m=view.position_enu_m,
        velocity_enu_m_s=view.velocity_enu_m_s,
        yaw_deg=math.degrees(tick.state.yaw_rad),
        is_position_valid=view.has_position,
        setpoint_position_enu_m=tick.setpoint.position_enu_m,
        goal_position_enu_m=goal_enu_m,
        battery_frac=battery_frac,
        battery_voltage_v=battery_voltage_v,
        law=identity.law,
        law_status=law_status(tick),
        intervention_m_s2=float(tick.law.intervention_m_s2),
        nearest_vehicle=nearest,
        nearest_distance_m=result.distances_m.get(nearest, math.inf),
        order_id=order_id,
        order_kind=order_kind,
        order_phase=flight.step.text,
        state_age_s=view.position_age_s,
        mocap_delay_s=sources.own.validator.delay_s,
        autopilot_age_s=autopilot_age_s,
        neighbour_age_s=sources.neighbours.oldest_age_s(now_ns),
        loop_period_p50_ms=loop.p50_ms,
        loop_period_p99_ms=loop.p99_ms,
        loop_period_max_ms=loop.max_ms,
        late_ticks=loop.late_ticks,
        loop_lateness_p99_ms=loop.lateness_p99_ms,
        missed_ticks=loop.missed_ticks,
        hover_thrust_frac=tick.hover_thrust_frac,
        config_hash=identity.config_hash,
        system_id=identity.vehicle.system_id,
        conditions=conditions,
        action=action,
        operator=sources.roles.operator,
        roles=sources.roles.others,
        avoids=neighbour_name(avoided, sources.neighbours),
        doubles=sources.duplicates.names(now_ns),
        refused_orders=dict(sources.orders.refused),
        is_flown_by_hand=view.is_flown_by_hand,
        wind_enu_m_s=sources.own.wind_enu_m_s,
        gust_m_s=sources.own.gust_m_s,
        max_wind_m_s=identity.max_wind_m_s,
        **_satellite_fields(identity.vehicle, snapshot, now_ns, result.corrections),
        **_taken_order(sources.orders),
        **_counts(counters.messages),
        disabled_by=flight.disabled_by[:_MAX_CHARACTERS],
        stands_in_for=flight.stands_in_for,
        follows=flight.followed[:_MAX_CHARACTERS],
        is_path_paused=flight.is_paused,
        **_path_fields(flight.path),
    )


def _not_ready(preflight_reasons: tuple[str, ...], flight: FlightContext) -> tuple[str, ...]:
    """Return the reasons against a take-off. If the vehicle is out of service, that is the first
    reason.
    """
    if flight.disabled_by:
        return (sentences.disabled(flight), *preflight_reasons)
    return preflight_reasons


def _counts(counts: MessageCounts) -> dict[str, Any]:
    """Return the fields about messages that were not used."""
    return {
        "malformed_messages": counts.malformed,
        "refused_messages": counts.refused,
        "dropped_messages": counts.dropped,
        "late_messages": counts.late,
    }


def _satellite_fields(
    vehicle: Vehicle, snapshot: Snapshot, now_ns: int, corrections: CorrectionsStatus | None
) -> dict[str, Any]:
    """Return the fields about corrections and, for a flight without mocap, about satellites."""
    is_fix_recent = snapshot.fix_ns != 0 and now_ns - snapshot.fix_ns <= FIX_KNOWN_NS
    if vehicle.mocap_required or not is_fix_recent:
        return _correction_fields(corrections)
    return {
        "fix": words_of(snapshot.fix_type),
        "satellites": snapshot.satellites,
        **_correction_fields(corrections),
    }


def _correction_fields(corrections: CorrectionsStatus | None) -> dict[str, Any]:
    if corrections is None:
        return {}
    age_s = corrections.age_s
    if math.isinf(age_s):  # no corrections yet
        age_s = math.nan
    return {
        "corrections_age_s": age_s,
        "base_id": corrections.base_id,
        "base_distance_m": corrections.base_distance_m,
    }


def _taken_order(orders: OrderIntake) -> dict[str, Any]:
    """Return the fields about the newest accepted order; no fields before the first order."""
    if orders.taken is None:
        return {}
    order = orders.taken.order
    return {
        "taken_order_id": order.order_id[:_MAX_CHARACTERS],
        "taken_order_kind": order.kind,
        "taken_order_from": f"{order.author[:_MAX_CHARACTERS]} ({order.node[:_MAX_CHARACTERS]})",
    }


def _path_fields(path: PathFlight) -> dict[str, Any]:
    """Return the fields about the path that is followed; no fields without a path."""
    if not path.show_id:
        return {}
    return {
        "show_id": path.show_id,
        "path_time_s": path.time_s,
        "path_rate_frac": path.rate,
        "path_lag_m": path.lag_m,
        "is_behind": path.is_behind,
    }
