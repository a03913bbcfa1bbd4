"""One tick of many vehicles at once: the drone's own pipeline and filter, compiled by numba in this
one place.

Arrays are (F, N): F flights of N vehicles, one row per vehicle (:mod:`onboard.rollout.rows`). Where
numba is not installed, or ``COVEY_NUMBA=0``, the same functions are interpreted: right, and some
hundred times slower. Compiled code is kept on disk by numba beside the source, or in the user's
cache folder where that is read-only.
"""

from __future__ import annotations

import marshal
import os
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import FunctionType, ModuleType
from typing import Any, NamedTuple, Protocol

import numpy as np

from onboard import frames, vectors
from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance import (
    constraints,
    half_planes,
    heights,
    interface,
    oist,
    oist_paper,
    pairs,
    prediction,
    projection,
    relaxation,
)
from onboard.avoidance import params as law_params
from onboard.control import allocation, backstepping, pipeline, trajectory
from onboard.control.control_mode import ControlMode
from onboard.estimation import disturbance_observer, hover_thrust, kalman
from onboard.rollout.rows import Layout, Rows, floats, zero
from onboard.types import GRAVITY_M_S2, Goal, Neighbour, State, Tick
from onboard.vectors import ZERO_3, Vec3

Compiled = Callable[..., Any]

_MODULES: tuple[ModuleType, ...] = (
    *(vectors, frames, kalman, disturbance_observer, hover_thrust),
    *(trajectory, backstepping, allocation, pipeline),
    *(
        law_params,
        prediction,
        heights,
        pairs,
        half_planes,
        constraints,
        relaxation,
        projection,
        interface,
        oist,
        oist_paper,
    ),
)

_ZERO_PARAMS = zero(pipeline.PipelineParams)
STATE, GOAL, NEIGHBOUR, TICK = (
    Layout(zero(State)),
    Layout(zero(Goal)),
    Layout(zero(Neighbour)),
    Layout(zero(Tick)),
)
OBSTACLE, PARAMS = Layout(zero(law_params.Capsule)), Layout(_ZERO_PARAMS)
MEMORY = Layout(pipeline.initial(_ZERO_PARAMS, ZERO_3))
FILTER_PARAMS = Layout(kalman.KalmanParams())
FILTER = Layout(kalman.initial(ZERO_3, kalman.KalmanParams()))
_LAYOUTS = (STATE, GOAL, NEIGHBOUR, TICK, OBSTACLE, PARAMS, MEMORY, FILTER_PARAMS, FILTER)

_read_state, _read_goal, _read_neighbour, _read_obstacle = (
    STATE.read,
    GOAL.read,
    NEIGHBOUR.read,
    OBSTACLE.read,
)
_read_params, _read_memory, _write_memory, _write_tick = (
    PARAMS.read,
    MEMORY.read,
    MEMORY.write,
    TICK.write,
)
_read_filter_params, _read_filter, _write_filter = FILTER_PARAMS.read, FILTER.read, FILTER.write
_write_state = STATE.write


class PassRows(NamedTuple):
    """Inputs of one pass of the pipeline of many vehicles; neighbours may be missing."""

    states: Rows  # (..., N)
    goals: Rows  # (..., N)
    neighbours: Rows  # (..., N, K)
    is_present: BoolArray  # (..., N, K)
    modes: IntArray  # (..., N), of ControlMode


class Controller(Protocol):
    """A control of a whole batch: estimates, goals and neighbours in, every vehicle's attitude
    setpoint out.
    """

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks (F, N); states and goals are (F, N), neighbours and is_present (F, N,
        K).
        """

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""


class FleetPipeline:
    """The pipelines of all vehicles: a :class:`Controller`.

    Args:
        params: N of them.
        start_enu_m: (F, N, 3), where the vehicles hover [m].
        obstacles: the same for all.
    """

    def __init__(
        self,
        params: Sequence[pipeline.PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[law_params.Capsule] = (),
    ) -> None:
        self._params = PARAMS.packed(params)
        self._obstacles = OBSTACLE.packed(obstacles)
        self._memories = MEMORY.packed(
            [
                pipeline.initial(own, Vec3(*position))
                for flight in start_enu_m.tolist()
                for own, position in zip(params, flight, strict=True)
            ]
        ).reshape(start_enu_m.shape[:2])

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks of all vehicles in flight, see :class:`Controller`."""
        modes = np.full(states.shape, int(ControlMode.FLYING))
        inputs = PassRows(states, goals, neighbours, is_present, modes)
        return step(self._memories, inputs, self._obstacles, self._params, dt_s)

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._memories = self._memories[flights]


