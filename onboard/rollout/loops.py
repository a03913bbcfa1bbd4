"""The loops over all vehicles of a batch, compiled with numba if that is installed.

Only this module compiles code. If numba is not installed, or with ``COVEY_NUMBA=0``, the same
functions are interpreted. The results are the same, but computing them takes some hundred times
longer. numba keeps compiled code on disk beside the source, or in the user's cache folder if the
source is read-only.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable
from functools import lru_cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

from onboard import frames, vectors
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
from onboard.control import allocation, backstepping, pipeline, sinking, trajectory
from onboard.estimation import disturbance_observer, hover_thrust, kalman, wind
from onboard.rollout import layouts
from onboard.rollout.layouts import CoveyResults, EstimatorMemory, OwnLawView
from onboard.types import Neighbour
from onboard.vectors import Vec3

Compiled = Callable[..., Any]


class Loops(NamedTuple):
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

# global names, because compiled code cannot call attributes
_read_state = layouts.STATE.read
_write_state = layouts.STATE.write
_read_goal = layouts.GOAL.read
_read_neighbour = layouts.NEIGHBOUR.read
_read_obstacle = layouts.OBSTACLE.read
_write_tick = layouts.TICK.write
_read_params = layouts.PARAMS.read
_read_memory = layouts.MEMORY.read
_write_memory = layouts.MEMORY.write
_read_covey_results = layouts.COVEY_RESULTS.read
_write_covey_results = layouts.COVEY_RESULTS.write
_read_own_law_view = layouts.OWN_LAW_VIEW.read
_write_own_law_view = layouts.OWN_LAW_VIEW.write
_write_law_neighbour = layouts.LAW_NEIGHBOUR.write
_read_filter_params = layouts.FILTER_PARAMS.read
_read_filter = layouts.FILTER.read
_write_filter = layouts.FILTER.write


def is_compiled() -> bool:
    """Whether batches are compiled: numba is installed, and ``COVEY_NUMBA`` is not 0."""
    return _numba() is not None


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
def loops() -> Loops:
    """Return the loops of the pipeline and of the filter, compiled if possible."""
    numba = _numba()
    if numba is None:
        return Loops(
            step=_step_rows,
            estimate=_estimate_rows,
            before_own_law=_before_own_law_rows,
            after_own_law=_after_own_law_rows,
        )

    # Python never calls these functions, and without wrappers they compile faster
    register = numba.extending.register_jitable(no_cpython_wrapper=True, no_cfunc_wrapper=True)
    for function in _functions():
        register(function)

    version = digest()
    return Loops(
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
    for layout in layouts.ALL:
        functions.append(layout.read)
        functions.append(layout.write)
    functions.extend((_step_rows, _estimate_rows, _before_own_law_rows, _after_own_law_rows))
    functions.append(_present_neighbours)
    return [function for function in functions if isinstance(function, FunctionType)]


def digest() -> int:
    """Return a number that changes with any function or constant that compiled code uses.

    On its own, numba's cache notices only changes to the file of the compiled function.
    """
    constants = []
    for module in _MODULES:
        for name, value in sorted(vars(module).items()):
            if isinstance(value, (int, float, tuple)):
                constants.append((name, value))

    code = [_code_parts(function.__code__) for function in _functions()]
    data = repr((code, constants, [layout.dtype for layout in layouts.ALL]))
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


def _step_rows(
    memories: Any, inputs: Any, obstacles: Any, params: Any, ticks: Any, dt_s: float
) -> None:
    """Compute and write the tick of each vehicle, and the memory of its pipeline after it.

    All arrays have one row for each of F N vehicles; only ``params`` has N rows.
    """
    states, goals, neighbours, is_present, modes = inputs
    read_obstacles = [_read_obstacle(obstacles[k]) for k in range(obstacles.shape[0])]

    for m in range(memories.shape[0]):
        near = _present_neighbours(neighbours[m], is_present[m])
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


def _present_neighbours(rows: Any, is_present: Any) -> list[Neighbour]:
    """Return the neighbours of one vehicle (K,) that are there."""
    return [_read_neighbour(rows[k]) for k in range(rows.shape[0]) if is_present[k]]


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
        received_neighbours = _present_neighbours(neighbours[m], is_present[m])
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
