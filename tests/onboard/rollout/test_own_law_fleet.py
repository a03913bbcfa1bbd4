"""A fleet with a user's law: row by row it gives what one vehicle with that law computes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from onboard.arrays import BoolArray
from onboard.avoidance.own_law import LawInputs
from onboard.avoidance.own_law_runner import OwnLawRunner
from onboard.config.fleet import OwnLaw, load_fleet
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.rollout import layouts
from onboard.rollout.fleet_routes import FleetRoutes
from onboard.rollout.own_law_fleet import OwnLawFleet
from onboard.rollout.rows import Rows, floats
from onboard.types import Goal, LawStatus, State, Thrust
from onboard.vectors import Vec3
from tests.onboard.rollout.test_batch import random_neighbours, vector

TICKS = 40
FLIGHTS = 2
VEHICLES = 4
FAILS_AFTER = 25  # ticks, for the vehicles with the longer lag
DT_S = 0.02


def evading(calls: int | None, inputs: LawInputs) -> tuple[int, Thrust]:
    """Push away from the nearest neighbour; a slow vehicle's law fails after some ticks."""
    calls = (calls or 0) + 1
    if calls > FAILS_AFTER and inputs.vehicle.lag_s > 0.2:
        raise ValueError("enough")
    x, y, _ = inputs.baseline.thrust_enu_m_s2
    if inputs.neighbours:
        nearest = inputs.neighbours[0]
        away = nearest.e_m
        push_m_s2 = 0.5 * nearest.d_m / max(math.hypot(away.x, away.y), 0.1)
        x += push_m_s2 * away.x
        y += push_m_s2 * away.y
    return calls, inputs.limited(x, y)


LAW = OwnLaw("mine:evading", "mine.py", "0", lambda: evading)


class _Inputs:
    """Random inputs of the same flights, for each tick the same whenever they are asked for."""

    def __init__(self) -> None:
        fleets = [load_fleet(f"configs/fleets/{name}.toml") for name in ("paper", "sih")]
        self.params = [
            pipeline.pipeline_params(fleets[k % 2], next(iter(fleets[k % 2].vehicles)), "covey")
            for k in range(VEHICLES)
        ]
        rng = np.random.default_rng(4)
        self.start_enu_m = rng.uniform(-1.0, 1.0, (FLIGHTS, VEHICLES, 3))

    def ticks(self) -> Iterator[tuple[Rows, Rows, Rows, BoolArray]]:
        """Yield states, goals, neighbours, and which of these there are."""
        rng = np.random.default_rng(5)
        shape = (FLIGHTS, VEHICLES)
        for tick in range(TICKS):
            states = []
            goals = []
            neighbours = layouts.NEIGHBOUR.rows((*shape, 8))
            is_present = np.zeros((*shape, 8), bool)
            for index in np.ndindex(shape):
                state = State(
                    position_enu_m=vector(rng, 1.0),
                    velocity_enu_m_s=vector(rng, 0.5),
                    acceleration_enu_m_s2=vector(rng, 0.5),
                    yaw_rad=0.0,
                    age_s=0.01,
                    position_std_m=0.01,
                    velocity_std_m_s=0.02,
                )
                if tick == 7:
                    state = state._replace(velocity_enu_m_s=Vec3(math.nan, 0.0, 0.0))
                states.append(state)
                goals.append(Goal(vector(rng, 3.0), 0.0, tick // 15))
                near = random_neighbours(rng)
                neighbours[index][: len(near)] = layouts.NEIGHBOUR.packed(near)
                is_present[index][: len(near)] = True
            yield (
                layouts.STATE.packed(states).reshape(shape),
                layouts.GOAL.packed(goals).reshape(shape),
                neighbours,
                is_present,
            )


def _one_by_one(inputs: _Inputs) -> tuple[list[Any], list[Any]]:
    """Return ticks and refusals of all vehicles, each computed by itself."""
    routes = FleetRoutes(FLIGHTS, inputs.params, ())
    runners = [OwnLawRunner(LAW) for _ in range(FLIGHTS * VEHICLES)]
    memories = [
        pipeline.initial(inputs.params[vehicle], Vec3(*inputs.start_enu_m[flight, vehicle]))
        for flight in range(FLIGHTS)
        for vehicle in range(VEHICLES)
    ]
    ticks = []
    for states, goals, neighbours, is_present in inputs.ticks():
        routed = routes.goals(states, goals, neighbours, is_present, DT_S)
        values = []
        for m, (flight, vehicle) in enumerate(np.ndindex(FLIGHTS, VEHICLES)):
            (state,) = layouts.STATE.values(states[flight, vehicle].reshape(1))
            (goal,) = layouts.GOAL.values(routed[flight, vehicle].reshape(1))
            near = neighbours[flight, vehicle][is_present[flight, vehicle]]
            memories[m], tick = pipeline.step(
                memories[m],
                state,
                goal,
                layouts.NEIGHBOUR.values(near),
                (),
                ControlMode.FLYING,
                inputs.params[vehicle],
                DT_S,
                law_step=runners[m].step,
            )
            values.append(tick)
        ticks.append(floats(layouts.TICK.packed(values)).reshape(FLIGHTS, VEHICLES, -1).copy())
    return ticks, [runner.refusal for runner in runners]


def test_a_fleet_gives_every_vehicle_what_it_computes_by_itself() -> None:
    inputs = _Inputs()
    expected, refusals = _one_by_one(inputs)
    fleet = OwnLawFleet(LAW, inputs.params, inputs.start_enu_m)
    for values, (states, goals, neighbours, is_present) in zip(
        expected, inputs.ticks(), strict=True
    ):
        rows = fleet.step(states, goals, neighbours, is_present, DT_S)
        np.testing.assert_allclose(floats(rows), values, rtol=1e-9, atol=1e-9)

    # some vehicles' laws have failed, and some have not
    assert "raised ValueError: enough" in refusals
    assert "" in refusals
    assert fleet.refusals == dict.fromkeys(range(FLIGHTS), "mine:evading raised ValueError: enough")
    assert set(rows["law"]["status"].ravel()) >= {LawStatus.SATURATED}


def test_flights_that_are_over_are_dropped_and_the_others_fly_on() -> None:
    inputs = _Inputs()
    expected, _ = _one_by_one(inputs)
    fleet = OwnLawFleet(LAW, inputs.params, inputs.start_enu_m)
    last = np.array([FLIGHTS - 1])
    for tick, (states, goals, neighbours, is_present) in enumerate(inputs.ticks()):
        if tick == TICKS // 2:
            fleet.keep(last)
        if tick < TICKS // 2:
            fleet.step(states, goals, neighbours, is_present, DT_S)
            continue
        rows = fleet.step(states[last], goals[last], neighbours[last], is_present[last], DT_S)
        np.testing.assert_allclose(floats(rows), expected[tick][last], rtol=1e-9, atol=1e-9)
    assert list(fleet.refusals) == [FLIGHTS - 1]
