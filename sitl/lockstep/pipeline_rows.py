"""The agents' pipeline in lockstep: the same code as on a drone, but compiled and thus faster.

The pipeline computes the setpoint of a tick: trajectory, avoidance law, attitude and thrust. An
agent calls it like :func:`onboard.control.pipeline.step` and gets the same result. Inside, the
values are written to rows of floats, the compiled loop of :mod:`onboard.rollout.loops` runs over
them, and the result is read from the rows again. If numba is not installed, Python interprets the
pipeline.

If an agent passes the same values again, their rows are reused. The neighbours in a snapshot are
already rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.avoidance.params import Capsule
from onboard.control import pipeline
from onboard.control.pipeline import PipelineMemory, PipelineParams
from onboard.neighbours.state_arrays import NeighbourSnapshot
from onboard.rollout import batch, layouts, loops
from onboard.rollout.rows import Rows
from onboard.types import Goal, Neighbour, State, Tick


@dataclass(slots=True)
class _Agent:
    """The memory of one agent, and the row that holds it."""

    memory: PipelineMemory
    memory_row: Rows


class CompiledPipeline:
    """A pipeline step, either compiled or interpreted as on a drone.

    Args:
        is_wanted: whether passes may be compiled; if False, every pass is interpreted, and the
            values differ by rounding only.
    """

    def __init__(self, *, is_wanted: bool = True) -> None:
        self._can_compile = is_wanted and loops.is_compiled()
        self._compiles_this_tick = False
        # id() of the memory that a pass returned -> its agent, which passes this memory at its next
        # tick
        self._agents: dict[int, _Agent] = {}
        # id() of values that stay the same from tick to tick -> these values and their rows
        self._params: dict[int, tuple[PipelineParams, Rows]] = {}
        self._obstacles: dict[int, tuple[Sequence[Capsule], Rows]] = {}

    def begin_tick(self, periods_ns: Sequence[int]) -> None:
        """Choose whether the passes of this tick are compiled or interpreted.

        They are compiled if several agents tick, and all of them after the same period. They are
        interpreted for a single agent, and for all agents if one of them has stalled. Both forms
        are therefore flown, and each flight is repeatable to the last bit.

        Args:
            periods_ns: time since the last tick of each agent that ticks.
        """
        is_even = len(set(periods_ns)) == 1
        self._compiles_this_tick = self._can_compile and is_even and len(periods_ns) > 1

    def step(
        self,
        memory: PipelineMemory,
        state: State,
        goal: Goal,
        neighbours: Sequence[Neighbour],
        obstacles: Sequence[Capsule],
        mode: int,
        params: PipelineParams,
        dt_s: float,
    ) -> tuple[PipelineMemory, Tick]:
        """Return what :func:`onboard.control.pipeline.step` returns for the same arguments."""
        if not self._compiles_this_tick:
            return pipeline.step(memory, state, goal, neighbours, obstacles, mode, params, dt_s)

        agent = self._agents.pop(id(memory), None)
        if agent is None:
            agent = _Agent(memory, layouts.MEMORY.packed([memory]))

        inputs = batch.PassRows(
            states=layouts.STATE.packed([state]),
            goals=layouts.GOAL.packed([goal]),
            neighbours=_neighbour_rows(neighbours)[np.newaxis],
            is_present=np.ones((1, len(neighbours)), dtype=bool),
            modes=np.array([int(mode)]),
        )
        ticks = batch.step(
            agent.memory_row, inputs, self._obstacle_rows(obstacles), self._params_row(params), dt_s
        )

        (agent.memory,) = layouts.MEMORY.values(agent.memory_row)
        (tick,) = layouts.TICK.values(ticks)
        self._agents[id(agent.memory)] = agent
        return agent.memory, tick

    def _params_row(self, params: PipelineParams) -> Rows:
        known = self._params.get(id(params))
        if known is None:
            known = (params, layouts.PARAMS.packed([params]))
            self._params[id(params)] = known
        _, rows = known
        return rows

    def _obstacle_rows(self, obstacles: Sequence[Capsule]) -> Rows:
        known = self._obstacles.get(id(obstacles))
        if known is None:
            known = (obstacles, layouts.OBSTACLE.packed(obstacles))
            self._obstacles[id(obstacles)] = known
        _, rows = known
        return rows


def _neighbour_rows(neighbours: Sequence[Neighbour]) -> Rows:
    if isinstance(neighbours, NeighbourSnapshot):
        rows: Rows = neighbours.rows.view(layouts.NEIGHBOUR.dtype)[:, 0]
        return rows
    return layouts.NEIGHBOUR.packed(neighbours)
