"""The pipeline of the agents in lockstep, compiled: the same text as on a drone, some times faster.

An agent calls it like :func:`onboard.control.pipeline.step` and gets what that returns. Inside, the
values are written to rows of floats, :mod:`onboard.rollout.batch` runs its compiled loop over the
one row, and the results are read from the rows again. Where numba is not installed, the text is
interpreted.

What an agent hands over again unchanged keeps its row. The neighbours of a snapshot are rows
already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.avoidance.params import Capsule
from onboard.control import pipeline
from onboard.control.pipeline import PipelineMemory, PipelineParams
from onboard.neighbours.state_arrays import NeighbourSnapshot
from onboard.rollout import batch
from onboard.rollout.rows import Rows
from onboard.types import Goal, Neighbour, State, Tick


@dataclass(slots=True)
class _Agent:
    """The memory of one agent, and the row that holds it."""

    memory: PipelineMemory
    memory_row: Rows


class CompiledPipeline:
    """A pipeline step that is compiled, or interpreted as on a drone.

    Args:
        is_wanted: False interprets every pass; the values differ by rounding only.
    """

    def __init__(self, *, is_wanted: bool = True) -> None:
        self._can_compile = is_wanted and batch.is_compiled()
        self._compiles_this_tick = False
        # by the identity of the memory returned last: an agent hands its own back unchanged
        self._agents: dict[int, _Agent] = {}
        # rows of what stays the same from tick to tick, by the identity of the values
        self._params: dict[int, tuple[PipelineParams, Rows]] = {}
        self._obstacles: dict[int, tuple[Sequence[Capsule], Rows]] = {}

    def begin_tick(self, periods_ns: Sequence[int]) -> None:
        """Choose how the passes of this tick are calculated.

        They are compiled where several agents tick, all after the same time. A single agent, and
        all agents in the tick in which one of them has stood still before, are interpreted: so both
        ways are flown, and each flight repeats itself to the last bit.

        Args:
            periods_ns: of each agent that ticks, the time since its last tick.
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
            agent = _Agent(memory, batch.MEMORY.packed([memory]))

        inputs = batch.PassRows(
            states=batch.STATE.packed([state]),
            goals=batch.GOAL.packed([goal]),
            neighbours=_neighbour_rows(neighbours)[np.newaxis],
            is_present=np.ones((1, len(neighbours)), dtype=bool),
            modes=np.array([int(mode)]),
        )
        ticks = batch.step(
            agent.memory_row, inputs, self._obstacle_rows(obstacles), self._params_row(params), dt_s
        )

        (agent.memory,) = batch.MEMORY.values(agent.memory_row)
        (tick,) = batch.TICK.values(ticks)
        self._agents[id(agent.memory)] = agent
        return agent.memory, tick

    def _params_row(self, params: PipelineParams) -> Rows:
        known = self._params.get(id(params))
        if known is None:
            known = (params, batch.PARAMS.packed([params]))
            self._params[id(params)] = known
        return known[1]

    def _obstacle_rows(self, obstacles: Sequence[Capsule]) -> Rows:
        known = self._obstacles.get(id(obstacles))
        if known is None:
            known = (obstacles, batch.OBSTACLE.packed(obstacles))
            self._obstacles[id(obstacles)] = known
        return known[1]


def _neighbour_rows(neighbours: Sequence[Neighbour]) -> Rows:
    if isinstance(neighbours, NeighbourSnapshot):
        rows: Rows = neighbours.rows.view(batch.NEIGHBOUR.dtype)[:, 0]
        return rows
    return batch.NEIGHBOUR.packed(neighbours)
