"""Selection of the telemetry for the other agents. Pure.

People look at all of it ten times a second. Agents use a few fields, and each pays for what it
hears of every other. So they hear at once what changes what they do, and all of it twice a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.bus.schema import Telemetry
from onboard.tuples import Xyz

_EVERY_NS = 450_000_000  # twice a second, also when a message comes a bit early
_GOAL_M = 0.05

# A change is sent so many times more: a message may be lost, and a goal is judged half a second
# after its order.
_REPEATS = 3


@dataclass(slots=True)
class TelemetryDecimation:
    """Memory of what was sent to the others last."""

    _stamp_ns: int | None = None
    _words: tuple[object, ...] = ()  # what changes what they do, the goal excepted
    _goal_enu_m: Xyz = (0.0, 0.0, 0.0)
    _repeats: int = 0  # still to send

    def is_due(self, telemetry: Telemetry) -> bool:
        """Return whether this one goes to the others too."""
        words = (
            telemetry.state,
            telemetry.order_id,
            telemetry.is_airborne,
            telemetry.is_position_valid,
            telemetry.doubles,
            telemetry.config_hash,
            telemetry.show_id,
            telemetry.is_behind,
            telemetry.is_path_paused,
        )
        goal_enu_m = telemetry.goal_position_enu_m
        is_same_goal = math.dist(goal_enu_m, self._goal_enu_m) < _GOAL_M

        if self._stamp_ns is None or words != self._words or not is_same_goal:
            self._repeats = _REPEATS
        elif self._repeats:
            self._repeats -= 1
        elif telemetry.stamp_ns - self._stamp_ns < _EVERY_NS:
            return False

        self._stamp_ns = telemetry.stamp_ns
        self._words = words
        self._goal_enu_m = goal_enu_m
        return True
