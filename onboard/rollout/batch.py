"""Runs one tick of many vehicles at once, with the drone's own control pipeline and Kalman filter.

Arrays are (F, N): F flights of N vehicles. Each vehicle has one row of floats
(:mod:`onboard.rollout.rows`), and a neighbour of a vehicle has one too: (F, N, K).

Only this module compiles code, with numba. If numba is not installed, or with ``COVEY_NUMBA=0``,
the same functions are interpreted. The results are the same, but computing them takes some hundred
times longer. numba keeps compiled code on disk beside the source, or in the user's cache folder if
the source is read-only.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple, Protocol

import numpy as np

from onboard import frames, vectors
from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance import (
    constraints,
    fence_edges,
    half_planes,
    heights,
    interface,
    oist,
    oist_paper,
    own_law,
    pairs,
    prediction,
    projection,
    relaxation,
    smoothing,
)
from onboard.avoidance import params as law_params
from onboard.constants import GRAVITY_M_S2
from onboard.control import allocation, backstepping, pipeline, sinking, trajectory
from onboard.control.control_mode import ControlMode
from onboard.estimation import disturbance_observer, hover_thrust, kalman, wind
from onboard.rollout.fleet_routes import FleetRoutes
from onboard.rollout.rows import Layout, Rows, floats, zero
from onboard.types import Goal, LawOutput, Neighbour, State, Tick, TrajectorySetpoint
from onboard.vectors import ZERO_3, Vec3

Compiled = Callable[..., Any]


class _Loops(NamedTuple):
    """The loops over all vehicles, compiled if possible."""

    step: Compiled
    estimate: Compiled
    before_own_law: Compiled
    after_own_law: Compiled


# modules whose functions compiled code may call
_MODULES: tuple[ModuleType, ...] = (
    vectors,
    frames,
    # estimation
    kalman,
    wind,
    disturbance_observer,
    hover_thrust,
    # control
    trajectory,
    sinking,
    backstepping,
    allocation,
    pipeline,
    # avoidance
    law_params,
    prediction,
    smoothing,
    heights,
    pairs,
    half_planes,
    constraints,
    fence_edges,
    relaxation,
    projection,
    interface,
    oist,
    oist_paper,
    own_law,
)


class EstimatorMemory(NamedTuple):
    """Memory of the estimate of one vehicle."""

    motion: kalman.KalmanMemory
    wind: wind.WindMemory


class CoveyResults(NamedTuple):
    """What is computed of one vehicle before its user's law is called, and needed after it."""

    before: pipeline.BeforeLaw
    memory: oist.LawMemory  # of Covey's law, after the tick
    output: LawOutput  # of Covey's law


class OwnLawView(NamedTuple):
    """What a user's law gets of the vehicle itself, besides its estimate."""

    own: pairs.Own
    baseline: interface.Baseline
    predicted: prediction.Motion


_ZERO_PARAMS = zero(pipeline.PipelineParams)
_ZERO_MEMORY = pipeline.initial(_ZERO_PARAMS, ZERO_3)
_ZERO_BEFORE_LAW = pipeline.BeforeLaw(
    observer=_ZERO_MEMORY.observer,
    hover_thrust=_ZERO_MEMORY.hover_thrust,
    clock_rate=_ZERO_MEMORY.clock_rate,
    trajectory=_ZERO_MEMORY.trajectory,
    setpoint=zero(TrajectorySetpoint),
    baseline=zero(interface.Baseline),
    motion=zero(prediction.Motion),
    is_usable=False,
)

