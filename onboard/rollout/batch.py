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
from onboard.types import Goal, Neighbour, State, Tick
from onboard.vectors import ZERO_3, Vec3

Compiled = Callable[..., Any]


class _Loops(NamedTuple):
    """The loops over all vehicles, compiled if possible."""

    step: Compiled
    estimate: Compiled


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
)


class EstimatorMemory(NamedTuple):
    """Memory of the estimate of one vehicle."""

    motion: kalman.KalmanMemory
    wind: wind.WindMemory


_ZERO_PARAMS = zero(pipeline.PipelineParams)

STATE = Layout(zero(State))
GOAL = Layout(zero(Goal))
NEIGHBOUR = Layout(zero(Neighbour))
OBSTACLE = Layout(zero(law_params.Capsule))
TICK = Layout(zero(Tick))
PARAMS = Layout(_ZERO_PARAMS)
MEMORY = Layout(pipeline.initial(_ZERO_PARAMS, ZERO_3))
FILTER_PARAMS = Layout(kalman.KalmanParams())
FILTER = Layout(EstimatorMemory(kalman.initial(ZERO_3, kalman.KalmanParams()), wind.initial()))
_LAYOUTS = (STATE, GOAL, NEIGHBOUR, TICK, OBSTACLE, PARAMS, MEMORY, FILTER_PARAMS, FILTER)

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

        memories = []
        for positions_enu_m in start_enu_m.tolist():
            for own_params, position in zip(params, positions_enu_m, strict=True):
                memories.append(pipeline.initial(own_params, Vec3(*position)))
        self._memories = MEMORY.packed(memories).reshape(start_enu_m.shape[:2])
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
    size = ticks.size
    neighbour_count = inputs.neighbours.shape[-1]

    # writable arrays, because numba would compile the code again for read-only ones
    is_present = np.require(inputs.is_present, requirements=["C", "W"])
    modes = np.require(inputs.modes, np.int64, ["C", "W"])
    flat_inputs = (
        _flat(inputs.states),
        _flat(inputs.goals),
        floats(inputs.neighbours).reshape(size, neighbour_count, NEIGHBOUR.width),
        is_present.reshape(size, neighbour_count),
        modes.reshape(size),
    )
    _loops().step(
        _flat(memories),
        flat_inputs,
        floats(obstacles),
        floats(params),
        _flat(ticks),
        dt_s,
    )
    return ticks


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


def warm_up() -> bool:
    """Compile all functions of batches, or load them from numba's cache.

    Loading takes about a second, and compiling about twenty.

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
    controller.step(
        states=states,
        goals=GOAL.rows((0, 1)),
        neighbours=NEIGHBOUR.rows((0, 1, 1)),
        is_present=no_vectors > 0.0,
        dt_s=0.0,
    )
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
        return _Loops(step=_step_rows, estimate=_estimate_rows)

    # Python never calls these functions, and without wrappers they compile faster
    register = numba.extending.register_jitable(no_cpython_wrapper=True, no_cfunc_wrapper=True)
    for function in _functions():
        register(function)

    version = _digest()
    return _Loops(
        step=_jit(numba, _step_rows, version),
        estimate=_jit(numba, _estimate_rows, version),
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
    functions.append(_step_rows)
    functions.append(_estimate_rows)
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
