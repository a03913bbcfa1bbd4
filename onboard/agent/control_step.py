"""Conversions between the agent's plain values and the arrays of the pipeline."""

from __future__ import annotations

import functools

import numpy as np

from onboard.flight.types import FlightGoal
from onboard.types import Goal


@functools.lru_cache(maxsize=1)
def goal_of(goal: FlightGoal) -> Goal:
    """Return the goal as the trajectory takes it; the same value as long as nothing has changed."""
    return Goal(
        np.asarray(goal.position_enu_m, dtype=np.float64),
        np.asarray(goal.duration_s),
        np.asarray(goal.sequence, dtype=np.int64),
    )
