"""The order of the stages, and nothing else: one call per tick, every intermediate value in the returned Tick.

    predict own state to t + L -> guidance for t + L -> backstepping there (baseline) -> law -> + drag, - disturbance
    -> allocation

While the law holds a vehicle back, its trajectory would run away and the baseline would wind up: the trajectory's clock
slows with the lag behind the setpoint, but only as far as the law is really active; a position error beyond the clamp
pulls no harder, and in a jam the whole pursuit slows down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import msgspec
import numpy as np

from onboard.avoidance import oist
from onboard.config.fleet import FleetConfig, LawName
from onboard.control import allocation, backstepping, fused, trajectory
from onboard.estimation import disturbance_observer, hover_thrust
from onboard.types import (
    GRAVITY_M_S2,
    Array,
    AttitudeSetpoint,
    BoolArray,
    Goal,
    Neighbours,
    State,
    Thrust,
    Tick,
    TrajectorySetpoint,
    light,
)

_INTENT_1_S = 1.0  # the velocity that a vehicle would like, per metre left to the goal


class Phase(IntEnum):
    """What the agent lets the pipeline do."""

    GROUND = 0  # level at no thrust, memories kept reset
    LIFTOFF = 1  # climbing off the ground: gentle horizontally, observers frozen
    FLYING = 2
    LANDING = 3  # as flying, but the hover thrust is not learned near the ground


@dataclass(frozen=True, slots=True)
class PipelineParams:
    """Parameters of every stage for one vehicle, and the anti-windup of the pipeline itself.

    pursuit_speed_m_s: setpoint speed plus what the position error adds stays below. clock_slack_m, clock_stop_m: lag
    behind the setpoint at which the clock begins to slow and stands still while the law is active.
    """

    guidance: trajectory.GuidanceParams
    backstepping: backstepping.BacksteppingParams
    law: oist.LawParams
    observer: disturbance_observer.ObserverParams
    hover_thrust: hover_thrust.HoverThrustParams
    allocation: allocation.AllocationParams
    drag_1_s: float
    pursuit_speed_m_s: float
    clock_slack_m: float = 0.3
    clock_stop_m: float = 1.5
    activity_time_s: float = 0.5
    clock_time_s: float = 0.2


@light
@dataclass(frozen=True, slots=True)
class PipelineMemory:
    """All memories; sent_enu_m_s2 (..., 3) is the last command after every limit, without gravity.

    clock_rate and activity (...): state of the anti-windup. thrust_frac, cos_tilt (...): last attitude setpoint.
    """

    guidance: trajectory.GuidanceMemory
    law: oist.LawMemory
    observer: disturbance_observer.ObserverMemory
    hover_thrust: hover_thrust.HoverThrustMemory
    sent_enu_m_s2: Array
    clock_rate: Array
    activity: Array
    thrust_frac: Array
    cos_tilt: Array


def pipeline_params(fleet: FleetConfig, vehicle_name: str, *, law: str | None = None) -> PipelineParams:
    """Parameters of one vehicle of a fleet; ``law`` ("covey", "paper", "off") overrides the fleet file's choice."""
    vehicle, values = fleet.vehicles[vehicle_name], fleet.law
    names: dict[str, LawName] = {"covey": "covey", "paper": "paper", "off": "off"}
    if law is not None and law not in names:
        raise ValueError(f"law is '{law}', but there are only {', '.join(names)}. Name one of these.")
    if law is not None:
        values = msgspec.structs.replace(values, name=names[law])
    tilt_rad = math.radians(vehicle.max_tilt_deg)
    lag_s = vehicle.lag_s if values.name != "paper" and values.prediction == "lag" else 0.0
    lift_reserve = (1.0 / vehicle.hover_thrust_frac - 1.0) * GRAVITY_M_S2
    limits = allocation.params_from_degrees(vehicle.max_tilt_deg, vehicle.hover_thrust_frac)
    return PipelineParams(
        guidance=trajectory.GuidanceParams(vehicle.max_speed_m_s, vehicle.max_acceleration_m_s2, lag_s),
        backstepping=backstepping.BacksteppingParams(
            max_acceleration_m_s2=GRAVITY_M_S2 * math.tan(tilt_rad),
            max_vertical_acceleration_m_s2=min(2.5, 0.4 * lift_reserve),  # the rest stays for separation
        ),
        law=oist.LawParams(
            config=values,
            lag_s=vehicle.lag_s,
            safety_distance_m=fleet.fleet.safety_distance_m,
            body_radius_m=0.5 * fleet.fleet.body_diameter_m,
            max_speed_m_s=vehicle.max_speed_m_s,
            max_tilt_rad=tilt_rad,
            max_thrust_m_s2=0.97 / vehicle.hover_thrust_frac * GRAVITY_M_S2,
            fence_enu_m=(*fleet.fleet.geofence_m.x, *fleet.fleet.geofence_m.y),
            capsules_enu_m=tuple(capsule for obstacle in fleet.obstacles for capsule in obstacle.capsules_enu_m),
        ),
        observer=disturbance_observer.ObserverParams(
            delay_s=vehicle.attitude_delay_s,
            wn_rad_s=vehicle.attitude_wn_rad_s,
            zeta=vehicle.attitude_zeta,
            drag_1_s=vehicle.drag_1_s,
        ),
        hover_thrust=hover_thrust.HoverThrustParams(configured_frac=vehicle.hover_thrust_frac),
        allocation=limits,
        drag_1_s=vehicle.drag_1_s,
        pursuit_speed_m_s=1.25 * vehicle.max_speed_m_s,
    )