STATE = Layout(zero(State))
GOAL = Layout(zero(Goal))
NEIGHBOUR = Layout(zero(Neighbour))
OBSTACLE = Layout(zero(law_params.Capsule))
TICK = Layout(zero(Tick))
PARAMS = Layout(_ZERO_PARAMS)
MEMORY = Layout(_ZERO_MEMORY)
COVEY_RESULTS = Layout(CoveyResults(_ZERO_BEFORE_LAW, _ZERO_MEMORY.law, zero(LawOutput)))
OWN_LAW_VIEW = Layout(zero(OwnLawView))
LAW_NEIGHBOUR = Layout(zero(own_law.LawNeighbour))
FILTER_PARAMS = Layout(kalman.KalmanParams())
FILTER = Layout(EstimatorMemory(kalman.initial(ZERO_3, kalman.KalmanParams()), wind.initial()))
_LAYOUTS = (
    STATE,
    GOAL,
    NEIGHBOUR,
    TICK,
    OBSTACLE,
    PARAMS,
    MEMORY,
    COVEY_RESULTS,
    OWN_LAW_VIEW,
    LAW_NEIGHBOUR,
    FILTER_PARAMS,
    FILTER,
)

# global names, because compiled code cannot call attributes
_read_state = STATE.read
_write_state = STATE.write
_read_goal = GOAL.read
_read_neighbour = NEIGHBOUR.read
_read_obstacle = OBSTACLE.read
_write_tick = TICK.write
_read_params = PARAMS.read
_read_memory = MEMORY.read
_write_memory = MEMORY.write
_read_covey_results = COVEY_RESULTS.read
_write_covey_results = COVEY_RESULTS.write
_read_own_law_view = OWN_LAW_VIEW.read
_write_own_law_view = OWN_LAW_VIEW.write
_write_law_neighbour = LAW_NEIGHBOUR.write
_read_filter_params = FILTER_PARAMS.read
_read_filter = FILTER.read
_write_filter = FILTER.write

# published fields of a vehicle's estimate, and of its law's output; they have the same names in
# Neighbour
_PUBLISHED_OF_STATE = (
    "position_enu_m",
    "velocity_enu_m_s",
    "acceleration_enu_m_s2",
    "position_std_m",
    "velocity_std_m_s",
)
_PUBLISHED_OF_LAW = (
    "predicted_position_enu_m",
    "predicted_velocity_enu_m_s",
    "commanded_acceleration_enu_m_s2",
    "intent_enu_m_s",
    "lead_time_s",
    "crowd_count",
)


class PassRows(NamedTuple):
    """Inputs of the pipelines of many vehicles for one tick; some neighbours may be absent."""

    states: Rows  # (..., N)
    goals: Rows  # (..., N)
    neighbours: Rows  # (..., N, K)
    is_present: BoolArray  # (..., N, K)
    modes: IntArray  # (..., N), values of ControlMode


class BeforeOwnLaw(NamedTuple):
    """Results of :func:`before_own_law` for many vehicles."""

    covey: Rows  # (..., N), rows of CoveyResults
    views: Rows  # (..., N), rows of OwnLawView
    neighbours: Rows  # (..., N, K), rows of LawNeighbour, the nearest first
    neighbour_counts: IntArray  # (..., N), how many of the K there are


class Controller(Protocol):
    """Interface of the control of a whole batch."""

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the outputs (F, N) of all vehicles' pipelines in this tick, as rows of Tick.

        Args:
            states, goals: estimates and goals (F, N).
            neighbours, is_present: neighbours, and whether each exists (F, N, K).
            dt_s: length of the tick.
        """

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""


class FleetPipeline:
    """The pipelines of all vehicles, which implement :class:`Controller`.

    Args:
        params: parameters of the N vehicles.
        start_enu_m: positions (F, N, 3) at which the vehicles hover [m].
        obstacles: static obstacles, the same for all.
    """

    def __init__(
        self,
        params: Sequence[pipeline.PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[law_params.Capsule] = (),
    ) -> None:
        self._params = PARAMS.packed(params)
        self._obstacles = OBSTACLE.packed(obstacles)
        self._memories = hovering(params, start_enu_m)
        self._routes = FleetRoutes(len(start_enu_m), params, obstacles)

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks of all vehicles as in :class:`Controller`; all of them fly."""
        routed_goals = self._routes.goals(states, goals, neighbours, is_present, dt_s)
        modes = np.full(states.shape, int(ControlMode.FLYING))
        inputs = PassRows(
            states=states,
            goals=routed_goals,
            neighbours=neighbours,
            is_present=is_present,
            modes=modes,
        )
        return step(self._memories, inputs, self._obstacles, self._params, dt_s)

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""
        self._memories = self._memories[flights]
        self._routes.keep(flights)


