"""The order of the stages, and nothing else: one call per tick, every intermediate value in the
returned Tick.

    predict own state to t + L -> trajectory for t + L -> backstepping there (baseline) -> law -> +
    drag, - disturbance -> allocation

While the law holds a vehicle back, its trajectory would run away and the baseline would wind up:
the trajectory's clock slows with the lag behind the setpoint, but only as far as the law is really
active; a position error beyond the clamp pulls no harder, and in a jam the whole pursuit slows
down.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from onboard.avoidance import interface, oist
from onboard.avoidance.heights import INTENT_S
from onboard.avoidance.params import Capsule
from onboard.avoidance.prediction import Motion
from onboard.control import allocation, backstepping, trajectory
from onboard.control.control_mode import ControlMode
from onboard.control.pipeline_numbers import PipelineParams as PipelineParams
from onboard.control.pipeline_numbers import pipeline_params as pipeline_params
from onboard.estimation import disturbance_observer, hover_thrust
from onboard.types import (
    GRAVITY_M_S2,
    AttitudeSetpoint,
    Goal,
    LawOutput,
    Neighbour,
    State,
    Thrust,
    Tick,
    TrajectorySetpoint,
)
from onboard.vectors import ZERO_3, Vec3, add, is_finite, length, scaled

_INTENT_1_S = 1.0  # intended velocity per metre left to the goal
_BLIND_SPEED = 1.5  # share of the top speed, with the sinking
_ACTIVE_M_S2 = 0.05  # an intervention beyond counts as the law being active
_NOWHERE = Vec3(math.nan, math.nan, math.nan)
_WEIGHT = Vec3(0.0, 0.0, -GRAVITY_M_S2)
_LEVEL = Thrust(Vec3(0.0, 0.0, GRAVITY_M_S2))


# arguments and results of :func:`onboard.avoidance.oist.step`
LawStep = Callable[..., tuple[oist.LawMemory, LawOutput]]


class PipelineMemory(NamedTuple):
    """Memories of all stages and of the anti-windup."""

    trajectory: trajectory.TrajectoryMemory
    law: oist.LawMemory
    observer: disturbance_observer.ObserverMemory
    hover_thrust: hover_thrust.HoverThrustMemory
    sent_enu_m_s2: Vec3  # last command after every limit, without gravity
    clock_rate: float  # of the trajectory
    activity: float  # share of the recent past in which the law was active
    yaw_rad: float  # of the last attitude setpoint
    thrust_frac: float  # of the last attitude setpoint
    cos_tilt: float  # of the last attitude setpoint


class BeforeLaw(NamedTuple):
    """Results of the stages before the law."""

    observer: disturbance_observer.ObserverMemory
    lift: hover_thrust.HoverThrustMemory
    clock_rate: float
    trajectory: trajectory.TrajectoryMemory
    setpoint: TrajectorySetpoint
    baseline: interface.Baseline
    motion: Motion  # own at t + L; NaN where the estimate cannot be used
    is_usable: bool  # whether it can


def initial(params: PipelineParams, position_enu_m: Vec3) -> PipelineMemory:
    """Return the memory at rest on the ground or hovering at a position.

    Args:
        params: of the vehicle.
        position_enu_m: [m], ENU.
    """
    return PipelineMemory(
        trajectory.initial(position_enu_m),
        oist.initial(),
        disturbance_observer.initial(ZERO_3),
        hover_thrust.initial(params.hover_thrust),
        ZERO_3,
        1.0,
        0.0,
        params.yaw_rad,
        0.0,
        1.0,
    )


def step(
    memory: PipelineMemory,
    state: State,
    goal: Goal,
    neighbours: Sequence[Neighbour],
    obstacles: Sequence[Capsule],
    mode: int,
    params: PipelineParams,
    dt_s: float,
    law_step: LawStep = oist.step,
) -> tuple[PipelineMemory, Tick]:
    """One tick of one vehicle.

    Args:
        memory: of the last tick.
        state: own estimate.
        goal: of the order being flown.
        neighbours: a snapshot of those that are known.
        obstacles: what stands still.
        mode: a ControlMode.
        params: of the vehicle.
        dt_s: length of the tick.
        law_step: the avoidance law: ``oist.step``, or a function that takes and returns the same.
    Returns:
        Memory and Tick; ``is_finite`` is False where the input could not be used and the vehicle
        was levelled.
    Properties: equivariant under translation and turning about the vertical.
    """
    if mode == ControlMode.GROUND:
        return _on_ground(state, params)
    before = before_law(memory, state, goal, mode, params, dt_s)
    law_memory, law = law_step(
        memory.law, before.baseline, before.motion, state, neighbours, obstacles, params.law, dt_s
    )
    return after_law(memory, before, law_memory, law, state, goal, params, dt_s)


def before_law(
    memory: PipelineMemory,
    state: State,
    goal: Goal,
    mode: int,
    params: PipelineParams,
    dt_s: float,
) -> BeforeLaw:
    """Return the results of the stages before the law, for a vehicle in flight.

    Args:
        memory: of the last tick.
        state: own estimate.
        goal: of the order being flown.
        mode: a ControlMode, not on the ground.
        params: of the vehicle.
        dt_s: length of the tick.
    """
    is_usable = interface.is_plausible(state.position_enu_m) and interface.is_plausible(
        state.velocity_enu_m_s
    )
    usable = state if is_usable else _at_rest(state, memory)
    observer, lift = _observed(memory, usable, mode, params, dt_s)
    predicted = oist.predict(memory.law, usable, params.law)
    rate, leg, setpoint = _led(memory, predicted, goal, mode, params, dt_s)
    share = oist.speed_share(memory.law, params.law)
    thrust = _tracking(predicted, setpoint, share, mode == ControlMode.LIFTOFF, params)
    # line O: what drag and the observed disturbance take is added after the law, so that the law
    # commands net motion
    known = observer.mean_enu_m_s2 if mode == ControlMode.BLIND else observer.disturbance_enu_m_s2
    compensation = _compensation(predicted.velocity_enu_m_s, known, params)
    top_m_s = params.trajectory.max_speed_m_s
    baseline = interface.Baseline(
        thrust, compensation, intent(predicted.position_enu_m, goal, top_m_s)
    )
    # the law must know, level out, and publish no state that is not known
    motion = predicted if is_usable else Motion(_NOWHERE, _NOWHERE)
    return BeforeLaw(observer, lift, rate, leg, setpoint, baseline, motion, is_usable)


def after_law(
    memory: PipelineMemory,
    before: BeforeLaw,
    law_memory: oist.LawMemory,
    law: LawOutput,
    state: State,
    goal: Goal,
    params: PipelineParams,
    dt_s: float,
) -> tuple[PipelineMemory, Tick]:
    """Return memory and Tick after the law.

    Args:
        memory: of the last tick.
        before: results of the stages before the law.
        law_memory, law: results of the law.
        state: own estimate.
        goal: of the order being flown.
        params: of the vehicle.
        dt_s: length of the tick.
    """
    thrust, compensation = before.baseline.thrust, before.baseline.compensation_enu_m_s2
    hover_frac = before.lift.hover_thrust_frac
    sent = allocation.limit(
        Thrust(add(law.thrust.thrust_enu_m_s2, compensation)), hover_frac, params.allocation
    )
    yaw_rad = _turned(memory.yaw_rad, goal, params, dt_s)
    attitude = allocation.allocate(sent, yaw_rad, hover_frac, params.allocation)
    after = PipelineMemory(
        before.trajectory,
        law_memory,
        before.observer,
        before.lift,
        add(sent.thrust_enu_m_s2, _WEIGHT),
        before.clock_rate,
        _activity(memory.activity, law.intervention_m_s2, params, dt_s),
        yaw_rad,
        attitude.thrust_frac,
        sent.thrust_enu_m_s2.z / max(length(sent.thrust_enu_m_s2), 1e-9),
    )
    is_sound = before.is_usable and is_finite(thrust.thrust_enu_m_s2)
    return after, Tick(state, before.setpoint, thrust, law, attitude, hover_frac, is_sound)


def _led(
    memory: PipelineMemory,
    predicted: Motion,
    goal: Goal,
    mode: int,
    params: PipelineParams,
    dt_s: float,
) -> tuple[float, trajectory.TrajectoryMemory, TrajectorySetpoint]:
    """Return the rate of the trajectory's clock, the leg and the setpoint."""
    leg, bounds = memory.trajectory, params.trajectory
    if mode == ControlMode.BLIND:  # its clock waits for nobody, because each second costs accuracy
        if goal.sequence != leg.sequence:  # it brakes from where it is, and returns to no setpoint
            leg = trajectory.moving(predicted.position_enu_m, predicted.velocity_enu_m_s)
        top_m_s = _BLIND_SPEED * bounds.max_speed_m_s  # it sinks and brakes at the same time
        wider = trajectory.TrajectoryParams(top_m_s, bounds.max_acceleration_m_s2, bounds.lead_s)
        leg, setpoint = trajectory.step(leg, goal, wider, dt_s, 1.0)
        return 1.0, leg, setpoint
    rate = clock_rate(memory, predicted.position_enu_m, goal, params, dt_s)
    leg, setpoint = trajectory.step(leg, goal, bounds, dt_s, rate)
    return rate, leg, setpoint