def initial(params: PipelineParams, position_enu_m: Array) -> PipelineMemory:
    """At rest on the ground or hovering at a position (..., 3); the batch has that shape."""
    position = np.asarray(position_enu_m, dtype=np.float64)
    batch = position.shape[:-1]
    return PipelineMemory(
        guidance=trajectory.initial(position),
        law=oist.initial(batch),
        observer=disturbance_observer.initial(np.zeros_like(position), params=params.observer),
        hover_thrust=hover_thrust.initial(batch, params=params.hover_thrust),
        sent_enu_m_s2=np.zeros_like(position),
        clock_rate=np.ones(batch),
        activity=np.zeros(batch),
        thrust_frac=np.zeros(batch),
        cos_tilt=np.ones(batch),
    )


def step(
    memory: PipelineMemory,
    state: State,
    goal: Goal,
    neighbours: Neighbours,
    *,
    params: PipelineParams,
    dt_s: float,
    phase: Phase = Phase.FLYING,
    yaw_rad: Array | float = 0.0,
) -> tuple[PipelineMemory, Tick]:
    """One tick of one vehicle, or of a batch.

    Args:
        state: own estimate (..., 3); goal: (...); neighbours: (..., K), a snapshot.
        yaw_rad: (...) heading to hold (the paper's psi_d is zero).
    Returns:
        Memory and Tick; ``is_finite`` is False where the input could not be used and the vehicle was levelled.
    Properties: batch equals loop; equivariant under translation and turning about the vertical.
    """
    if phase == Phase.GROUND:
        return _ground(state, neighbours, params, yaw_rad)
    batch = state.position_enu_m.shape[:-1]
    if batch and isinstance(yaw_rad, float) and yaw_rad == 0.0:
        gentle, flying = phase == Phase.LIFTOFF, phase == Phase.FLYING
        done = fused.step(memory, state, goal, neighbours, params, dt_s, is_gentle=gentle, is_flying=flying)
        if done is not None:
            return done
    is_usable = np.asarray(oist.is_plausible(state.position_enu_m) & oist.is_plausible(state.velocity_enu_m_s))
    given, state = state, _mended(state, is_usable, memory)
    is_frozen = phase == Phase.LIFTOFF
    observer = disturbance_observer.observe(
        memory.observer,
        state.velocity_enu_m_s,
        memory.sent_enu_m_s2,
        params=params.observer,
        dt_s=dt_s,
        is_frozen=is_frozen,
    )
    hover_memory, hover = hover_thrust.step(
        memory.hover_thrust,
        memory.thrust_frac,
        memory.cos_tilt,
        state.acceleration_enu_m_s2[..., 2],
        state.position_enu_m[..., 2],
        params=params.hover_thrust,
        dt_s=dt_s,
        is_flying=phase == Phase.FLYING,
    )
    position, velocity = oist.predict(memory.law, state, params=params.law)
    rate = clock_rate(memory, position, goal, params=params, dt_s=dt_s)
    guidance_memory, setpoint = trajectory.step(
        memory.guidance, goal, params=params.guidance, dt_s=dt_s, clock_rate=rate
    )
    share = oist.speed_share(memory.law, params=params.law)
    baseline = backstepping.step(
        position, velocity, _slowed(setpoint, share), params=_pursuit(params, setpoint, share, is_frozen)
    )
    # line O: what drag and the observed disturbance take is added after the law, so that the law commands net motion
    compensation = params.drag_1_s * velocity - observer.disturbance_enu_m_s2
    compensation = _limited(compensation, params)
    if not _all(is_usable):  # the law shall know, level out, and publish no state that nobody has
        position = np.where(is_usable[..., None], position, np.nan)
        velocity = np.where(is_usable[..., None], velocity, np.nan)
    law_memory, law = oist.saturate(
        memory.law,
        baseline,
        (position, velocity),
        state,
        neighbours,
        params=params.law,
        dt_s=dt_s,
        compensation_enu_m_s2=compensation,
        intent_enu_m_s=intent(position, goal, params=params),
    )
    wanted = Thrust(law.thrust.thrust_enu_m_s2 + compensation)
    sent = allocation.limit(wanted, hover, params=params.allocation)
    yaw = np.broadcast_to(np.asarray(yaw_rad, dtype=np.float64), batch) if batch else np.array(float(yaw_rad))
    attitude = allocation.allocate(sent, yaw, hover, params=params.allocation)
    thrust = sent.thrust_enu_m_s2
    blend = 1.0 - math.exp(-dt_s / params.activity_time_s)
    is_finite = np.asarray(is_usable & _is_finite(baseline.thrust_enu_m_s2))
    memory = PipelineMemory(
        guidance=guidance_memory,
        law=law_memory,
        observer=observer,
        hover_thrust=hover_memory,
        sent_enu_m_s2=thrust - np.array([0.0, 0.0, GRAVITY_M_S2]),
        clock_rate=rate,
        activity=memory.activity + blend * ((law.intervention_m_s2 > 0.05) - memory.activity),
        thrust_frac=attitude.thrust_frac,
        cos_tilt=thrust[..., 2] / np.maximum(_length(thrust), 1e-9),
    )
    return memory, Tick(given, setpoint, baseline, law, attitude, hover, is_finite)