class FleetEstimator:
    """The filters of all vehicles. At the start, the vehicles hover.

    Args:
        params: parameters of the N filters.
        start_enu_m: positions (F, N, 3) at which the vehicles hover [m].
    """

    def __init__(self, params: Sequence[kalman.KalmanParams], start_enu_m: Array) -> None:
        self._params = FILTER_PARAMS.packed(params)

        memories = []
        for positions_enu_m in start_enu_m.tolist():
            for own_params, position in zip(params, positions_enu_m, strict=True):
                motion = kalman.initial(Vec3(*position), own_params)
                memories.append(EstimatorMemory(motion, wind.initial()))
        self._memories = FILTER.packed(memories).reshape(start_enu_m.shape[:2])
        self._memories["motion"]["thrust_m_s2"] = GRAVITY_M_S2

    def step(
        self,
        quaternion_wxyz: Array,
        thrust_frac: Array,
        hover_thrust_frac: Array,
        sample_enu_m: Array,
        yaw_rad: Array,
        age_s: float,
        dt_s: float,
    ) -> Rows:
        """Return the states (F, N) one tick later.

        Args:
            quaternion_wxyz: flown attitudes (F, N, 4), FLU to ENU.
            thrust_frac: last throttles sent (F, N).
            hover_thrust_frac: hover throttles (F, N).
            sample_enu_m: positions (F, N, 3) that were measured ``age_s`` ago.
            yaw_rad: headings (F, N).
            age_s: age of the samples.
            dt_s: length of the tick.
        """
        shape = self._memories.shape
        inputs = np.empty((*shape, 10))
        inputs[..., 0:4] = quaternion_wxyz
        inputs[..., 4] = thrust_frac
        inputs[..., 5] = hover_thrust_frac
        inputs[..., 6:9] = sample_enu_m
        inputs[..., 9] = yaw_rad

        states = STATE.rows(shape)
        _loops().estimate(
            _flat(self._memories),
            inputs.reshape(self._memories.size, 10),
            floats(self._params),
            _flat(states),
            age_s,
            dt_s,
        )
        return states

    def keep(self, flights: IntArray) -> None:
        """Keep only these flights of the batch, by index."""
        self._memories = self._memories[flights]


def hovering(params: Sequence[pipeline.PipelineParams], start_enu_m: Array) -> Rows:
    """Return the memories (F, N) of the pipelines of vehicles that hover.

    Args:
        params: parameters of the N vehicles.
        start_enu_m: their positions (F, N, 3) [m].
    """
    memories = []
    for positions_enu_m in start_enu_m.tolist():
        for own_params, position in zip(params, positions_enu_m, strict=True):
            memories.append(pipeline.initial(own_params, Vec3(*position)))
    return MEMORY.packed(memories).reshape(start_enu_m.shape[:2])


def step(memories: Rows, inputs: PassRows, obstacles: Rows, params: Rows, dt_s: float) -> Rows:
    """Return the ticks (..., N) of many vehicles: the result of ``pipeline.step`` for each.

    Args:
        memories: memories (..., N) of the pipelines, which are changed in place.
        inputs: inputs of each vehicle.
        obstacles: static obstacles (O,), the same for all.
        params: parameters (N,) of the vehicles.
        dt_s: length of the tick [s].
    """
    ticks = TICK.rows(inputs.states.shape)
    _loops().step(
        _flat(memories),
        _flat_inputs(inputs),
        floats(obstacles),
        floats(params),
        _flat(ticks),
        dt_s,
    )
    return ticks


