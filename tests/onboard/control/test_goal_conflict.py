"""Of two vehicles whose goals are too near to each other, one waits until the other has arrived."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from onboard.avoidance.params import Capsule, params_of
from onboard.config.law import LawConfig
from onboard.control import goal_conflict, router
from onboard.control.router import PERIOD_S
from onboard.rollout.rows import zero
from onboard.types import Goal, Neighbour, State
from onboard.vectors import Vec2, Vec3
from sitl.monte_carlo import campaign_settings
from sitl.monte_carlo.batch_flight import Flown, fly
from sitl.monte_carlo.scenarios import FlightPlan

LAW = params_of(LawConfig())
KEEP_M = LAW.spacing.safety_distance_m + LAW.spacing.margin_m
GOAL = Goal(Vec3(0.0, 0.0, 1.0), 0.0, sequence=7)


def at(x: float, y: float = 0.0) -> State:
    state: State = zero(State)
    return state._replace(position_enu_m=Vec3(x, y, 1.0))


def neighbour(
    x: float, goal_x: float, z: float = 1.0, goal_z: float = 1.0, *, is_cooperative: bool = True
) -> Neighbour:
    """Return a neighbour near its goal; its published intent leads there."""
    place = Vec3(x, 0.0, z)
    made: Neighbour = zero(Neighbour)
    return made._replace(
        position_enu_m=place,
        predicted_position_enu_m=place,
        intent_enu_m_s=Vec3(goal_x - x, 0.0, 0.5 * (goal_z - z)),
        is_cooperative=is_cooperative,
        table_index=3,
    )


class Vehicle:
    """One vehicle before the goal (0, 0, 1), search by search."""

    def __init__(self, still: Sequence[Capsule] = (), vertical_separation_m: float = math.inf):
        around = router.surroundings(still, LAW)
        spacing = LAW.spacing._replace(vertical_separation_m=vertical_separation_m)
        self._around = around._replace(spacing=spacing)
        self.memory = router.RouteMemory()

    def leg_after(self, seconds: float, here: State, *neighbours: Neighbour) -> Goal:
        for _ in range(round(seconds / PERIOD_S)):
            self.memory, leg = router.step(
                self.memory, here, GOAL, neighbours, self._around, PERIOD_S
            )
        return leg


WEST = at(-0.45)
RIVAL = neighbour(x=0.45, goal_x=0.2)


def test_the_vehicle_further_west_waits_away_from_the_other_goal() -> None:
    vehicle = Vehicle()
    leg = vehicle.leg_after(5.0, WEST, RIVAL)
    assert math.dist(leg.position_enu_m, (0.2, 0.0, 1.0)) >= KEEP_M + 0.4
    assert leg.position_enu_m.x < -0.45
    assert leg.sequence < 0
    assert vehicle.memory.waits_for == 3


def test_it_does_not_wait_before_the_two_have_met_for_a_while() -> None:
    assert Vehicle().leg_after(3.0, WEST, RIVAL) == GOAL


def test_the_vehicle_further_east_waits_only_if_the_other_one_does_not() -> None:
    rival = neighbour(x=-0.45, goal_x=-0.2)
    assert Vehicle().leg_after(5.0, at(0.45), rival) == GOAL
    assert Vehicle().leg_after(13.0, at(0.45), rival).position_enu_m.x > 0.45


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (neighbour(x=0.45, goal_x=0.42), "it has arrived"),
        (neighbour(x=0.8, goal_x=1.1), "its goal is far enough away"),
        (neighbour(x=2.0, goal_x=0.2), "it is not near its goal yet"),
        (neighbour(x=0.45, goal_x=0.2, is_cooperative=False), "its intent is not known"),
        (neighbour(x=math.nan, goal_x=0.2), "its position is not known"),
    ],
)
def test_a_vehicle_does_not_wait_for(other: Neighbour, why: str) -> None:
    assert Vehicle().leg_after(15.0, WEST, other) == GOAL, why


def test_a_vehicle_that_has_arrived_stays() -> None:
    assert Vehicle().leg_after(15.0, at(-0.05), RIVAL) == GOAL


def test_goals_above_each_other_are_far_enough_apart_with_a_vertical_separation() -> None:
    above = neighbour(x=0.45, goal_x=0.2, z=2.5, goal_z=2.5)
    assert Vehicle().leg_after(5.0, WEST, above) != GOAL
    assert Vehicle(vertical_separation_m=1.0).leg_after(5.0, WEST, above) == GOAL


def test_a_vehicle_that_waits_goes_on_when_the_other_one_has_arrived() -> None:
    vehicle = Vehicle()
    vehicle.leg_after(5.0, WEST, RIVAL)
    waiting = at(-1.3)
    assert vehicle.leg_after(3.0, waiting, RIVAL) != GOAL
    leg = vehicle.leg_after(PERIOD_S, waiting, neighbour(x=0.21, goal_x=0.2))
    assert leg.position_enu_m == GOAL.position_enu_m


def test_a_vehicle_that_waits_goes_on_after_a_while_in_any_case() -> None:
    vehicle = Vehicle()
    vehicle.leg_after(5.0, WEST, RIVAL)
    assert vehicle.leg_after(16.0, at(-1.3), RIVAL).position_enu_m == GOAL.position_enu_m


def test_a_waiting_point_is_neither_behind_a_wall_nor_beside_another_vehicle() -> None:
    wall = Capsule(Vec2(-1.0, -3.0), Vec2(-1.0, 3.0), 0.05)
    parked = neighbour(x=0.2, goal_x=0.2)
    parked = parked._replace(position_enu_m=Vec3(0.2, 1.4, 1.0))
    leg = Vehicle([wall]).leg_after(5.0, at(-0.3), neighbour(x=0.6, goal_x=0.2), parked)
    assert leg.position_enu_m.x > -1.0
    assert leg.position_enu_m.y < 0.0


# -- flown -------------------------------------------------------------------------------------


def flown_to_one_place(count: int, gap_m: float, errors: str = "mocap") -> list[Flown]:
    """Fly vehicles from a circle to goals around its middle, then to a wider circle.

    Args:
        count: number of vehicles.
        gap_m: diameter of the circle of the first goals.
        errors: class of errors of the estimate.
    """
    plans = []
    for seed in range(1000, 1003):
        rng = np.random.default_rng(seed)
        start = circle(count, 2.5, rng.uniform(0.0, math.tau))
        plans.append(
            FlightPlan(
                scenario="one_place",
                seed=seed,
                start_enu_m=start,
                goal_enu_m=circle(count, 0.5 * gap_m, rng.uniform(0.0, math.tau)),
                later_goals_enu_m=circle(count, 3.5, rng.uniform(0.0, math.tau))[None],
                longest_s=90.0,
            )
        )
    return fly(plans, campaign_settings.setup_for(errors=errors))


def circle(count: int, radius_m: float, begin_rad: float) -> np.ndarray:
    """Return places (count, 3) on a circle at a height of 1 m."""
    angle = begin_rad + math.tau * np.arange(count) / count
    x = radius_m * np.cos(angle)
    y = radius_m * np.sin(angle)
    return np.stack([x, y, np.ones(count)], axis=1)


@pytest.mark.parametrize(
    ("count", "gap_m", "errors"),
    [
        (2, 0.0, "mocap"),
        (2, 0.0, "vision"),
        pytest.param(3, 0.2, "mocap", marks=pytest.mark.long),
    ],
)
def test_all_reach_goals_in_one_place_one_after_another(
    count: int, gap_m: float, errors: str
) -> None:
    for flown in flown_to_one_place(count, gap_m, errors=errors):
        assert flown.outcome.is_success
        assert flown.outcome.min_separation_m > 0.8


@pytest.mark.long
def test_without_the_rule_nobody_reaches_a_goal_that_is_also_the_other_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(goal_conflict, "rival_of", lambda *_: None)
    for flown in flown_to_one_place(2, gap_m=0.0):
        assert not flown.outcome.is_success