def _mended(state: State, is_usable: BoolArray, memory: PipelineMemory) -> State:
    """The state with rows that cannot be used put at rest on the setpoint, so that no stage computes with garbage."""
    if _all(is_usable):
        return state
    usable = is_usable[..., None]
    return replace(
        state,
        position_enu_m=np.where(usable, state.position_enu_m, trajectory.setpoint(memory.guidance).position_enu_m),
        velocity_enu_m_s=np.where(usable, state.velocity_enu_m_s, 0.0),
        acceleration_enu_m_s2=np.where(usable, state.acceleration_enu_m_s2, np.nan),  # freezes the hover estimate
    )


def clock_rate(
    memory: PipelineMemory, position_enu_m: Array, goal: Goal, *, params: PipelineParams, dt_s: float
) -> Array:
    """Rate (...) of the trajectory's clock: 1, or less while the law is active and the vehicle lags behind.

    The lag is counted along the way to the goal only: a vehicle pushed aside or ahead waits for nothing.
    DEVIATION D7.
    """
    ahead = trajectory.setpoint(memory.guidance).position_enu_m
    if ahead.ndim == 1:
        return _clock_rate_one(memory, ahead, position_enu_m, goal, params, dt_s)
    way = (goal.position_enu_m - ahead)[..., :2]
    rest = np.sqrt(np.einsum("...c,...c->...", way, way))
    lag = np.einsum("...c,...c->...", (ahead - position_enu_m)[..., :2], way) / np.maximum(rest, 1e-6)
    share = np.clip((lag - params.clock_slack_m) / (params.clock_stop_m - params.clock_slack_m), 0.0, 1.0)
    target = 1.0 - np.clip(2.0 * memory.activity, 0.0, 1.0) * np.where(np.isfinite(share), share, 0.0)
    blend = 1.0 - math.exp(-dt_s / params.clock_time_s)
    return np.asarray(memory.clock_rate + blend * (target - memory.clock_rate))


def _clock_rate_one(
    memory: PipelineMemory, ahead_enu_m: Array, position_enu_m: Array, goal: Goal, params: PipelineParams, dt_s: float
) -> Array:
    """:func:`clock_rate` for one vehicle, in floats."""
    a_x, a_y, _ = ahead_enu_m.tolist()
    p_x, p_y, _ = position_enu_m.tolist()
    g_x, g_y, _ = goal.position_enu_m.tolist()
    lag = ((a_x - p_x) * (g_x - a_x) + (a_y - p_y) * (g_y - a_y)) / max(math.hypot(g_x - a_x, g_y - a_y), 1e-6)
    share = (lag - params.clock_slack_m) / (params.clock_stop_m - params.clock_slack_m)
    share = min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
    rate = float(memory.clock_rate)
    target = 1.0 - min(max(2.0 * float(memory.activity), 0.0), 1.0) * share
    return np.array(rate + (1.0 - math.exp(-dt_s / params.clock_time_s)) * (target - rate))


def intent(position_enu_m: Array, goal: Goal, *, params: PipelineParams) -> Array:
    """Velocity (..., 3) that would lead straight to the goal, horizontal and at most as fast as is allowed."""
    way = goal.position_enu_m - position_enu_m
    way[..., 2] = 0.0
    if way.ndim == 1:
        x, y, _ = way.tolist()
        top = params.law.max_speed_m_s
        return way * (_INTENT_1_S * top / max(_INTENT_1_S * math.sqrt(x * x + y * y), top))
    far = np.sqrt(np.einsum("...c,...c->...", way, way))
    top = params.law.max_speed_m_s
    return np.asarray(way * (_INTENT_1_S * top / np.maximum(_INTENT_1_S * far, top))[..., None])