def before_own_law(
    memories: Rows,
    relaxed_shares: Array,
    inputs: PassRows,
    obstacles: Rows,
    params: Rows,
    dt_s: float,
) -> BeforeOwnLaw:
    """Return what comes before the call of a user's law, for many vehicles.

    Args:
        memories: memories (..., N) of the pipelines.
        relaxed_shares: true shares (..., N) of relaxed ticks of Covey's law.
        inputs: inputs of each vehicle.
        obstacles: static obstacles (O,), the same for all.
        params: parameters (N,) of the vehicles.
        dt_s: length of the tick [s].
    """
    shape = inputs.neighbours.shape
    result = BeforeOwnLaw(
        covey=COVEY_RESULTS.rows(shape[:-1]),
        views=OWN_LAW_VIEW.rows(shape[:-1]),
        neighbours=LAW_NEIGHBOUR.rows(shape),
        neighbour_counts=np.zeros(shape[:-1], np.int64),
    )
    _loops().before_own_law(
        _flat(memories),
        relaxed_shares.reshape(-1),
        _flat_inputs(inputs),
        floats(obstacles),
        floats(params),
        _flat(result.covey),
        _flat(result.views),
        floats(result.neighbours).reshape(memories.size, shape[-1], LAW_NEIGHBOUR.width),
        result.neighbour_counts.reshape(-1),
        dt_s,
    )
    return result


def after_own_law(
    memories: Rows,
    relaxed_shares: Array,
    before: BeforeOwnLaw,
    thrusts_enu_m_s2: Array,
    is_own: BoolArray,
    inputs: PassRows,
    params: Rows,
    dt_s: float,
) -> Rows:
    """Return the ticks (..., N) of many vehicles after the call of a user's law.

    Args:
        memories: memories (..., N) of the pipelines, which are changed in place.
        relaxed_shares: true shares (..., N) of relaxed ticks, which are changed in place.
        before: result of :func:`before_own_law`.
        thrusts_enu_m_s2: thrusts (..., N, 3) of the user's law; NaN: Covey's thrust is flown.
        is_own: whether the user's law flies (..., N), and not Covey's since it was refused.
        inputs: inputs of each vehicle.
        params: parameters (N,) of the vehicles.
        dt_s: length of the tick [s].
    """
    ticks = TICK.rows(inputs.states.shape)
    _loops().after_own_law(
        _flat(memories),
        relaxed_shares.reshape(-1),
        _flat(before.covey),
        _flat(before.views),
        thrusts_enu_m_s2.reshape(-1, 3),
        is_own.reshape(-1),
        _flat_inputs(inputs),
        floats(params),
        _flat(ticks),
        dt_s,
    )
    return ticks


def _flat_inputs(inputs: PassRows) -> tuple[Array, Array, Array, BoolArray, IntArray]:
    """Return the inputs of many vehicles as arrays of numbers, with one row for each vehicle."""
    size = inputs.states.size
    neighbour_count = inputs.neighbours.shape[-1]

    # writable arrays, because numba would compile the code again for read-only ones
    is_present = np.require(inputs.is_present, requirements=["C", "W"])
    modes = np.require(inputs.modes, np.int64, ["C", "W"])
    return (
        _flat(inputs.states),
        _flat(inputs.goals),
        floats(inputs.neighbours).reshape(size, neighbour_count, NEIGHBOUR.width),
        is_present.reshape(size, neighbour_count),
        modes.reshape(size),
    )


def message(states: Rows, ticks: Rows | None) -> Rows:
    """Return the state message of each vehicle, as rows of Neighbour.

    Before the first tick a vehicle publishes no command, and its present position is its predicted
    position.

    Args:
        states: estimates (F, N).
        ticks: ticks (F, N) of the pipeline; None before the first.
    """
    out = NEIGHBOUR.rows(states.shape)
    for name in _PUBLISHED_OF_STATE:
        out[name] = states[name]
    out["is_cooperative"] = 1.0

    if ticks is None:
        out["predicted_position_enu_m"] = states["position_enu_m"]
        return out

    law = ticks["law"]
    for name in _PUBLISHED_OF_LAW:
        out[name] = law[name]
    return out


def all_others(count: int) -> IntArray:
    """Return the senders (N, N - 1) if every vehicle receives from every other vehicle."""
    all_vehicles = np.arange(count)
    senders = [np.delete(all_vehicles, receiver) for receiver in range(count)]
    return np.array(senders).reshape(count, -1)


