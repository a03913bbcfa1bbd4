"""Ticks of many agents at one instant."""

from __future__ import annotations

from collections.abc import Sequence

from onboard.control import pipeline
from sitl.lockstep.agents import AgentShell


class Batch:
    """Runs the passes that are due together."""

    def __init__(self, is_batched: bool) -> None:
        self.is_batched = is_batched

    def tick(self, agents: Sequence[AgentShell], now_ns: int) -> None:
        """One tick of each agent; what one publishes is heard by the others in later ticks."""
        passes = [agent.begin_tick(now_ns) for agent in agents]
        for agent, due in zip(agents, passes, strict=True):
            memory, tick = pipeline.step(
                due.memory,
                due.state,
                due.goal,
                due.neighbours,
                params=agent.core.params,
                dt_s=due.dt_s,
                phase=due.phase,
            )
            agent.end_tick(memory, tick, now_ns)
