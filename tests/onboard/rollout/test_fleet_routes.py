"""A batch leads each of its vehicles as the agent of that vehicle would."""

from __future__ import annotations

import random

import numpy as np
import pytest

from onboard.avoidance.params import Capsule, still
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.control import router
from onboard.control.pipeline import pipeline_params
from onboard.control.router import RouteMemory
from onboard.rollout.fleet_routes import FleetRoutes
from onboard.rollout.rows import Layout, zero
from onboard.types import Goal, Neighbour, State
from onboard.vectors import Vec2, Vec3

FLIGHTS = 2
NEIGHBOURS = 2
TICKS = 150
PLACES_M = (Vec2(-0.45, 0.0), Vec2(-3.0, 1.5), Vec2(1.4, -2.0))  # in the lane, and beside it
TICK_S = 0.2
LANE = [Capsule(Vec2(-1.5, side * 0.7), Vec2(1.5, side * 0.7), 0.05) for side in (-1.0, 1.0)]
TREE = Capsule(Vec2(3.0, 0.0), Vec2(3.0, 0.0), 0.4, area=1, keep_m=0.3, high_m=1.0)


def fleet() -> FleetConfig:
    return load_fleet("configs/fleets/paper.toml")


def random_state(place_m: Vec2, errors: random.Random) -> State:
    x = errors.gauss(place_m.x, 0.03)
    y = errors.gauss(place_m.y, 0.03)
    state: State = zero(State)
    return state._replace(position_enu_m=Vec3(x, y, errors.gauss(1.0, 0.02)))


def random_neighbour(intent_m_s: float, errors: random.Random) -> Neighbour:
    neighbour: Neighbour = zero(Neighbour)
    position = Vec3(errors.gauss(0.45, 0.03), errors.gauss(0.0, 0.03), 1.0)
    return neighbour._replace(
        position_enu_m=position,
        predicted_position_enu_m=position,
        intent_enu_m_s=Vec3(errors.gauss(intent_m_s, 0.1), 0.0, 0.0),
        is_cooperative=errors.random() < 0.99,
    )


@pytest.mark.parametrize(
    ("things", "goal_x_m", "intent_m_s"),
    [([*LANE, TREE], 4.0, -1.0), ([], 0.0, -0.5)],
    ids=["a passage for one", "goals in one place"],
)
def test_a_batch_and_the_agents_fly_the_same_legs(
    things: list[Capsule], goal_x_m: float, intent_m_s: float
) -> None:
    errors = random.Random(2)
    things = [*still(fleet()), *things]
    params = [pipeline_params(fleet(), name) for name in fleet().enabled_names]
    routes = FleetRoutes(FLIGHTS, params, things)
    around = [router.surroundings(things, own.law) for own in params]
    count = FLIGHTS * len(params)
    memories = [RouteMemory()] * count

    led_count = 0
    refuge_count = 0
    for tick in range(TICKS):
        states = [random_state(PLACES_M[number % 3], errors) for number in range(count)]
        neighbours = [random_neighbour(intent_m_s, errors) for _ in range(count * NEIGHBOURS)]
        is_present = np.array([errors.random() < 0.95 for _ in neighbours])
        goals = [
            Goal(Vec3(goal_x_m, 0.1 * number, 1.0), 9.0, sequence=1 + tick // 100)
            for number in range(count)
        ]
        shape = (FLIGHTS, len(params), NEIGHBOURS)
        legs = routes.goals(
            Layout(zero(State)).packed(states).reshape(shape[:2]),
            Layout(zero(Goal)).packed(goals).reshape(shape[:2]),
            Layout(zero(Neighbour)).packed(neighbours).reshape(shape),
            is_present.reshape(shape),
            TICK_S,
        )

        expected = []
        for number in range(count):
            own = range(number * NEIGHBOURS, (number + 1) * NEIGHBOURS)
            memories[number], leg = router.step(
                memories[number],
                states[number],
                goals[number],
                [neighbours[index] for index in own if is_present[index]],
                around[number % len(params)],
                TICK_S,
            )
            expected.append(leg)
        packed = Layout(zero(Goal)).packed(expected)
        assert legs.reshape(-1).tobytes() == packed.tobytes()

        led_count += sum(leg.sequence < 0 for leg in expected)
        refuge_count += sum(memory.refuge is not None for memory in memories)
    assert led_count > 100
    assert refuge_count > 0