def received(inbox: Rows, age_s: Array, senders: IntArray, is_cooperative: BoolArray) -> Rows:
    """Return the neighbours (F, N, K) from the newest messages (F, receiver, sender).

    Args:
        inbox: newest message of each sender at each receiver, as rows of :func:`message`.
        age_s, is_cooperative: age and cooperation (F, receiver, sender).
        senders: indices (N, K) or (F, N, K) of the senders that each receiver uses.
    """
    flight_count, vehicle_count = inbox.shape[:2]
    flight = np.arange(flight_count)[:, None, None]
    receiver = np.arange(vehicle_count)[:, None]
    sender = np.broadcast_to(senders, (flight_count, *senders.shape[-2:]))
    index = (flight, receiver, sender)

    neighbours: Rows = floats(inbox)[index].view(NEIGHBOUR.dtype)[..., 0]
    neighbours["age_s"] = age_s[index]
    neighbours["is_cooperative"] = is_cooperative[index]
    # with the paper's law, each vehicle avoids the next one, and the last vehicle avoids the first
    neighbours["is_paper_obstacle"] = sender == (receiver + 1) % vehicle_count
    neighbours["table_index"] = np.arange(senders.shape[-1])
    return neighbours


def is_compiled() -> bool:
    """Whether batches are compiled: numba is installed, and ``COVEY_NUMBA`` is not 0."""
    return _numba() is not None


def warm_up(*, has_own_law: bool = False) -> bool:
    """Compile all functions of batches, or load them from numba's cache.

    Loading takes about a second, and compiling about twenty.

    Args:
        has_own_law: whether vehicles fly by a user's own law, which takes ten seconds more.

    Returns:
        False if nothing is compiled.
    """
    if not is_compiled():
        return False

    # numba compiles by types, not by sizes, so zero flights of one vehicle with one neighbour are
    # enough
    no_numbers = np.zeros((0, 1))
    no_vectors = np.zeros((0, 1, 1))

    estimator = FleetEstimator([kalman.KalmanParams()], no_vectors)
    states = estimator.step(
        quaternion_wxyz=no_vectors,
        thrust_frac=no_numbers,
        hover_thrust_frac=no_numbers,
        sample_enu_m=no_vectors,
        yaw_rad=no_numbers,
        age_s=0.0,
        dt_s=0.0,
    )

    controller = FleetPipeline([_ZERO_PARAMS], no_vectors)
    goals = GOAL.rows((0, 1))
    neighbours = NEIGHBOUR.rows((0, 1, 1))
    is_present = no_vectors > 0.0
    controller.step(states, goals, neighbours, is_present, dt_s=0.0)
    if not has_own_law:
        return True

    inputs = PassRows(states, goals, neighbours, is_present, modes=np.zeros((0, 1), np.int64))
    memories = MEMORY.rows((0, 1))
    obstacles = OBSTACLE.packed([])
    params = PARAMS.packed([_ZERO_PARAMS])
    before = before_own_law(memories, no_numbers, inputs, obstacles, params, dt_s=0.0)
    is_own = no_numbers > 0.0
    after_own_law(memories, no_numbers, before, no_vectors, is_own, inputs, params, dt_s=0.0)
    return True


