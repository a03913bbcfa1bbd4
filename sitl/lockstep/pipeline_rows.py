"""The pipeline of the agents in lockstep, compiled: the same text as on a drone, some times faster.

An agent calls it like :func:`onboard.control.pipeline.step` and gets what that returns. Inside, the
values are written to rows of floats, :mod:`onboard.rollout.batch` runs its compiled loop over the
one row, and the results are read from the rows again. Where numba is not installed, the text is
interpreted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.avoidance.params import Capsule
from onboard.control import pipeline
from onboard.control.pipeline import PipelineMemory, PipelineParams
from onboard.rollout import batch
from onboard.rollout.rows import Rows
from onboard.types import Goal, Neighbour, State, Tick


class CompiledPipeline:
    """A pipeline step that is compiled, or interpreted as on a drone.

    Args:
        is_wanted: False interprets every pass; the values differ by rounding only.
    """

    def __init__(self, *, is_wanted: bool = True) -> None:
        self._can_compile = is_wanted and batch.is_compiled()
        self._compiles_this_tick = False
        # rows of the memories returned last, by identity: an agent hands its own back unchanged
        self._memories: dict[int, tuple[PipelineMemory, Rows]] = {}
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

        memories = self._memory_row(memory)
        inputs = batch.PassRows(
            states=batch.STATE.packed([state]),
            goals=batch.GOAL.packed([goal]),
            neighbours=batch.NEIGHBOUR.packed(neighbours)[np.newaxis],
            is_present=np.ones((1, len(neighbours)), dtype=bool),
            modes=np.array([int(mode)]),
        )
        ticks = batch.step(
            memories, inputs, self._obstacle_rows(obstacles), self._params_row(params), dt_s
        )

        (after,) = batch.MEMORY.values(memories)
        (tick,) = batch.TICK.values(ticks)
        self._memories[id(after)] = (after, memories)
        return after, tick

    def _memory_row(self, memory: PipelineMemory) -> Rows:
        known = self._memories.pop(id(memory), None)
        if known is None:
            return batch.MEMORY.packed([memory])
        return known[1]

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
