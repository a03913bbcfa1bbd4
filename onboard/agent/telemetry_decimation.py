"""Selection of the telemetry for the other agents: at once what changes what they do, all of it
twice a second. Pure.

People look at all of it ten times a second; agents use a few fields, and each pays for what it
hears of every other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.bus.schema import Telemetry, Vec3

_EVERY_NS = 450_000_000  # twice a second, also when a message comes a bit early
_GOAL_M = 0.05
# of a change: a message may be lost, and a goal is judged half a second after its order
_REPEATS = 3


@dataclass(slots=True)
class TelemetryDecimation:
    """Memory of what was sent to the others last."""

    _stamp_ns: int | None = None
    _words: tuple[object, ...] = ()
    _goal_enu_m: Vec3 = (0.0, 0.0, 0.0)
    _repeats: int = 0

    def is_due(self, telemetry: Telemetry) -> bool:
        """Whether this one goes to the others too."""
        words = (
            telemetry.state,
            telemetry.order_id,
            telemetry.is_airborne,
            telemetry.is_position_valid,
            telemetry.doubles,
            telemetry.config_hash,
            telemetry.show_id,
            telemetry.is_behind,
        )
        goal = telemetry.goal_position_enu_m
        if (
            self._stamp_ns is None
            or words != self._words
            or not math.dist(goal, self._goal_enu_m) < _GOAL_M
        ):
            self._repeats = _REPEATS
        elif self._repeats:
            self._repeats -= 1
        elif telemetry.stamp_ns - self._stamp_ns < _EVERY_NS:
            return False
        self._stamp_ns, self._words, self._goal_enu_m = telemetry.stamp_ns, words, goal
        return True
