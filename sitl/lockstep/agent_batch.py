"""Ticks of many agents at one instant.

Where it is compiled, the pipeline runs over all of them at once (:mod:`onboard.rollout.batch`), and
their memories stay in rows as long as the same agents tick together. Otherwise they tick one after
the other, each as on a drone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec.structs import replace

from onboard.agent.control_step import PipelineInputs
from onboard.control.pipeline import PipelineMemory, PipelineParams
from onboard.rollout import batch
from onboard.rollout.rows import Rows
from onboard.types import Tick
from sitl.lockstep.agents import AgentShell, FleetTables


@dataclass(frozen=True, slots=True)
class _RowMemory:
    """An agent's memory as its core keeps it between two ticks: a row among others, read when it is
    needed.
    """

    rows: Rows
    index: int

    def __getattr__(self, name: str) -> Any:
        return getattr(self.value(), name)

    def value(self) -> PipelineMemory:
        """Return the memory by itself."""
        memory: PipelineMemory = batch.MEMORY.values(self.rows[self.index : self.index + 1])[0]
        return memory


class Batch:
    """Runs the passes that are due together; a law of somebody's own is interpreted, agent by
    agent.

    Args:
        tables: holds the agents' tables; None runs the passes one by one.
    """

    def __init__(self, tables: FleetTables | None) -> None:
        self._tables = tables if batch.is_compiled() else None
        self._params: tuple[list[PipelineParams], Rows] = [], batch.PARAMS.rows(0)

    def tick(self, agents: Sequence[AgentShell], now_ns: int) -> None:
        """One tick of each agent; a message that one publishes is heard by the others in later
        ticks.
        """
        passes = [agent.begin_tick(now_ns) for agent in agents]
        # not so after one of them has stood still
        is_together = len({due.dt_s for due in passes}) == 1
        is_compiled = self._tables is not None and all(
            agent.fleet.own_law is None for agent in agents
        )
        if self._tables is not None and is_compiled and is_together and len(agents) > 1:
            results = self._together(self._tables, agents, passes)
        else:
            results = [_alone(agent, due) for agent, due in zip(agents, passes, strict=True)]
        for agent, (memory, tick) in zip(agents, results, strict=True):
            agent.end_tick(memory, tick, now_ns)

    def _together(
        self, tables: FleetTables, agents: Sequence[AgentShell], passes: list[PipelineInputs]
    ) -> list[tuple[Any, Tick]]:
        memories = _rows_of([due.memory for due in passes])
        neighbours, is_present = tables.snapshots([due.table for due in passes], passes[0].now_ns)
        inputs = batch.PassRows(
            batch.STATE.packed([due.state for due in passes]),
            batch.GOAL.packed([due.goal for due in passes]),
            neighbours,
            is_present,
            np.array([int(due.phase) for due in passes]),
        )
        walls = batch.OBSTACLE.packed(agents[0].core.control.obstacles)
        ticks = batch.step(memories, inputs, walls, self._params_of(agents), passes[0].dt_s)
        values = batch.TICK.values(ticks)
        return [(_RowMemory(memories, index), tick) for index, tick in enumerate(values)]

    def _params_of(self, agents: Sequence[AgentShell]) -> Rows:
        """Return the rows of the agents' parameters, made once for the same agents."""
        params = [agent.core.params for agent in agents]
        known, rows = self._params
        if len(known) != len(params) or any(
            one is not other for one, other in zip(known, params, strict=True)
        ):
            rows = batch.PARAMS.packed(params)
            self._params = params, rows
        return rows


def _rows_of(memories: list[Any]) -> Rows:
    """Return the memories as rows: those of the last tick when the same agents tick together again."""
    first = memories[0]
    if isinstance(first, _RowMemory) and len(first.rows) == len(memories):
        is_same = (isinstance(one, _RowMemory) and one.rows is first.rows for one in memories)
        if all(is_same) and all(one.index == index for index, one in enumerate(memories)):
            return first.rows
    return batch.MEMORY.packed([_value(memory) for memory in memories])


def _alone(agent: AgentShell, due: PipelineInputs) -> tuple[PipelineMemory, Tick]:
    return agent.core.control.run(replace(due, memory=_value(due.memory)))


def _value(memory: Any) -> PipelineMemory:
    return memory.value() if isinstance(memory, _RowMemory) else memory
