"""The pipeline of one vehicle with a law of somebody's own in the place of Covey's.

Covey's law is computed beside it at every tick. It takes over for the rest of the flight when the
other one raises, returns what cannot be flown, or is slow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from onboard.avoidance import interface, oist
from onboard.avoidance.own_law import flown_instead, judged, law_inputs
from onboard.avoidance.params import Capsule
from onboard.config.fleet import OwnLaw
from onboard.control import pipeline
from onboard.control.pipeline import Phase, PipelineMemory, PipelineParams
from onboard.types import Goal, Neighbour, State, Tick
from onboard.vectors import Vec3

# so long in so many ticks in a row is slow, or once so long
SLOW_S, SLOW_TICKS, STOPPED_S = 0.005, 3, 0.1
_LONGEST_WORDS = 120  # of an exception, in a sentence


class OwnLawPipeline:
    """Memory of one vehicle's law, and why Covey's has taken over.

    Args:
        law: that the fleet file names.
        clock: seconds, by which the law's time is measured; None where time is simulated, and no
            law is slow.
    """

    def __init__(self, law: OwnLaw, clock: Callable[[], float] | None = None) -> None:
        self.law = law
        self.refusal = ""  # why Covey's law flies the rest of this flight; empty: it does not
        self._clock = clock
        self._memory: Any = None
        self._slow_ticks = 0

    def step(
        self,
        memory: PipelineMemory,
        state: State,
        goal: Goal,
        neighbours: Sequence[Neighbour],
        obstacles: Sequence[Capsule],
        phase: int,
        params: PipelineParams,
        dt_s: float,
    ) -> tuple[PipelineMemory, Tick]:
        """One tick, as :func:`onboard.control.pipeline.step`; on the ground the law begins anew.

        Args:
            memory: of the last tick.
            state: own estimate.
            goal: of the order being flown.
            neighbours: a snapshot of those that are known.
            obstacles: what stands still.
            phase: a Phase.
            params: of the vehicle.
            dt_s: length of the tick.
        """
        if phase == Phase.GROUND:
            self.refusal, self._memory, self._slow_ticks = "", None, 0
        if phase == Phase.GROUND or self.refusal:
            return pipeline.step(memory, state, goal, neighbours, obstacles, phase, params, dt_s)
        # that Covey's law would be in a jam does not slow down who flies by another one
        alone = memory._replace(law=memory.law._replace(relaxed_share=0.0))
        before = pipeline.before_law(alone, state, goal, phase, params, dt_s)
        law_memory, output = oist.step(
            memory.law,
            before.baseline,
            before.motion,
            state,
            neighbours,
            obstacles,
            params.law,
            dt_s,
        )
        # then nobody knows enough, and Covey's law is cautious
        if output.status != interface.INFEASIBLE:
            given = law_inputs(
                before.baseline, before.motion, state, neighbours, obstacles, params.law, dt_s
            )
            self._memory, thrust, self.refusal = self._asked(given)
            if not self.refusal:
                law_memory, output = flown_instead(thrust, output, law_memory, memory.law, given)
        return pipeline.after_law(memory, before, law_memory, output, state, goal, params, dt_s)

    def _asked(self, given: Any) -> tuple[Any, Vec3, str]:
        """Return the law's memory and thrust, and why it cannot be flown."""
        began_s = self._clock() if self._clock is not None else 0.0
        try:
            memory, thrust, refusal = judged(self.law.function(self._memory, given), given)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - whatever somebody's law does
            memory, thrust, refusal = (
                None,
                given.baseline.thrust_enu_m_s2,
                f"raised {_words(error)}",
            )
        if self._clock is not None and not refusal:
            refusal = self._slow(self._clock() - began_s)
        return memory, thrust, refusal

    def _slow(self, took_s: float) -> str:
        """Return why a law that took so long is refused; empty if it is not."""
        self._slow_ticks = self._slow_ticks + 1 if took_s > SLOW_S else 0
        if took_s <= STOPPED_S and self._slow_ticks < SLOW_TICKS:
            return ""
        often = f" in {SLOW_TICKS} ticks in a row" if took_s <= STOPPED_S else ""
        return f"took {1e3 * took_s:.0f} ms{often}, and may take {1e3 * SLOW_S:.0f} ms of a tick"


def _words(error: BaseException) -> str:
    """Return type and words of an exception, which may have none, or raise when it is asked for
    them.
    """
    try:
        said = " ".join(str(error).split())[:_LONGEST_WORDS]
    except Exception:  # noqa: BLE001 - its author's code
        said = ""
    return ": ".join(filter(None, (type(error).__name__, said)))
