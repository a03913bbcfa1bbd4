"""Flies a law of somebody's own in the place of Covey's, and Covey's when that one fails.

The runner's step takes and returns what :func:`onboard.avoidance.oist.step` does, so that the
pipeline calls it in that function's place. Covey's law is computed beside the other one at every
tick. It takes over for the rest of the flight when the other one raises, returns what cannot be
flown, or is slow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from onboard.avoidance import oist
from onboard.avoidance.interface import INFEASIBLE, Baseline
from onboard.avoidance.oist import LawMemory
from onboard.avoidance.own_law import LawInputs, flown_instead, judged, law_inputs
from onboard.avoidance.params import Capsule, LawParams
from onboard.avoidance.prediction import Motion
from onboard.config.fleet import OwnLaw
from onboard.types import LawOutput, Neighbour, State
from onboard.vectors import Vec3

SLOW_S = 0.005  # so long in so many ticks in a row is slow
SLOW_TICKS = 3
STOPPED_S = 0.1  # so long in one tick is slow, too
_LONGEST_WORDS = 120  # of an exception, in a sentence


class OwnLawRunner:
    """One vehicle's law, its memory, and why Covey's has taken over.

    Args:
        law: that the fleet file names.
        clock: seconds, by which the law's time is measured; None where time is simulated, and no
            law is slow.
    Raises:
        ConfigError: the law cannot be imported.
    """

    def __init__(self, law: OwnLaw, clock: Callable[[], float] | None = None) -> None:
        self.law = law
        self._function = law.load()
        self.refusal = ""  # why Covey's law flies the rest of this flight; empty: it does not
        self._clock = clock
        self._memory: Any = None
        self._slow_ticks = 0
        self._relaxed_share = 0.0  # of Covey's law, which is computed beside

    def begin_anew(self) -> None:
        """Forget the flight: called on the ground."""
        self.refusal = ""
        self._memory = None
        self._slow_ticks = 0
        self._relaxed_share = 0.0

    def step(
        self,
        memory: LawMemory,
        baseline: Baseline,
        predicted: Motion,
        state: State,
        neighbours: Sequence[Neighbour],
        obstacles: Sequence[Capsule],
        params: LawParams,
        dt_s: float,
    ) -> tuple[LawMemory, LawOutput]:
        """Return memory and output of this tick, as :func:`onboard.avoidance.oist.step` does.

        Args:
            memory: of Covey's law after the last tick.
            baseline: thrust of the backstepping, compensation and intent.
            predicted: own motion at t + L.
            state: own estimate.
            neighbours: as received.
            obstacles: static ones.
            params: of the vehicle.
            dt_s: since the last tick.
        """
        if self.refusal:
            return oist.step(
                memory, baseline, predicted, state, neighbours, obstacles, params, dt_s
            )

        before = memory._replace(relaxed_share=self._relaxed_share)
        after, output = oist.step(
            before, baseline, predicted, state, neighbours, obstacles, params, dt_s
        )

        # INFEASIBLE: nobody knows enough, and Covey's law is cautious
        if output.status != INFEASIBLE:
            inputs = law_inputs(baseline, predicted, state, neighbours, obstacles, params, dt_s)
            self._memory, thrust, self.refusal = self._answer(inputs)
            if self.refusal:
                return after, output
            after, output = flown_instead(thrust, output, after, before, inputs)

        # that Covey's law would be in a jam does not slow down a vehicle that flies by another one
        self._relaxed_share = after.relaxed_share
        return after._replace(relaxed_share=0.0), output

    def _answer(self, inputs: LawInputs) -> tuple[Any, Vec3, str]:
        """Return the law's memory and thrust, and why it cannot be flown."""
        began_s = 0.0 if self._clock is None else self._clock()
        try:
            memory, thrust, refusal = judged(self._function(self._memory, inputs), inputs)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - whatever somebody's law does
            return None, inputs.baseline.thrust_enu_m_s2, f"raised {_words(error)}"

        if self._clock is not None and not refusal:
            refusal = self._slowness(self._clock() - began_s)
        return memory, thrust, refusal

    def _slowness(self, duration_s: float) -> str:
        """Return why a law that takes so long is refused; empty if it is not."""
        if duration_s > SLOW_S:
            self._slow_ticks += 1
        else:
            self._slow_ticks = 0

        allowed = f"may take {1e3 * SLOW_S:.0f} ms of a tick"
        took = f"took {1e3 * duration_s:.0f} ms"
        if duration_s > STOPPED_S:
            return f"{took}, and {allowed}"
        if self._slow_ticks >= SLOW_TICKS:
            return f"{took} in {SLOW_TICKS} ticks in a row, and {allowed}"
        return ""


def _words(error: BaseException) -> str:
    """Return type and words of an exception, which may have none or raise when they are read."""
    name = type(error).__name__
    try:
        words = " ".join(str(error).split())[:_LONGEST_WORDS]
    except Exception:  # noqa: BLE001 - its author's code
        words = ""
    return f"{name}: {words}" if words else name
