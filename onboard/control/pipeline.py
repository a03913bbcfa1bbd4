"""The control pipeline of one vehicle: calls all stages in order, once per tick.

Every intermediate value is in the returned Tick. L is the lead time: a command given at t takes
effect at t + L. Lines with a letter (line G, line O) refer to the algorithm in
onboard/avoidance/README.md, which also lists the deviations from the paper (D7).

    predict our own state to t + L
    -> trajectory setpoint for t + L
    -> backstepping at t + L: the baseline thrust
    -> avoidance law: Covey's, or a user's own
    -> add drag, subtract disturbance
    -> allocation: attitude and throttle

While the law holds a vehicle back, its setpoint would run away and the baseline would wind up.
Three measures prevent that. First, while the law is active, the trajectory's clock slows with the
lag behind the setpoint. Second, a position error beyond the clamp counts as if it were at the
clamp. Third, in a jam the vehicle follows its setpoint more slowly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from onboard.avoidance import interface, oist
from onboard.avoidance.heights import INTENT_S
from onboard.avoidance.params import Capsule
from onboard.avoidance.prediction import LARGEST, Motion
from onboard.constants import GRAVITY_M_S2
from onboard.control import allocation, backstepping, sinking, trajectory
from onboard.control.control_mode import ControlMode
from onboard.control.pipeline_numbers import PipelineParams as PipelineParams
from onboard.control.pipeline_numbers import pipeline_params as pipeline_params
from onboard.estimation import disturbance_observer, hover_thrust
from onboard.frames import wrap_rad
from onboard.types import (
    AttitudeSetpoint,
    Goal,
    LawOutput,
    Neighbour,
    State,
    Thrust,
    Tick,
    TrajectorySetpoint,
)
from onboard.vectors import (
    ZERO_3,
    Vec3,
    add,
    finite_or,
    is_finite,
    is_within,
    length,
    scaled,
    subtract,
)

INTENT_1_S = 1.0  # intended horizontal velocity per metre of distance to the goal
_ACTIVE_M_S2 = 0.05  # the law is active if it changes the thrust by more than this
_ACTIVE_FACTOR = 2.0  # the clock slows fully if the law was active in half of the recent past
_MIN_CLAMP_M = 0.15  # smallest clamp of the position error, for the fastest setpoint

# At lift-off, tilt turns the vehicle over while the landing gear still touches the ground. The
# largest tilt is PX4's own for a take-off (MPC_TILTMAX_LND).
_LIFTOFF_CLAMP_M = 0.1  # clamp of the position error
_LIFTOFF_TILT_RAD = math.radians(12.0)

_UNKNOWN = Vec3(math.nan, math.nan, math.nan)
_WEIGHT = Vec3(0.0, 0.0, -GRAVITY_M_S2)
_LEVEL = Thrust(Vec3(0.0, 0.0, GRAVITY_M_S2))


# type of :func:`onboard.avoidance.oist.step`
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
    hover_thrust: hover_thrust.HoverThrustMemory
    clock_rate: float
    trajectory: trajectory.TrajectoryMemory
    setpoint: TrajectorySetpoint
    baseline: interface.Baseline
    motion: Motion  # our own motion at t + L; NaN if the estimate cannot be used
    is_usable: bool  # whether the estimate can be used


def initial(params: PipelineParams, position_enu_m: Vec3, yaw_rad: float = 0.0) -> PipelineMemory:
    """Return the memory at rest on the ground or hovering at a position.

    Args:
        params: parameters of the vehicle.
        position_enu_m: position of the vehicle [m], ENU.
        yaw_rad: heading to hold until a goal gives another one (the paper's psi_d),
            counterclockwise from east.
    """
    return PipelineMemory(
        trajectory=trajectory.initial(position_enu_m),
        law=oist.initial(),
        observer=disturbance_observer.initial(ZERO_3),
        hover_thrust=hover_thrust.initial(params.hover_thrust),
        sent_enu_m_s2=ZERO_3,
        clock_rate=1.0,
        activity=0.0,
        yaw_rad=yaw_rad,
        thrust_frac=0.0,
        cos_tilt=1.0,
    )


def expecting_push(
    memory: PipelineMemory, push_enu_m_s2: Vec3, params: PipelineParams
) -> PipelineMemory:
    """Return the memory of a vehicle on the ground that expects a push after its lift-off.

    Args:
        memory: memory of the last tick, on the ground.
        push_enu_m_s2: expected push of the wind [m/s^2], ENU, finite.
        params: parameters of the vehicle.
    """
    observer = disturbance_observer.expecting(memory.observer, push_enu_m_s2, params.observer)
    return memory._replace(observer=observer)


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
    """Return memory and Tick after one tick of one vehicle.

    Args:
        memory: memory of the last tick.
        state: own estimate.
        goal: goal of the order that is flown.
        neighbours: the known neighbours.
        obstacles: static obstacles, and edges of the fence's areas.
        mode: a ControlMode.
        params: parameters of the vehicle.
        dt_s: length of the tick.
        law_step: the avoidance law: ``oist.step``, or a function that takes and returns the same.
    Returns:
        Memory and Tick. ``is_finite`` of the Tick is False if the input could not be used; the
        attitude setpoint is then level.
    Properties: equivariant under translation and rotation about the vertical.
    """
    if mode == ControlMode.GROUND:
        return _on_ground(state, params)

    before = before_law(memory, state, goal, mode, params, dt_s)
    law_memory, law = law_step(
        memory.law, before.baseline, before.motion, state, neighbours, obstacles, params.law, dt_s
    )
    return after_law(memory, before, law_memory, law, state, goal, mode, params, dt_s)


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
        memory: memory of the last tick.
        state: own estimate.
        goal: goal of the order that is flown.
        mode: a ControlMode, not on the ground.
        params: parameters of the vehicle.
        dt_s: length of the tick.
    """
    is_usable = is_within(state.position_enu_m, LARGEST) and is_within(
        state.velocity_enu_m_s, LARGEST
    )
    usable = state
    if not is_usable:
        usable = _at_rest(state, memory)
    observer, hover = _observed(memory, usable, mode, params, dt_s)

    speed_share = 1.0  # a descent without poses does not slow down in a jam
    if mode != ControlMode.DEAD_RECKONING:
        speed_share = oist.speed_share(memory.law, params.law)
    predicted = oist.predict(memory.law, usable, params.law, dt_s)
    rate, trajectory_memory, setpoint = _advance_trajectory(
        memory, predicted, goal, mode, params, dt_s
    )
    intended_m_s = intent(
        predicted.position_enu_m,
        goal,
        params.trajectory.max_speed_m_s,
        rise_m=trajectory.rise_soon_m(trajectory_memory),
    )

    # Line O: the compensation of drag and observed disturbance is added after the law. So the law's
    # thrust is for a vehicle without drag and wind.
    disturbance = observer.disturbance_enu_m_s2
    if mode == ControlMode.LIFTOFF or mode == ControlMode.DEAD_RECKONING:
        disturbance = observer.mean_enu_m_s2
    compensation = _compensation(predicted.velocity_enu_m_s, disturbance, params)

    thrust = _tracking(predicted, setpoint, speed_share, mode, params)

    motion = predicted
    if not is_usable:  # NaN makes the law level the thrust and publish no prediction
        motion = Motion(_UNKNOWN, _UNKNOWN)
    return BeforeLaw(
        observer=observer,
        hover_thrust=hover,
        clock_rate=rate,
        trajectory=trajectory_memory,
        setpoint=setpoint,
        baseline=interface.Baseline(thrust, compensation, intended_m_s),
        motion=motion,
        is_usable=is_usable,
    )


def after_law(
    memory: PipelineMemory,
    before: BeforeLaw,
    law_memory: oist.LawMemory,
    law: LawOutput,
    state: State,
    goal: Goal,
    mode: int,
    params: PipelineParams,
    dt_s: float,
) -> tuple[PipelineMemory, Tick]:
    """Return memory and Tick after the law.

    Args:
        memory: memory of the last tick.
        before: results of the stages before the law.
        law_memory, law: results of the law.
        state: own estimate.
        goal: goal of the order that is flown.
        mode: a ControlMode, not on the ground.
        params: parameters of the vehicle.
        dt_s: length of the tick.
    """
    thrust = before.baseline.thrust
    compensation = before.baseline.compensation_enu_m_s2
    hover_frac = before.hover_thrust.hover_thrust_frac

    activity = _activity(memory.activity, law.intervention_m_s2, params, dt_s)
    yaw_rad = _turned(memory.yaw_rad, goal, params, dt_s)

    required = Thrust(add(law.thrust.thrust_enu_m_s2, compensation))
    limits = params.allocation
    if mode == ControlMode.LIFTOFF:
        limits = allocation.tilted_less(limits, _LIFTOFF_TILT_RAD)
    sent = allocation.limit(required, hover_frac, limits)
    attitude = allocation.allocate(sent, yaw_rad, hover_frac, limits)

    after = PipelineMemory(
        trajectory=before.trajectory,
        law=law_memory,
        observer=before.observer,
        hover_thrust=before.hover_thrust,
        sent_enu_m_s2=add(sent.thrust_enu_m_s2, _WEIGHT),
        clock_rate=before.clock_rate,
        activity=activity,
        yaw_rad=yaw_rad,
        thrust_frac=attitude.thrust_frac,
        cos_tilt=sent.thrust_enu_m_s2.z / max(length(sent.thrust_enu_m_s2), 1e-9),
    )
    tick = Tick(
        state=state,
        setpoint=before.setpoint,
        thrust_baseline=thrust,
        law=law,
        attitude=attitude,
        hover_thrust_frac=hover_frac,
        is_finite=before.is_usable and is_finite(thrust.thrust_enu_m_s2),
    )
    return after, tick


def _advance_trajectory(
    memory: PipelineMemory,
    predicted: Motion,
    goal: Goal,
    mode: int,
    params: PipelineParams,
    dt_s: float,
) -> tuple[float, trajectory.TrajectoryMemory, TrajectorySetpoint]:
    """Return the rate of the trajectory's clock, the trajectory's memory, and the setpoint."""
    trajectory_memory = memory.trajectory
    bounds = params.trajectory

    if mode == ControlMode.DEAD_RECKONING:
        # a descent without poses waits only for vehicles below, which land soon
        limit_m_s = memory.law.sink_limit_m_s
        trajectory_memory, setpoint = sinking.step(
            trajectory_memory, predicted, goal, params.sinking, limit_m_s, dt_s
        )
        return 1.0, trajectory_memory, setpoint

    rate = clock_rate(memory, predicted.position_enu_m, goal, params, dt_s)
    trajectory_memory, setpoint = trajectory.step(trajectory_memory, goal, bounds, dt_s, rate)
    return rate, trajectory_memory, setpoint


def _observed(
    memory: PipelineMemory, state: State, mode: int, params: PipelineParams, dt_s: float
) -> tuple[disturbance_observer.ObserverMemory, hover_thrust.HoverThrustMemory]:
    """Return the memories of the disturbance observer and the hover thrust after this tick."""
    is_frozen = mode == ControlMode.LIFTOFF or mode == ControlMode.DEAD_RECKONING
    observer, _ = disturbance_observer.step(
        memory.observer,
        state.velocity_enu_m_s,
        memory.sent_enu_m_s2,
        params.observer,
        dt_s,
        is_frozen,
    )
    if mode == ControlMode.LIFTOFF:
        observer = disturbance_observer.lifting_off(
            observer, state.velocity_enu_m_s, state.acceleration_enu_m_s2, params.observer
        )

    is_flying = mode == ControlMode.FLYING
    hover, _ = hover_thrust.step(
        memory.hover_thrust,
        memory.thrust_frac,
        memory.cos_tilt,
        state.acceleration_enu_m_s2.z,
        state.position_enu_m.z,
        params.hover_thrust,
        dt_s,
        is_flying,
    )
    return observer, hover


def _tracking(
    predicted: Motion,
    setpoint: TrajectorySetpoint,
    speed_share: float,
    mode: int,
    params: PipelineParams,
) -> Thrust:
    """Return the baseline thrust; ``speed_share`` slows the motion in a jam (line G).

    A landing goes on downwards at its full speed. Else a vehicle that wind carries away, against
    its law, would stay in that wind.
    """
    velocity = scaled(speed_share, setpoint.velocity_enu_m_s)
    acceleration = scaled(speed_share, setpoint.acceleration_enu_m_s2)
    if mode == ControlMode.LANDING:
        velocity = Vec3(velocity.x, velocity.y, setpoint.velocity_enu_m_s.z)
        acceleration = Vec3(acceleration.x, acceleration.y, setpoint.acceleration_enu_m_s2.z)

    slowed = TrajectorySetpoint(setpoint.position_enu_m, velocity, acceleration)
    gains = _pursuit(setpoint, speed_share, mode, params)
    return backstepping.step(predicted.position_enu_m, predicted.velocity_enu_m_s, slowed, gains)


def _at_rest(state: State, memory: PipelineMemory) -> State:
    """Return a state at rest on the setpoint, to replace an estimate that cannot be used."""
    return State(
        position_enu_m=trajectory.setpoint_position(memory.trajectory),
        velocity_enu_m_s=ZERO_3,
        acceleration_enu_m_s2=_UNKNOWN,  # NaN freezes the hover estimate
        yaw_rad=state.yaw_rad,
        age_s=state.age_s,
        position_std_m=state.position_std_m,
        velocity_std_m_s=state.velocity_std_m_s,
    )


def clock_rate(
    memory: PipelineMemory, position_enu_m: Vec3, goal: Goal, params: PipelineParams, dt_s: float
) -> float:
    """Return the rate of the trajectory's clock, from 0 to 1.

    The rate is less than 1 while the law is active and the vehicle lags behind its setpoint. It is
    0 while neighbours are in the way of a climb or a descent.

    Only the lag along the direction to the goal counts, so being pushed aside or ahead does not
    slow the clock. DEVIATION D7. The vehicles on a path have one common clock, which is not slowed
    here.

    Args:
        memory: memory of the last tick.
        position_enu_m: position predicted to t + L [m], ENU.
        goal: goal of the order that is flown.
        params: the lags at which the clock slows and stops, and its time constant.
        dt_s: length of the tick.
    """
    if goal.is_on_path:
        return goal.clock_rate_frac

    # the lag behind the setpoint, projected onto the direction from the setpoint to the goal
    leading = trajectory.setpoint_position(memory.trajectory)
    to_goal_x = goal.position_enu_m.x - leading.x
    to_goal_y = goal.position_enu_m.y - leading.y
    lag_m2 = (leading.x - position_enu_m.x) * to_goal_x + (leading.y - position_enu_m.y) * to_goal_y
    lag_m = lag_m2 / max(math.sqrt(to_goal_x * to_goal_x + to_goal_y * to_goal_y), 1e-6)

    lag_share = (lag_m - params.clock_slack_m) / (params.clock_stop_m - params.clock_slack_m)
    if math.isfinite(lag_share):
        lag_share = min(max(lag_share, 0.0), 1.0)
    else:
        lag_share = 0.0

    active_share = min(max(_ACTIVE_FACTOR * memory.activity, 0.0), 1.0)
    target_rate = min(1.0 - active_share * lag_share, memory.law.climb_share)
    blend = 1.0 - math.exp(-dt_s / params.clock_time_s)
    return memory.clock_rate + blend * (target_rate - memory.clock_rate)


def intent(position_enu_m: Vec3, goal: Goal, max_speed_m_s: float, rise_m: float = 0.0) -> Vec3:
    """Return the velocity [m/s] that would lead straight to the goal or along the path.

    The velocity is limited to the top speed. Its vertical part times ``INTENT_S`` is the remaining
    climb to the goal, so that the neighbours know where a climb ends. In a leg that rises
    (:mod:`onboard.control.passing`), it is the climb to the height that the leg reaches soon.

    Args:
        position_enu_m: position predicted to t + L [m], ENU.
        goal: goal of the order that is flown.
        max_speed_m_s: top speed of the vehicle.
        rise_m: height above the level leg that the vehicle reaches soon.
    """
    p = position_enu_m
    goal_m = goal.position_enu_m
    v = goal.velocity_enu_m_s  # velocity of the path's point; zero for a goal at rest
    rate = goal.clock_rate_frac

    x = INTENT_1_S * (goal_m.x - p.x) + rate * v.x
    y = INTENT_1_S * (goal_m.y - p.y) + rate * v.y
    z = (goal_m.z + rise_m - p.z) / INTENT_S + rate * v.z

    share = max_speed_m_s / max(math.sqrt(x * x + y * y), max_speed_m_s)
    return Vec3(share * x, share * y, min(max(z, -max_speed_m_s), max_speed_m_s))


def _activity(
    activity: float, intervention_m_s2: float, params: PipelineParams, dt_s: float
) -> float:
    """Return the share of the recent past in which the law was active, after this tick."""
    active = 1.0 if intervention_m_s2 > _ACTIVE_M_S2 else 0.0
    return activity + (1.0 - math.exp(-dt_s / params.activity_time_s)) * (active - activity)


def _turned(yaw_rad: float, goal: Goal, params: PipelineParams, dt_s: float) -> float:
    """Return the heading to hold after this tick, turned the shorter way towards the goal's
    heading.
    """
    if not math.isfinite(goal.yaw_rad):
        return yaw_rad

    turn_rad = wrap_rad(goal.yaw_rad - yaw_rad)  # the shorter way
    most_rad = params.max_yaw_rate_rad_s * dt_s
    return yaw_rad + min(max(turn_rad, -most_rad), most_rad)


def _pursuit(
    setpoint: TrajectorySetpoint, speed_share: float, mode: int, params: PipelineParams
) -> backstepping.BacksteppingParams:
    """Return the gains and bounds of the backstepping for this tick.

    The clamp of the position error is chosen so that the setpoint's speed, plus the speed that the
    error adds, stays below the pursuit speed.
    """
    base = params.backstepping
    speed_m_s = length(setpoint.velocity_enu_m_s)
    spare_m = (params.pursuit_speed_m_s - speed_m_s) / base.position_gain_1_s
    free_clamp_m = min(max(spare_m, _MIN_CLAMP_M), base.max_position_error_m)
    clamp_m = free_clamp_m * speed_share
    height_clamp_m = clamp_m

    if mode == ControlMode.LIFTOFF:
        clamp_m = min(clamp_m, _LIFTOFF_CLAMP_M)
        height_clamp_m = clamp_m
    elif mode == ControlMode.LANDING:
        height_clamp_m = free_clamp_m

    # without poses, a hard brake above the ground is better than a longer descent
    highest_m_s2 = base.max_vertical_acceleration_m_s2
    if mode == ControlMode.DEAD_RECKONING:
        highest_m_s2 = params.sinking.vertical_m_s2

    return backstepping.BacksteppingParams(
        position_gain_1_s=base.position_gain_1_s,
        velocity_gain_1_s=base.velocity_gain_1_s,
        coupling_1_s2=base.coupling_1_s2,
        max_position_error_m=clamp_m,
        max_height_error_m=height_clamp_m,
        max_acceleration_m_s2=base.max_acceleration_m_s2,
        max_vertical_acceleration_m_s2=highest_m_s2,
    )


def _compensation(
    velocity_enu_m_s: Vec3, disturbance_enu_m_s2: Vec3, params: PipelineParams
) -> Vec3:
    """Return the compensation c V - s_b of drag and disturbance, within its limits.

    A component that is not finite counts as zero.
    """
    drag = scaled(params.drag_1_s, velocity_enu_m_s)
    x, y, z = finite_or(subtract(drag, disturbance_enu_m_s2), ZERO_3)
    share = min(1.0, params.max_compensation_m_s2 / max(math.sqrt(x * x + y * y), 1e-9))
    highest = params.max_lift_compensation_m_s2
    return Vec3(share * x, share * y, min(max(z, -highest), highest))


def _on_ground(state: State, params: PipelineParams) -> tuple[PipelineMemory, Tick]:
    """Return a level setpoint without thrust, and reset memories.

    So the flight uses nothing that was estimated on the ground, but the heading, which it keeps.
    """
    position = finite_or(state.position_enu_m, ZERO_3)
    yaw_rad = 0.0
    if math.isfinite(state.yaw_rad):
        yaw_rad = state.yaw_rad
    memory = initial(params, position, yaw_rad)

    hover_frac = memory.hover_thrust.hover_thrust_frac
    flat = allocation.allocate(_LEVEL, yaw_rad, hover_frac, params.allocation)
    tick = Tick(
        state=state,
        setpoint=TrajectorySetpoint(position, ZERO_3, ZERO_3),
        thrust_baseline=_LEVEL,
        law=interface.unchanged(_LEVEL, Motion(position, ZERO_3), ZERO_3, params.law),
        attitude=AttitudeSetpoint(flat.quaternion_wxyz, 0.0),
        hover_thrust_frac=hover_frac,
        is_finite=is_finite(state.position_enu_m),
    )
    return memory, tick