def _observed(
    memory: PipelineMemory, state: State, mode: int, params: PipelineParams, dt_s: float
) -> tuple[disturbance_observer.ObserverMemory, hover_thrust.HoverThrustMemory]:
    """Return what the state teaches about the disturbance and the hover thrust."""
    observer, _ = disturbance_observer.step(
        memory.observer,
        state.velocity_enu_m_s,
        memory.sent_enu_m_s2,
        params.observer,
        dt_s,
        mode == ControlMode.LIFTOFF or mode == ControlMode.BLIND,
    )
    lift, _ = hover_thrust.step(
        memory.hover_thrust,
        memory.thrust_frac,
        memory.cos_tilt,
        state.acceleration_enu_m_s2.z,
        state.position_enu_m.z,
        params.hover_thrust,
        dt_s,
        mode == ControlMode.FLYING,
    )
    return observer, lift


def _tracking(
    predicted: Motion,
    setpoint: TrajectorySetpoint,
    share: float,
    is_gentle: bool,
    params: PipelineParams,
) -> Thrust:
    """Return the baseline thrust; in a jam the setpoint's motion and the pursuit are scaled by
    ``share`` (line G).
    """
    slowed = TrajectorySetpoint(
        setpoint.position_enu_m,
        scaled(share, setpoint.velocity_enu_m_s),
        scaled(share, setpoint.acceleration_enu_m_s2),
    )
    gains = _pursuit(setpoint, share, is_gentle, params)
    return backstepping.step(predicted.position_enu_m, predicted.velocity_enu_m_s, slowed, gains)