def _flat(rows: Rows) -> Array:
    """Return the numbers (size, width) of rows; contiguous rows share their memory with them."""
    return floats(rows).reshape(rows.size, rows.dtype.itemsize // 8)


def _step_rows(
    memories: Any, inputs: Any, obstacles: Any, params: Any, ticks: Any, dt_s: float
) -> None:
    """Compute and write the tick of each vehicle, and the memory of its pipeline after it.

    All arrays have one row for each of F N vehicles; only ``params`` has N rows.
    """
    states, goals, neighbours, is_present, modes = inputs
    read_obstacles = [_read_obstacle(obstacles[k]) for k in range(obstacles.shape[0])]

    for m in range(memories.shape[0]):
        near = [
            _read_neighbour(neighbours[m, k])
            for k in range(neighbours.shape[1])
            if is_present[m, k]
        ]
        own_params = _read_params(params[m % params.shape[0]])
        memory, tick = pipeline.step(
            _read_memory(memories[m]),
            _read_state(states[m]),
            _read_goal(goals[m]),
            near,
            read_obstacles,
            modes[m],
            own_params,
            dt_s,
        )
        _write_memory(memory, memories[m])
        _write_tick(tick, ticks[m])


def _before_own_law_rows(
    memories: Any,
    relaxed_shares: Any,
    inputs: Any,
    obstacles: Any,
    params: Any,
    covey: Any,
    views: Any,
    near: Any,
    near_counts: Any,
    dt_s: float,
) -> None:
    """Compute and write what comes before the call of the user's law of each vehicle.

    All arrays have one row for each of F N vehicles; only ``params`` has N rows.
    """
    states, goals, neighbours, is_present, modes = inputs
    read_obstacles = [_read_obstacle(obstacles[k]) for k in range(obstacles.shape[0])]

    for m in range(memories.shape[0]):
        received_neighbours = [
            _read_neighbour(neighbours[m, k])
            for k in range(neighbours.shape[1])
            if is_present[m, k]
        ]
        own_params = _read_params(params[m % params.shape[0]])
        memory = _read_memory(memories[m])
        state = _read_state(states[m])
        before = pipeline.before_law(
            memory, state, _read_goal(goals[m]), modes[m], own_params, dt_s
        )
        tick = own_law.covey_tick(
            memory.law,
            relaxed_shares[m],
            before.baseline,
            before.motion,
            state,
            received_neighbours,
            read_obstacles,
            own_params.law,
            dt_s,
        )
        _write_covey_results(CoveyResults(before, tick.memory, tick.output), covey[m])
        _write_own_law_view(OwnLawView(tick.own, before.baseline, before.motion), views[m])
        near_counts[m] = len(tick.neighbours)
        for k in range(len(tick.neighbours)):
            _write_law_neighbour(tick.neighbours[k], near[m, k])


def _after_own_law_rows(
    memories: Any,
    relaxed_shares: Any,
    covey: Any,
    views: Any,
    thrusts_enu_m_s2: Any,
    is_own: Any,
    inputs: Any,
    params: Any,
    ticks: Any,
    dt_s: float,
) -> None:
    """Compute and write the tick of each vehicle, and memory and share after it.

    All arrays have one row for each of F N vehicles; only ``params`` has N rows.
    """
    states, goals, _, _, modes = inputs

    for m in range(memories.shape[0]):
        own_params = _read_params(params[m % params.shape[0]])
        memory = _read_memory(memories[m])
        results = _read_covey_results(covey[m])
        law_memory = results.memory
        law = results.output

        thrust = Vec3(thrusts_enu_m_s2[m, 0], thrusts_enu_m_s2[m, 1], thrusts_enu_m_s2[m, 2])
        if vectors.is_finite(thrust):
            own = _read_own_law_view(views[m]).own
            law_memory, law = own_law.flown_instead(thrust, own, law, law_memory, memory.law, dt_s)
        relaxed_shares[m] = law_memory.relaxed_share
        if is_own[m]:
            law_memory = own_law.with_share(law_memory, 0.0)

        memory, tick = pipeline.after_law(
            memory,
            results.before,
            law_memory,
            law,
            _read_state(states[m]),
            _read_goal(goals[m]),
            modes[m],
            own_params,
            dt_s,
        )
        _write_memory(memory, memories[m])
        _write_tick(tick, ticks[m])


def _estimate_rows(
    memories: Any, inputs: Any, params: Any, states: Any, age_s: float, dt_s: float
) -> None:
    """Compute and write the state of each vehicle, and the memory of its filter after it.

    All arrays have one row for each of F N vehicles; only ``params`` has N rows.
    """
    is_on_ground = False
    for m in range(memories.shape[0]):
        own_params = _read_filter_params(params[m % params.shape[0]])
        row = inputs[m]  # columns as filled in FleetEstimator.step
        quaternion = (row[0], row[1], row[2], row[3])
        thrust_frac = row[4]
        hover_frac = row[5]
        sample = Vec3(row[6], row[7], row[8])
        yaw_rad = row[9]

        memory = _read_filter(memories[m])
        motion = kalman.drive(
            memory.motion, quaternion, thrust_frac, hover_frac, own_params, dt_s, is_on_ground
        )
        motion = kalman.correct(motion, sample, age_s, own_params)
        wind_memory = wind.step(memory.wind, motion.bias_enu_m_s2, dt_s, is_on_ground)

        _write_filter(EstimatorMemory(motion, wind_memory), memories[m])
        state = kalman.state(motion, yaw_rad, 0.0, 0.0)
        _write_state(wind.widened(state, wind_memory, own_params.gust_time_s), states[m])


@lru_cache(maxsize=1)
def _numba() -> Any:
    """Return the module numba, or None if nothing should be compiled."""
    if os.environ.get("COVEY_NUMBA", "") == "0":
        return None
    try:
        import numba
    except ImportError:
        return None
    return numba


@lru_cache(maxsize=1)
def _loops() -> _Loops:
    """Return the loops of the pipeline and of the filter, compiled if possible."""
    numba = _numba()
    if numba is None:
        return _Loops(
            step=_step_rows,
            estimate=_estimate_rows,
            before_own_law=_before_own_law_rows,
            after_own_law=_after_own_law_rows,
        )

    # Python never calls these functions, and without wrappers they compile faster
    register = numba.extending.register_jitable(no_cpython_wrapper=True, no_cfunc_wrapper=True)
    for function in _functions():
        register(function)

    version = _digest()
    return _Loops(
        step=_jit(numba, _step_rows, version),
        estimate=_jit(numba, _estimate_rows, version),
        before_own_law=_jit(numba, _before_own_law_rows, version),
        after_own_law=_jit(numba, _after_own_law_rows, version),
    )


def _jit(numba: Any, function: Compiled, version: int) -> Compiled:
    """Return the function compiled on first use, or loaded from numba's cache."""

    def run(*arguments: Any) -> int:
        function(*arguments)
        # numba's cache depends on the values in the closure, so the closure must use the version
        return version

    options = {"nogil": True, "fastmath": False}
    try:
        return numba.njit(cache=True, **options)(run)  # type: ignore[no-any-return]
    except RuntimeError:  # there is no folder for the cache
        return numba.njit(**options)(run)  # type: ignore[no-any-return]


def _functions() -> list[FunctionType]:
    """Return all functions that compiled code may call."""
    functions: list[Any] = []
    for module in _MODULES:
        for value in vars(module).values():
            if getattr(value, "__module__", "") == module.__name__:
                functions.append(value)
    for layout in _LAYOUTS:
        functions.append(layout.read)
        functions.append(layout.write)
    functions.extend((_step_rows, _estimate_rows, _before_own_law_rows, _after_own_law_rows))
    return [function for function in functions if isinstance(function, FunctionType)]


def _digest() -> int:
    """Return a number that changes with any function or constant that compiled code uses.

    On its own, numba's cache notices only changes to the file of the compiled function.
    """
    constants = []
    for module in _MODULES:
        for name, value in sorted(vars(module).items()):
            if isinstance(value, (int, float, tuple)):
                constants.append((name, value))

    code = [_code_parts(function.__code__) for function in _functions()]
    data = repr((code, constants, [layout.dtype for layout in _LAYOUTS]))
    return zlib.crc32(data.encode())


def _code_parts(code: CodeType) -> list[object]:
    """Return the content of a function's code, which is equal in every process.

    ``marshal`` is not used, because it gives different bytes for code from a .pyc file and for the
    same code just compiled. The law would then be compiled twice on a new machine.
    """
    parts: list[object] = [code.co_code, code.co_names, code.co_freevars]
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            parts.append(_code_parts(constant))
        else:
            parts.append(constant)
    return parts
