"""The orders of flights: the goals of vehicles, and which vehicles are lost or blind, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import BoolArray, IntArray
from onboard.rollout import layouts
from onboard.rollout.rows import Rows
from sitl.monte_carlo.metrics import FlightMetrics
from sitl.monte_carlo.scenarios import FlightPlan
from sitl.monte_carlo.vehicles import TrueMotions

_STOP_S = 0.5  # time to stop from top speed, by the limit of acceleration and the lag


class FlightOrders:
    """Orders of F flights of N vehicles; arrays (F, N, ...)."""

    def __init__(self, plans: Sequence[FlightPlan]) -> None:
        """Begin with the first goal of every vehicle.

        Args:
            plans: the plans, all of the same number of vehicles and of goals.
        """
        count = plans[0].count
        self._goals = np.stack([plan.goals_enu_m for plan in plans])  # (F, G, N, 3)
        self.goal_enu_m = self._goals[:, 0]  # (F, N, 3) where each vehicle flies to now
        self._duration = np.repeat([[plan.duration_s] for plan in plans], count, axis=1)

        shape = self._duration.shape
        self._sequence = np.zeros(shape, np.int64)
        self._lost_at = np.full(shape, np.inf)
        self._freezes = np.zeros(shape, bool)
        self._mutes = np.zeros(shape, bool)
        self.is_blind = np.zeros(shape, bool)

        for f, plan in enumerate(plans):
            self.is_blind[f, list(plan.blind)] = True
            if plan.lost is not None:
                index, time_s, kind = plan.lost
                self._lost_at[f, index] = time_s
                self._freezes[f, index] = kind in ("frozen", "dead")
                self._mutes[f, index] = kind in ("silent", "dead")

    @property
    def is_last(self) -> BoolArray:
        """Whether a vehicle flies to the last of its goals, (F, N)."""
        return np.asarray(self._sequence >= self._goals.shape[1] - 1)

    def lost(self, time_s: float) -> tuple[BoolArray, BoolArray]:
        """Return which vehicles (F, N) are frozen, so that they hold, and which send nothing."""
        is_lost = np.asarray(time_s >= self._lost_at)
        return is_lost & self._freezes, is_lost & self._mutes

    def goals(self, is_frozen: BoolArray, truth: TrueMotions) -> Rows:
        """Return the goals of this tick.

        The goal of a vehicle that has just frozen is the position where it comes to rest.
        """
        # In a flight with a lost vehicle each vehicle has one goal, with sequence 0. The goal of a
        # frozen vehicle gets sequence 1, so that it is set only once.
        has_just_frozen = is_frozen & (self._sequence == 0)
        if has_just_frozen.any():
            resting = truth.position_enu_m + _STOP_S * truth.velocity_enu_m_s
            self.goal_enu_m = np.where(has_just_frozen[..., None], resting, self.goal_enu_m)
            self._duration = np.where(has_just_frozen, 0.0, self._duration)
            self._sequence = np.where(has_just_frozen, 1, self._sequence)

        goals = layouts.GOAL.rows(self._sequence.shape)
        goals["position_enu_m"] = self.goal_enu_m
        goals["duration_s"] = self._duration
        goals["sequence"] = self._sequence
        return goals

    def advance(self, metrics: FlightMetrics) -> None:
        """Give vehicles that have arrived their next goal, and judge them by it from now on."""
        goes_on = metrics.is_at_goal & ~self.is_last
        if not goes_on.any():
            return

        self._sequence = np.where(goes_on, self._sequence + 1, self._sequence)

        flight, vehicle = np.nonzero(goes_on)
        goal_enu_m = self.goal_enu_m.copy()
        goal_enu_m[flight, vehicle] = self._goals[flight, self._sequence[goes_on], vehicle]
        self.goal_enu_m = goal_enu_m
        metrics.change_goals(goal_enu_m, self.is_last)

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._goals = self._goals[flights]
        self.goal_enu_m = self.goal_enu_m[flights]
        self._duration = self._duration[flights]
        self._sequence = self._sequence[flights]
        self._lost_at = self._lost_at[flights]
        self._freezes = self._freezes[flights]
        self._mutes = self._mutes[flights]
        self.is_blind = self.is_blind[flights]