class FleetEstimator:
    """The filters of all vehicles, hovering at the start.

    Args:
        params: N of them.
        start_enu_m: (F, N, 3), known positions [m].
    """

    def __init__(self, params: Sequence[kalman.KalmanParams], start_enu_m: Array) -> None:
        self._params = FILTER_PARAMS.packed(params)
        self._memories = FILTER.packed(
            [
                kalman.initial(Vec3(*position), own)
                for flight in start_enu_m.tolist()
                for own, position in zip(params, flight, strict=True)
            ]
        ).reshape(start_enu_m.shape[:2])
        self._memories["thrust_m_s2"] = GRAVITY_M_S2

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
            quaternion_wxyz: attitude flown (F, N, 4), FLU to ENU.
            thrust_frac: throttle sent last (F, N). hover_thrust_frac: throttle that carries the
                weight (F, N).
            sample_enu_m: measured positions (F, N, 3) of ``age_s`` ago. yaw_rad: headings (F, N).
        """
        shape = self._memories.shape
        inputs = np.empty((*shape, 10))
        inputs[..., :4], inputs[..., 4], inputs[..., 5] = (
            quaternion_wxyz,
            thrust_frac,
            hover_thrust_frac,
        )
        inputs[..., 6:9], inputs[..., 9] = sample_enu_m, yaw_rad
        states = STATE.rows(shape)
        flat = inputs.reshape(self._memories.size, 10)
        _loops()[1](_flat(self._memories), flat, floats(self._params), _flat(states), age_s, dt_s)
        return states

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._memories = self._memories[flights]


def step(memories: Rows, inputs: PassRows, obstacles: Rows, params: Rows, dt_s: float) -> Rows:
    """Return the ticks of many vehicles: ``pipeline.step`` of each.

    Args:
        memories: (..., N), changed in place.
        inputs: of each vehicle.
        obstacles: (O,), the same for all.
        params: (N,).
        dt_s: length of the tick [s].
    """
    ticks = TICK.rows(inputs.states.shape)
    size, most = ticks.size, inputs.neighbours.shape[-1]
    flat = (
        _flat(inputs.states),
        _flat(inputs.goals),
        floats(inputs.neighbours).reshape(size, most, NEIGHBOUR.width),
        # an array that may not be written is of another type, for which all would be compiled once
        # more
        np.require(inputs.is_present, requirements=["C", "W"]).reshape(size, most),
        np.require(inputs.modes, np.int64, ["C", "W"]).reshape(size),
    )
    _loops()[0](_flat(memories), flat, floats(obstacles), floats(params), _flat(ticks), dt_s)
    return ticks


def message(states: Rows, ticks: Rows | None) -> Rows:
    """Return what each vehicle publishes, as rows of Neighbour; before the first tick it commands
    nothing and stays.

    Args:
        states: (F, N). ticks: (F, N) of the pipeline.
    """
    out = NEIGHBOUR.rows(states.shape)
    for name in (
        "position_enu_m",
        "velocity_enu_m_s",
        "acceleration_enu_m_s2",
        "position_std_m",
        "velocity_std_m_s",
    ):
        out[name] = states[name]
    out["is_cooperative"] = 1.0
    if ticks is None:
        out["predicted_position_enu_m"] = states["position_enu_m"]
        return out
    law = ticks["law"]
    names = (
        "predicted_position_enu_m",
        "predicted_velocity_enu_m_s",
        "commanded_acceleration_enu_m_s2",
    )
    for name in (*names, "intent_enu_m_s", "lead_time_s", "crowd_count"):
        out[name] = law[name]
    return out


def all_others(count: int) -> IntArray:
    """Return the senders (N, N - 1) where every vehicle hears every other one."""
    return np.array(
        [[j for j in range(count) if j != i] for i in range(count)], dtype=np.int64
    ).reshape(count, -1)


def received(inbox: Rows, age_s: Array, senders: IntArray, is_cooperative: BoolArray) -> Rows:
    """Return the neighbours (F, N, K) from the newest messages (F, receiver, sender).

    Args:
        inbox: rows of :func:`message`.
        age_s, is_cooperative: (F, receiver, sender).
        senders: (N, K) or (F, N, K), those that each receiver regards.
    """
    flights, count = inbox.shape[:2]
    receiver = np.arange(count)[:, None]
    index = (
        np.arange(flights)[:, None, None],
        receiver,
        np.broadcast_to(senders, (flights, *senders.shape[-2:])),
    )
    neighbours: Rows = floats(inbox)[index].view(NEIGHBOUR.dtype)[..., 0]
    neighbours["age_s"], neighbours["is_cooperative"] = age_s[index], is_cooperative[index]
    neighbours["is_paper_obstacle"] = index[2] == (receiver + 1) % count
    neighbours["table_index"] = np.arange(senders.shape[-1])
    return neighbours


def is_compiled() -> bool:
    """Whether batches run compiled: numba is installed, and ``COVEY_NUMBA`` is not 0."""
    return _numba() is not None


def warm_up() -> bool:
    """Compile, or load from numba's cache, all that batches use; False when nothing is to be
    compiled.

    Takes about a second from the cache, and some twenty seconds of a processor the first time on a
    machine.
    """
    if not is_compiled():
        return False
    nobody, none = np.zeros((0, 1)), np.zeros((0, 1, 1))  # types decide what is compiled, not sizes
    states = FleetEstimator([kalman.KalmanParams()], none).step(
        none, nobody, nobody, none, nobody, 0.0, 0.0
    )
    pilots = FleetPipeline([_ZERO_PARAMS], none)
    pilots.step(states, GOAL.rows((0, 1)), NEIGHBOUR.rows((0, 1, 1)), none > 0.0, 0.0)
    return True


def _flat(rows: Rows) -> Array:
    """Return the numbers (size, width); the rows must be contiguous where they are written."""
    return floats(rows).reshape(rows.size, rows.dtype.itemsize // 8)


def _step_rows(
    memories: Any, inputs: Any, obstacles: Any, params: Any, ticks: Any, dt_s: float
) -> None:
    walls = [_read_obstacle(obstacles[k]) for k in range(obstacles.shape[0])]
    states, goals, neighbours, is_present, modes = inputs
    count = params.shape[0]
    for m in range(memories.shape[0]):
        near = [
            _read_neighbour(neighbours[m, k])
            for k in range(neighbours.shape[1])
            if is_present[m, k]
        ]
        memory, tick = pipeline.step(
            _read_memory(memories[m]),
            _read_state(states[m]),
            _read_goal(goals[m]),
            near,
            walls,
            modes[m],
            _read_params(params[m % count]),
            dt_s,
        )
        _write_memory(memory, memories[m])
        _write_tick(tick, ticks[m])


def _estimate_rows(
    memories: Any, inputs: Any, params: Any, states: Any, age_s: float, dt_s: float
) -> None:
    count = params.shape[0]
    for m in range(memories.shape[0]):
        own, i = _read_filter_params(params[m % count]), inputs[m]
        memory = kalman.drive(
            _read_filter(memories[m]), (i[0], i[1], i[2], i[3]), i[4], i[5], own, dt_s, False
        )
        memory = kalman.correct(memory, Vec3(i[6], i[7], i[8]), age_s, own)
        _write_filter(memory, memories[m])
        _write_state(kalman.state(memory, i[9], 0.0, 0.0), states[m])


@lru_cache(maxsize=1)
def _numba() -> Any:
    """Return the module, or None where nothing is to be compiled."""
    if os.environ.get("COVEY_NUMBA", "") == "0":
        return None
    try:
        import numba
    except ImportError:
        return None
    return numba


@lru_cache(maxsize=1)
def _loops() -> tuple[Compiled, Compiled]:
    """Return the loops of the pipeline and of the filter, compiled where possible."""
    numba = _numba()
    if numba is None:
        return _step_rows, _estimate_rows
    # none of these is called from Python: without wrappers they compile faster
    register = numba.extending.register_jitable(no_cpython_wrapper=True, no_cfunc_wrapper=True)
    for function in _functions():
        register(function)
    version = _digest()
    return _jit(numba, _step_rows, version), _jit(numba, _estimate_rows, version)


def _jit(numba: Any, function: Compiled, version: int) -> Compiled:
    """Return the function compiled on first use, or loaded from numba's cache."""

    def run(*arguments: Any) -> int:
        function(*arguments)
        return version  # numba looks for its cached code by the values in this closure

    options = {"nogil": True, "fastmath": False}
    try:
        return numba.njit(cache=True, **options)(run)  # type: ignore[no-any-return]
    except RuntimeError:  # no folder to keep the code in
        return numba.njit(**options)(run)  # type: ignore[no-any-return]


def _functions() -> list[FunctionType]:
    """Return all functions that compiled code may call."""
    named = [
        f for m in _MODULES for f in vars(m).values() if getattr(f, "__module__", "") == m.__name__
    ]
    own = [
        *named,
        *(f for layout in _LAYOUTS for f in (layout.read, layout.write)),
        _step_rows,
        _estimate_rows,
    ]
    return [f for f in own if isinstance(f, FunctionType)]


def _digest() -> int:
    """Return a number that changes with any of these functions: numba itself compares one file
    only.
    """
    numbers = [
        item
        for m in _MODULES
        for item in sorted(vars(m).items())
        if isinstance(item[1], (int, float, tuple))
    ]
    code = b"".join(marshal.dumps(f.__code__) for f in _functions())
    return zlib.crc32(code + repr((numbers, [layout.dtype for layout in _LAYOUTS])).encode())