def _slowed(setpoint: TrajectorySetpoint, share: Array) -> TrajectorySetpoint:
    """The setpoint with its motion scaled down in a jam (line G)."""
    scale = share[..., None]
    return TrajectorySetpoint(
        setpoint.position_enu_m, setpoint.velocity_enu_m_s * scale, setpoint.acceleration_enu_m_s2 * scale
    )


def _pursuit(
    params: PipelineParams, setpoint: TrajectorySetpoint, share: Array, is_gentle: bool
) -> backstepping.BacksteppingParams:
    """Backstepping whose error clamp keeps setpoint speed plus pursuit below the limit; gentle at lift-off."""
    base = params.backstepping
    velocity = setpoint.velocity_enu_m_s
    room = (params.pursuit_speed_m_s - _length(velocity)) / base.position_gain_1_s
    clamp = np.minimum(np.maximum(room, 0.15), base.max_position_error_m) * share
    # while a leg still touches the ground, tilt turns the vehicle over instead of moving it
    return backstepping.BacksteppingParams(
        base.position_gain_1_s,
        base.velocity_gain_1_s,
        base.coupling_1_s2,
        np.minimum(clamp, 0.1) if is_gentle else clamp,
        1.0 if is_gentle else base.max_acceleration_m_s2,
        base.max_vertical_acceleration_m_s2,
    )


# of one vehicle in floats: numpy costs ten times as much for three numbers


def _length(vector: Array) -> Array:
    """Of vectors (..., 3), (...)."""
    if vector.ndim == 1:
        x, y, z = vector.tolist()
        return np.array(math.sqrt(x * x + y * y + z * z))
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", vector, vector)))


def _is_finite(vector: Array) -> BoolArray:
    """Whether all components of vectors (..., 3) are finite, (...)."""
    if vector.ndim == 1:
        x, y, z = vector.tolist()
        return np.array(math.isfinite(x) and math.isfinite(y) and math.isfinite(z))
    return np.asarray(np.isfinite(vector).all(-1))


def _all(flags: BoolArray) -> bool:
    return bool(flags.all() if flags.ndim else flags)


def _limited(compensation: Array, params: PipelineParams) -> Array:
    """Compensation (..., 3) that leaves at least half of the tilt and of the lift reserve to the law."""
    bound = 0.5 * GRAVITY_M_S2 * math.tan(params.law.max_tilt_rad)
    lift = 0.5 * (params.law.max_thrust_m_s2 - GRAVITY_M_S2)
    if compensation.ndim == 1:
        x, y, z = (value if math.isfinite(value) else 0.0 for value in compensation.tolist())
        share = min(1.0, bound / max(math.hypot(x, y), 1e-9))
        return np.array((share * x, share * y, min(max(z, -lift), lift)))
    finite = np.where(np.isfinite(compensation), compensation, 0.0)
    size = np.sqrt(finite[..., 0] ** 2 + finite[..., 1] ** 2)
    scale = np.minimum(1.0, bound / np.maximum(size, 1e-9))
    limited = finite * scale[..., None]
    limited[..., 2] = np.clip(finite[..., 2], -lift, lift)
    return np.asarray(limited)


def _ground(
    state: State, neighbours: Neighbours, params: PipelineParams, yaw_rad: Array | float
) -> tuple[PipelineMemory, Tick]:
    """No thrust, level, and memories as at the start, so that nothing learned on the ground is flown with."""
    position = np.where(np.isfinite(state.position_enu_m), state.position_enu_m, 0.0)
    batch = position.shape[:-1]
    memory = initial(params, position)
    level = Thrust(np.broadcast_to(np.array([0.0, 0.0, GRAVITY_M_S2]), position.shape).copy())
    still = np.zeros_like(position)
    _, law = oist.saturate(
        memory.law, level, (position, still), state, neighbours, params=params.law.changed(name="off"), dt_s=0.02
    )
    hover = memory.hover_thrust.hover_thrust_frac
    yaw = np.broadcast_to(np.asarray(yaw_rad, dtype=np.float64), batch)
    flat = allocation.allocate(level, yaw, hover, params=params.allocation)
    attitude = AttitudeSetpoint(flat.quaternion_wxyz, np.zeros(batch))
    setpoint = TrajectorySetpoint(position, still, still)
    is_finite = np.asarray(np.isfinite(state.position_enu_m).all(-1))
    return memory, Tick(state, setpoint, level, law, attitude, hover, is_finite)
