"""Ticks of many agents at one instant: passes of the pipeline with equal parameters are computed together.

The pipeline takes leading batch axes, and a batch gives what a loop gives; so the price of each call of numpy is
paid once for all agents. The stacked memories stay stacked as long as the same agents tick together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from onboard.agent.control_step import PipelineInputs
from onboard.control import pipeline
from onboard.control.pipeline import PipelineMemory, PipelineParams
from sitl.lockstep.agents import AgentShell, Hall

Leaves = tuple[Any, ...]


class Stacker:
    """Stacks frozen values of one kind along a new first axis, and takes them apart again."""

    def __init__(self, example: Any) -> None:
        names: list[str] = []
        kinds: dict[str, Any] = {}
        text = _constructor(example, "", names, kinds)
        self._build: Callable[[Sequence[Any]], Any] = eval(f"lambda leaves: {text}", kinds)
        self._leaves: Callable[[Any], Any] = attrgetter(*names)

    def stack(self, values: Sequence[Any]) -> Any:
        """(N, ...) of N values (...)."""
        columns = zip(*map(self._leaves, values), strict=True)
        return self._build([np.array(column) for column in columns])

    def row(self, stacked: Any, place: int) -> Any:
        """One value (...) of an (N, ...)."""
        return self._build([leaf[place] for leaf in self._leaves(stacked)])

    def rows(self, stacked: Any) -> list[Any]:
        """N values (...) of one (N, ...)."""
        return list(map(self._build, zip(*self._leaves(stacked), strict=True)))


def _constructor(example: Any, prefix: str, names: list[str], kinds: dict[str, Any]) -> str:
    """The expression that makes a value of ``leaves``; notes the dotted names of the leaves in their order, and kinds.

    One expression for the whole tree, because walking it for every agent at every tick takes as long as filling it.
    """
    if not is_dataclass(example):
        names.append(prefix[:-1])
        return f"leaves[{len(names) - 1}]"
    kind = type(example)
    kinds[kind.__name__] = kind
    parts = [_constructor(getattr(example, f.name), f"{prefix}{f.name}.", names, kinds) for f in fields(example)]
    return f"{kind.__name__}({', '.join(parts)})"


@dataclass(frozen=True, slots=True)
class _Row:
    """An agent's memory as its core keeps it between two ticks: a place in a stacked one, taken out when it must be."""

    stacked: PipelineMemory
    place: int

    def __getattr__(self, name: str) -> Any:
        part = getattr(self.stacked, name)
        return stacker_of(part).row(part, self.place) if is_dataclass(part) else part[self.place]

    def taken_out(self) -> Any:
        """The memory by itself."""
        return stacker_of(self.stacked).row(self.stacked, self.place)


_stackers: dict[type, Stacker] = {}


def stacker_of(example: Any) -> Stacker:
    """The stacker for values of this kind, made once."""
    found = _stackers.get(type(example))
    if found is None:
        found = _stackers[type(example)] = Stacker(example)
    return found


class Batch:
    """Runs the passes that are due together.

    Args:
        hall: holds the agents' tables; None runs the passes one by one.
    """

    def __init__(self, hall: Hall | None) -> None:
        self._hall = hall
        self._kinds: list[PipelineParams] = []
        self._known: dict[str, tuple[PipelineParams, int]] = {}

    def tick(self, agents: Sequence[AgentShell], now_ns: int) -> None:
        """One tick of each agent; what one publishes is heard by the others in later ticks."""
        passes = [agent.begin_tick(now_ns) for agent in agents]
        groups: dict[Any, list[int]] = {}
        for place, (agent, due) in enumerate(zip(agents, passes, strict=True)):
            key = (self._kind(agent), due.phase, due.dt_s) if self._hall is not None else place
            groups.setdefault(key, []).append(place)
        results: list[Any] = [None] * len(agents)
        for places in groups.values():
            params, dues = agents[places[0]].core.params, [passes[place] for place in places]
            together = self._together(params, dues) if len(dues) > 1 else [_alone(params, dues[0])]
            for place, result in zip(places, together, strict=True):
                results[place] = result
        for agent, (memory, tick) in zip(agents, results, strict=True):
            agent.end_tick(memory, tick, now_ns)

    def _kind(self, agent: AgentShell) -> int:
        """A number that is equal for equal parameters."""
        params = agent.core.params
        known = self._known.get(agent.name)
        if known is None or known[0] is not params:
            if params not in self._kinds:
                self._kinds.append(params)
            known = self._known[agent.name] = params, self._kinds.index(params)
        return known[1]

    def _together(self, params: PipelineParams, dues: list[PipelineInputs]) -> list[Any]:
        first = dues[0]
        assert self._hall is not None
        memory, tick = pipeline.step(
            self._stacked_memory(dues),
            _stack("state", dues),
            _stack("goal", dues),
            self._hall.snapshots([due.table for due in dues], first.now_ns),
            params=params,
            dt_s=first.dt_s,
            phase=first.phase,
        )
        ticks = stacker_of(tick).rows(tick)
        return [(_Row(memory, place), row) for place, row in enumerate(ticks)]

    def _stacked_memory(self, dues: list[PipelineInputs]) -> PipelineMemory:
        """As it is when the same agents ticked together last time, else put together anew."""
        held: list[Any] = [due.memory for due in dues]
        first = held[0]
        if isinstance(first, _Row) and len(first.stacked.clock_rate) == len(held):
            stacked = first.stacked
            if all(
                isinstance(one, _Row) and one.stacked is stacked and one.place == place
                for place, one in enumerate(held)
            ):
                return stacked
        whole = [_taken_out(memory) for memory in held]
        together: PipelineMemory = stacker_of(whole[0]).stack(whole)
        return together


def _alone(params: PipelineParams, due: PipelineInputs) -> Any:
    return pipeline.step(
        _taken_out(due.memory),
        due.state,
        due.goal,
        due.neighbours,
        params=params,
        dt_s=due.dt_s,
        phase=due.phase,
    )


def _taken_out(memory: Any) -> Any:
    return memory.taken_out() if isinstance(memory, _Row) else memory


def _stack(name: str, dues: list[PipelineInputs]) -> Any:
    values = [getattr(due, name) for due in dues]
    return stacker_of(values[0]).stack(values)
