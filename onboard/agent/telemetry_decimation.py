"""Selects the telemetry for the other agents. Pure.

People get every telemetry message, ten times a second. The other agents use only a few of its
fields, and each message costs them time. So they get a message at once if one of these fields has
changed, and otherwise twice a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.bus.schema import Telemetry
from onboard.tuples import Xyz

_EVERY_NS = 450_000_000  # twice a second, with some slack
_GOAL_M = 0.05  # a goal that moved by less counts as unchanged

# Telemetry with a change is repeated this many times, because a message may be lost, and goals are
# compared only half a second after their orders.
_REPEATS = 3


@dataclass(slots=True)
class TelemetryDecimation:
    """Memory of the last telemetry that the other agents got."""

    _stamp_ns: int | None = None  # None: none was sent yet
    _used_fields: tuple[object, ...] = ()  # fields that the other agents use, except the goal
    _goal_enu_m: Xyz = (0.0, 0.0, 0.0)
    _repeats: int = 0  # number of repeats still to be sent

    def is_due(self, telemetry: Telemetry) -> bool:
        """Return whether this message goes to the other agents."""
        used_fields = (
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

        if self._stamp_ns is None or used_fields != self._used_fields or not is_same_goal:
            self._repeats = _REPEATS
        elif self._repeats:
            self._repeats -= 1
        elif telemetry.stamp_ns - self._stamp_ns < _EVERY_NS:
            return False

        self._stamp_ns = telemetry.stamp_ns
        self._used_fields = used_fields
        self._goal_enu_m = goal_enu_m
        return True
