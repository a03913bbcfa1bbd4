"""The law that a benchmark judges: how it flies in a campaign, and the time that it takes.

A user's own law is interpreted. Covey's law does not take over from it. If its answer is refused,
the flight has failed. Covey's laws fly compiled. They are timed in a further flight, in which they
are interpreted as on a drone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from onboard.arrays import Array, BoolArray
from onboard.avoidance.own_law import LawInputs
from onboard.avoidance.params import Capsule
from onboard.config.fleet import OwnLaw
from onboard.control.pipeline import PipelineParams
from onboard.rollout import batch
from onboard.rollout.own_law_fleet import OwnLawFleet
from onboard.types import Thrust
from sitl.monte_carlo.campaign_settings import Setup
from sitl.monte_carlo.open_benchmark.laws import covey

_UNTIMED_CALLS = 20  # the first calls also allocate memory, so they are not timed


class JudgedLaw:
    """The law of a setup, with the processor time that its calls have taken."""

    def __init__(self, setup: Setup) -> None:
        """Import the law.

        Args:
            setup: settings of the flights, which name the law.

        Raises:
            ConfigError: the law cannot be imported.
        """
        self._function: Callable[[Any, LawInputs], tuple[Any, Thrust]]
        own = setup.fleet(1).own_law
        self.is_own = own is not None  # whether it is a user's own law
        if own is None:
            self.source_hash = ""
            self._function = covey.law
        else:
            self.source_hash = own.source_hash
            self._function = own.load()
        self._name = setup.law

        self.setup = setup
        if self.is_own:
            self.setup = replace(setup, law="off")  # Covey's law is not computed alongside it
        self.busy_s = 0.0
        self.calls = 0  # timed calls
        self._untimed_calls_left = _UNTIMED_CALLS

    def __call__(self, memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
        """Return the law's answer."""
        begun_s = time.thread_time()
        answer: tuple[Any, Thrust] = self._function(memory, inputs)
        if self._untimed_calls_left > 0:
            self._untimed_calls_left -= 1
        else:
            self.busy_s += time.thread_time() - begun_s
            self.calls += 1
        return answer

    def interpreted(
        self,
        params: Sequence[PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[Capsule],
        is_flown: BoolArray,
    ) -> batch.Controller:
        """Return the control of a batch by this law, interpreted and timed."""
        law = OwnLaw(name=self._name, source="", source_hash=self.source_hash, load=lambda: self)
        return OwnLawFleet(
            law=law,
            params=params,
            start_enu_m=start_enu_m,
            obstacles=obstacles,
            is_flown=is_flown,
        )
