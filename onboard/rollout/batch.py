"""Runs one tick of many vehicles at once, with the drone's own control pipeline and Kalman filter.

Arrays are (F, N): F flights of N vehicles. Each vehicle has one row of floats
(:mod:`onboard.rollout.rows`), and a neighbour of a vehicle has one too: (F, N, K). The loops over
all vehicles are in :mod:`onboard.rollout.loops`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.params import Capsule
from onboard.constants import GRAVITY_M_S2
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.estimation import kalman, wind
from onboard.rollout import layouts
from onboard.rollout.fleet_routes import FleetRoutes
from onboard.rollout.layouts import EstimatorMemory
from onboard.rollout.loops import is_compiled, loops
from onboard.rollout.rows import Rows, floats
from onboard.vectors import Vec3

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
        obstacles: Sequence[Capsule] = (),
    ) -> None:
        self._params = layouts.PARAMS.packed(params)
        self._obstacles = layouts.OBSTACLE.packed(obstacles)
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
        self._params = layouts.FILTER_PARAMS.packed(params)

        memories = []
        for positions_enu_m in start_enu_m.tolist():
            for own_params, position in zip(params, positions_enu_m, strict=True):
                motion = kalman.initial(Vec3(*position), own_params)
                memories.append(EstimatorMemory(motion, wind.initial()))
        self._memories = layouts.FILTER.packed(memories).reshape(start_enu_m.shape[:2])
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

        states = layouts.STATE.rows(shape)
        loops().estimate(
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
    return layouts.MEMORY.packed(memories).reshape(start_enu_m.shape[:2])


def step(memories: Rows, inputs: PassRows, obstacles: Rows, params: Rows, dt_s: float) -> Rows:
    """Return the ticks (..., N) of many vehicles: the result of ``pipeline.step`` for each.

    Args:
        memories: memories (..., N) of the pipelines, which are changed in place.
        inputs: inputs of each vehicle.
        obstacles: static obstacles (O,), the same for all.
        params: parameters (N,) of the vehicles.
        dt_s: length of the tick [s].
    """
    ticks = layouts.TICK.rows(inputs.states.shape)
    loops().step(
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
        covey=layouts.COVEY_RESULTS.rows(shape[:-1]),
        views=layouts.OWN_LAW_VIEW.rows(shape[:-1]),
        neighbours=layouts.LAW_NEIGHBOUR.rows(shape),
        neighbour_counts=np.zeros(shape[:-1], np.int64),
    )
    loops().before_own_law(
        _flat(memories),
        relaxed_shares.reshape(-1),
        _flat_inputs(inputs),
        floats(obstacles),
        floats(params),
        _flat(result.covey),
        _flat(result.views),
        floats(result.neighbours).reshape(memories.size, shape[-1], layouts.LAW_NEIGHBOUR.width),
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
    ticks = layouts.TICK.rows(inputs.states.shape)
    loops().after_own_law(
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
        floats(inputs.neighbours).reshape(size, neighbour_count, layouts.NEIGHBOUR.width),
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
    out = layouts.NEIGHBOUR.rows(states.shape)
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

    neighbours: Rows = floats(inbox)[index].view(layouts.NEIGHBOUR.dtype)[..., 0]
    neighbours["age_s"] = age_s[index]
    neighbours["is_cooperative"] = is_cooperative[index]
    # with the paper's law, each vehicle avoids the next one, and the last vehicle avoids the first
    neighbours["is_paper_obstacle"] = sender == (receiver + 1) % vehicle_count
    neighbours["table_index"] = np.arange(senders.shape[-1])
    return neighbours


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

    controller = FleetPipeline([layouts.ZERO_PARAMS], no_vectors)
    goals = layouts.GOAL.rows((0, 1))
    neighbours = layouts.NEIGHBOUR.rows((0, 1, 1))
    is_present = no_vectors > 0.0
    controller.step(states, goals, neighbours, is_present, dt_s=0.0)
    if not has_own_law:
        return True

    inputs = PassRows(states, goals, neighbours, is_present, modes=np.zeros((0, 1), np.int64))
    memories = layouts.MEMORY.rows((0, 1))
    obstacles = layouts.OBSTACLE.packed([])
    params = layouts.PARAMS.packed([layouts.ZERO_PARAMS])
    before = before_own_law(memories, no_numbers, inputs, obstacles, params, dt_s=0.0)
    is_own = no_numbers > 0.0
    after_own_law(memories, no_numbers, before, no_vectors, is_own, inputs, params, dt_s=0.0)
    return True


def _flat(rows: Rows) -> Array:
    """Return the numbers (size, width) of rows; contiguous rows share their memory with them."""
    return floats(rows).reshape(rows.size, rows.dtype.itemsize // 8)
