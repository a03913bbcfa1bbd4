"""Flies a user's own law instead of Covey's law, and Covey's law once the user's law fails.

:meth:`OwnLawRunner.step` takes and returns the same values as :func:`onboard.avoidance.oist.step`,
so that the pipeline can call either of them. Covey's law is computed at every tick, too. It takes
over for the rest of the flight when the user's law raises an exception, returns a thrust that
cannot be flown, or is slow, and when the agent replaces it because of what the vehicle does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from onboard.avoidance import oist
from onboard.avoidance.interface import INFEASIBLE, Baseline
from onboard.avoidance.oist import LawMemory
from onboard.avoidance.own_law import (
    LawInputs,
    covey_tick,
    flown_instead,
    judged,
    law_inputs,
    with_share,
)
from onboard.avoidance.params import Capsule, LawParams
from onboard.avoidance.prediction import Motion
from onboard.config.fleet import OwnLaw
from onboard.types import LawOutput, Neighbour, State
from onboard.vectors import Vec3

# A law is refused as slow if it takes longer than SLOW_S in SLOW_TICKS ticks in a row, or longer
# than STOPPED_S in one tick.
SLOW_S = 0.005
SLOW_TICKS = 3
STOPPED_S = 0.1
_MAX_MESSAGE_CHARS = 120  # longest part of an exception's message that a sentence quotes


class OwnLawRunner:
    """One vehicle's own law, its memory, and the reason why Covey's law has taken over.

    Args:
        law: the law that the fleet file names.
        clock: returns the time [s], and measures how long the law takes. None in simulated time,
            where no law counts as slow.
    Raises:
        ConfigError: the law cannot be imported.
    """

    def __init__(self, law: OwnLaw, clock: Callable[[], float] | None = None) -> None:
        self.law = law
        self._function = law.load()
        # why Covey's law flies the rest of this flight; empty while the user's law flies
        self.refusal = ""
        self._clock = clock
        self._memory: Any = None
        self._slow_ticks = 0
        # ``LawMemory.relaxed_share`` of Covey's law: how often its rows cannot all hold. A vehicle
        # that flies with a large share is slowed down. As the user's law flies here, callers see
        # the share 0, and the true share is kept for the tick in which Covey's law takes over.
        self._relaxed_share = 0.0

    def begin_anew(self) -> None:
        """Forget the last flight; called on the ground."""
        self.refusal = ""
        self._memory = None
        self._slow_ticks = 0
        self._relaxed_share = 0.0

    def replace(self, reason: str) -> None:
        """Let Covey's law fly the rest of this flight.

        Args:
            reason: what the user's law has done, as the end of a sentence that begins with its
                name. An earlier reason is kept.
        """
        self.refusal = self.refusal or reason

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
            memory: memory of Covey's law after the last tick.
            baseline: thrust of the backstepping, compensation and intent.
            predicted: own motion at t + L.
            state: own estimate.
            neighbours: all neighbours as received.
            obstacles: static obstacles, and edges of the fence's areas.
            params: parameters of the vehicle.
            dt_s: time since the last tick.
        """
        if self.refusal:
            if self._relaxed_share:
                memory = with_share(memory, self._relaxed_share)
                self._relaxed_share = 0.0
            return oist.step(
                memory, baseline, predicted, state, neighbours, obstacles, params, dt_s
            )

        # Covey's law is computed at every tick, because it may have to take over.
        covey = covey_tick(
            memory,
            self._relaxed_share,
            baseline,
            predicted,
            state,
            neighbours,
            obstacles,
            params,
            dt_s,
        )
        after = covey.memory
        output = covey.output

        # INFEASIBLE: the inputs are unusable, so Covey's bounded fallback flies
        if output.status != INFEASIBLE:
            inputs = law_inputs(
                covey.own,
                covey.neighbours,
                baseline,
                predicted,
                state,
                neighbours,
                obstacles,
                params,
                dt_s,
            )
            thrust = self.answer(inputs)
            if thrust is None:
                self._relaxed_share = 0.0
                return after, output
            after, output = flown_instead(thrust, covey.own, output, after, memory, dt_s)

        self._relaxed_share = after.relaxed_share
        return with_share(after, 0.0), output

    def answer(self, inputs: LawInputs) -> Vec3 | None:
        """Return the law's thrust, or None if it cannot be flown; ``refusal`` says why."""
        began_s = 0.0
        if self._clock is not None:
            began_s = self._clock()
        try:
            answered = self._function(self._memory, inputs)
            self._memory, thrust, self.refusal = judged(answered, inputs)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - a user's law may raise anything
            self.refusal = f"raised {_in_words(error)}"
            return None

        if self._clock is not None and not self.refusal:
            self.refusal = self._slowness(self._clock() - began_s)
        if self.refusal:
            return None
        return thrust

    def _slowness(self, duration_s: float) -> str:
        """Return why a law that took this long is refused; empty if it is fast enough."""
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


def _in_words(error: BaseException) -> str:
    """Return type and message of an exception; the message may be empty, or raise an exception."""
    name = type(error).__name__
    try:
        message = " ".join(str(error).split())[:_MAX_MESSAGE_CHARS]
    except Exception:  # noqa: BLE001 - str() runs the law author's code
        message = ""
    return f"{name}: {message}" if message else name