def _at_rest(state: State, memory: PipelineMemory) -> State:
    """Return a state that cannot be used as one at rest on the setpoint, so that no stage computes
    with garbage.
    """
    return State(
        trajectory.setpoint_position(memory.trajectory),
        ZERO_3,
        _NOWHERE,  # freezes the hover estimate
        state.yaw_rad,
        state.age_s,
        state.position_std_m,
        state.velocity_std_m_s,
    )


def clock_rate(
    memory: PipelineMemory, position_enu_m: Vec3, goal: Goal, params: PipelineParams, dt_s: float
) -> float:
    """Return the rate of the trajectory's clock: 1, or less while the law is active and the vehicle
    lags behind.

    It stands still while the vehicle climbs or sinks towards others that are not aside yet.

    The lag is counted along the way to the goal only: a vehicle pushed aside or ahead waits for
    nothing. DEVIATION D7. The clock of a path is common to all that fly it, and not slowed here.

    Args:
        memory: of the last tick.
        position_enu_m: predicted [m], ENU.
        goal: of the order being flown.
        params: slack, stop and time constant.
        dt_s: length of the tick.
    """
    if goal.is_on_path:
        return goal.clock_rate_frac
    ahead = trajectory.setpoint_position(memory.trajectory)
    to_goal_x, to_goal_y = goal.position_enu_m.x - ahead.x, goal.position_enu_m.y - ahead.y
    lag = (ahead.x - position_enu_m.x) * to_goal_x + (ahead.y - position_enu_m.y) * to_goal_y
    lag = lag / max(math.sqrt(to_goal_x * to_goal_x + to_goal_y * to_goal_y), 1e-6)
    share = (lag - params.clock_slack_m) / (params.clock_stop_m - params.clock_slack_m)
    share = min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
    target = min(1.0 - min(max(2.0 * memory.activity, 0.0), 1.0) * share, memory.law.climb_share)
    return memory.clock_rate + (1.0 - math.exp(-dt_s / params.clock_time_s)) * (
        target - memory.clock_rate
    )


def intent(position_enu_m: Vec3, goal: Goal, max_speed_m_s: float) -> Vec3:
    """Return the velocity that would lead straight to the goal or along the path, at most the top
    speed.

    Its vertical part is slower, and as far as it goes in ``INTENT_S`` is the way that is left: by
    it the others know where a climb ends.

    Args:
        position_enu_m: predicted [m], ENU.
        goal: of the order being flown.
        max_speed_m_s: of the vehicle.
    """
    x = (
        _INTENT_1_S * (goal.position_enu_m.x - position_enu_m.x)
        + goal.clock_rate_frac * goal.velocity_enu_m_s.x
    )
    y = (
        _INTENT_1_S * (goal.position_enu_m.y - position_enu_m.y)
        + goal.clock_rate_frac * goal.velocity_enu_m_s.y
    )
    share = max_speed_m_s / max(math.sqrt(x * x + y * y), max_speed_m_s)
    z = (
        goal.position_enu_m.z - position_enu_m.z
    ) / INTENT_S + goal.clock_rate_frac * goal.velocity_enu_m_s.z
    return Vec3(share * x, share * y, min(max(z, -max_speed_m_s), max_speed_m_s))


def _activity(
    activity: float, intervention_m_s2: float, params: PipelineParams, dt_s: float
) -> float:
    """Return the share of the recent past in which the law was active, after this tick."""
    is_active = 1.0 if intervention_m_s2 > _ACTIVE_M_S2 else 0.0
    return activity + (1.0 - math.exp(-dt_s / params.activity_time_s)) * (is_active - activity)


def _turned(yaw_rad: float, goal: Goal, params: PipelineParams, dt_s: float) -> float:
    """Return the heading to hold after this tick: it turns towards that of the goal, the shorter
    way, not too fast.
    """
    if not math.isfinite(goal.yaw_rad):
        return yaw_rad
    left_rad = goal.yaw_rad - yaw_rad
    left_rad -= 2.0 * math.pi * math.floor(left_rad / (2.0 * math.pi) + 0.5)
    most_rad = params.max_yaw_rate_rad_s * dt_s
    return yaw_rad + min(max(left_rad, -most_rad), most_rad)


def _pursuit(
    setpoint: TrajectorySetpoint, share: float, is_gentle: bool, params: PipelineParams
) -> backstepping.BacksteppingParams:
    """Return the backstepping whose error clamp keeps setpoint speed plus pursuit below the limit."""
    base = params.backstepping
    room = (params.pursuit_speed_m_s - length(setpoint.velocity_enu_m_s)) / base.position_gain_1_s
    clamp, largest = (
        min(max(room, 0.15), base.max_position_error_m) * share,
        base.max_acceleration_m_s2,
    )
    # while a leg still touches the ground, tilt turns the vehicle over instead of moving it
    if is_gentle:
        clamp, largest = min(clamp, 0.1), 1.0
    return backstepping.BacksteppingParams(
        base.position_gain_1_s,
        base.velocity_gain_1_s,
        base.coupling_1_s2,
        clamp,
        largest,
        base.max_vertical_acceleration_m_s2,
    )


def _compensation(
    velocity_enu_m_s: Vec3, disturbance_enu_m_s2: Vec3, params: PipelineParams
) -> Vec3:
    """Return c V - s_b within its limits; a component that is not finite counts as zero."""
    x = _or_zero(params.drag_1_s * velocity_enu_m_s.x - disturbance_enu_m_s2.x)
    y = _or_zero(params.drag_1_s * velocity_enu_m_s.y - disturbance_enu_m_s2.y)
    z = _or_zero(params.drag_1_s * velocity_enu_m_s.z - disturbance_enu_m_s2.z)
    share = min(1.0, params.max_compensation_m_s2 / max(math.sqrt(x * x + y * y), 1e-9))
    highest = params.max_lift_compensation_m_s2
    return Vec3(share * x, share * y, min(max(z, -highest), highest))


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _on_ground(state: State, params: PipelineParams) -> tuple[PipelineMemory, Tick]:
    """No thrust, level, and memories as at the start, so that nothing learned on the ground is
    flown with.
    """
    given = state.position_enu_m
    position = Vec3(_or_zero(given.x), _or_zero(given.y), _or_zero(given.z))
    memory = initial(params, position)
    law = interface.unchanged(_LEVEL, Motion(position, ZERO_3), ZERO_3, params.law)
    hover_frac = memory.hover_thrust.hover_thrust_frac
    flat = allocation.allocate(_LEVEL, params.yaw_rad, hover_frac, params.allocation)
    attitude = AttitudeSetpoint(flat.quaternion_wxyz, 0.0)
    setpoint = TrajectorySetpoint(position, ZERO_3, ZERO_3)
    return memory, Tick(state, setpoint, _LEVEL, law, attitude, hover_frac, is_finite(given))
