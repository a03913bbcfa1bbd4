"""Batches fly the pipeline and the filter of the drone: row by row they give what one vehicle
computes.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from onboard.avoidance.params import obstacles
from onboard.config.fleet import load_fleet
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.estimation import kalman, wind
from onboard.rollout import batch, layouts
from onboard.rollout.rows import Layout, floats, zero
from onboard.types import Goal, LawStatus, Neighbour, State, Tick
from onboard.vectors import Vec3

TICKS = 40
FLEETS = ("paper", "sih")
VEHICLES = 12


def vector(rng: np.random.Generator, size: float) -> Vec3:
    return Vec3(*rng.uniform(-size, size, 3).tolist())


def random_neighbours(rng: np.random.Generator) -> list[Neighbour]:
    return [
        Neighbour(
            position_enu_m=vector(rng, 2.0),
            velocity_enu_m_s=vector(rng, 2.0),
            acceleration_enu_m_s2=vector(rng, 2.0),
            predicted_position_enu_m=vector(rng, 2.0),
            predicted_velocity_enu_m_s=vector(rng, 2.0),
            commanded_acceleration_enu_m_s2=vector(rng, 2.0),
            intent_enu_m_s=vector(rng, 2.0),
            age_s=0.04,
            lead_time_s=0.2,
            position_std_m=0.01,
            velocity_std_m_s=0.02,
            crowd_count=float(rng.integers(0, 4)),
            is_cooperative=bool(rng.random() < 0.8),
            is_paper_obstacle=k == 0,
            table_index=k,
            radius_m=0.0,
        )
        for k in range(int(rng.integers(0, 8)))
    ]


def random_flight() -> tuple[
    list[pipeline.PipelineParams], list[list[tuple[State, Goal, list[Neighbour], ControlMode]]]
]:
    """Parameters of different vehicles under different laws, and inputs of each tick for each of
    them.
    """
    rng = np.random.default_rng(4)
    fleets = [load_fleet(f"configs/fleets/{name}.toml") for name in FLEETS]
    laws = ("covey", "covey", "paper", "off")

    params = [
        pipeline.pipeline_params(fleets[k % 2], next(iter(fleets[k % 2].vehicles)), laws[k % 4])
        for k in range(VEHICLES)
    ]

    flight = []
    for tick in range(TICKS):
        mode = ControlMode.FLYING
        if tick < 2:
            mode = ControlMode.GROUND
        elif tick < 6:
            mode = ControlMode.LIFTOFF

        flight.append(
            [
                (
                    State(
                        position_enu_m=vector(rng, 1.0),
                        velocity_enu_m_s=vector(rng, 0.5),
                        acceleration_enu_m_s2=vector(rng, 0.5),
                        yaw_rad=0.0,
                        age_s=0.01,
                        position_std_m=0.01,
                        velocity_std_m_s=0.02,
                    ),
                    Goal(vector(rng, 3.0), 0.0, tick // 15),
                    random_neighbours(rng),
                    mode,
                )
                for _ in range(VEHICLES)
            ]
        )
    return params, flight


def flown_in_rows() -> np.ndarray:
    """Numbers of all ticks (TICKS, VEHICLES, width) of the random flight, computed as one batch."""
    params, flight = random_flight()
    walls = layouts.OBSTACLE.packed(obstacles(load_fleet("configs/fleets/paper.toml")))
    memories = layouts.MEMORY.packed([pipeline.initial(own, Vec3(0.0, 0.0, 0.0)) for own in params])
    rows = layouts.PARAMS.packed(params)

    ticks = []
    for inputs in flight:
        neighbours = layouts.NEIGHBOUR.rows((VEHICLES, 8))
        is_present = np.zeros((VEHICLES, 8), bool)

        for m, (_, _, near, _) in enumerate(inputs):
            neighbours[m, : len(near)] = layouts.NEIGHBOUR.packed(near)
            is_present[m, : len(near)] = True

        passes = batch.PassRows(
            states=layouts.STATE.packed([state for state, _, _, _ in inputs]),
            goals=layouts.GOAL.packed([goal for _, goal, _, _ in inputs]),
            neighbours=neighbours,
            is_present=is_present,
            modes=np.array([int(mode) for _, _, _, mode in inputs]),
        )
        ticks.append(floats(batch.step(memories, passes, walls, rows, 0.02)).copy())
    return np.array(ticks)


def flown_one_by_one() -> np.ndarray:
    """The same, each vehicle by itself."""
    params, flight = random_flight()
    walls = obstacles(load_fleet("configs/fleets/paper.toml"))
    memories = [pipeline.initial(own, Vec3(0.0, 0.0, 0.0)) for own in params]

    ticks = []
    for inputs in flight:
        values = []
        for m, (state, goal, near, mode) in enumerate(inputs):
            memories[m], tick = pipeline.step(
                memories[m], state, goal, near, walls, mode, params[m], 0.02
            )
            values.append(tick)

        ticks.append(floats(layouts.TICK.packed(values)).copy())
    return np.array(ticks)


def test_a_batch_gives_every_vehicle_what_it_computes_by_itself() -> None:

    rows = flown_in_rows()
    np.testing.assert_allclose(rows, flown_one_by_one(), rtol=1e-9, atol=1e-9)

    status = rows.view(layouts.TICK.dtype)["law"]["status"]
    assert {LawStatus.INACTIVE, LawStatus.SATURATED, LawStatus.RELAXED} <= set(
        status.ravel().tolist()
    )


@pytest.mark.long
def test_without_numba_the_same_batch_is_interpreted() -> None:
    program = (
        "from tests.onboard.rollout.test_batch import flown_in_rows\n"
        "from onboard.rollout import batch\n"
        "assert not batch.warm_up()\n"
        "import sys; sys.stdout.buffer.write(flown_in_rows().tobytes())"
    )

    environment = os.environ | {"COVEY_NUMBA": "0"}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, check=True, env=environment
    )

    rows = flown_in_rows()
    interpreted = np.frombuffer(done.stdout).reshape(rows.shape)
    np.testing.assert_allclose(rows, interpreted, rtol=1e-9, atol=1e-9)


def test_filters_of_a_batch_give_what_one_filter_gives() -> None:
    rng = np.random.default_rng(5)
    params = [kalman.KalmanParams(drag_1_s=drag) for drag in (0.0, 0.3, 0.6)]
    start = rng.uniform(-1.0, 1.0, (2, 3, 3))
    filters = batch.FleetEstimator(params, start)

    memories = [
        kalman.initial(Vec3(*start[f, n]), params[n])._replace(thrust_m_s2=9.80665)
        for f in range(2)
        for n in range(3)
    ]

    airs = [wind.initial()] * 6
    for _ in range(50):
        attitude = rng.normal([5.0, 0.0, 0.0, 0.0], 0.3, (2, 3, 4))
        attitude /= np.linalg.norm(attitude, axis=-1, keepdims=True)

        throttle = rng.uniform(0.4, 0.6, (2, 3))
        yaw = rng.uniform(-1.0, 1.0, (2, 3))

        sample = start + rng.normal(0.0, 0.003, (2, 3, 3))
        states = filters.step(attitude, throttle, np.full((2, 3), 0.5), sample, yaw, 0.02, 0.02)

        for m in range(6):
            f, n = divmod(m, 3)
            q = tuple(attitude[f, n].tolist())
            memory = kalman.drive(
                memories[m], q, float(throttle[f, n]), 0.5, params[n], 0.02, False
            )

            memories[m] = kalman.correct(memory, Vec3(*sample[f, n].tolist()), 0.02, params[n])
            airs[m] = wind.step(airs[m], memories[m].bias_enu_m_s2, 0.02, False)

            expected = kalman.state(memories[m], float(yaw[f, n]), 0.0, 0.0)
            expected = wind.widened(expected, airs[m], params[n].gust_time_s)

            np.testing.assert_allclose(
                floats(states)[f, n], floats(layouts.STATE.packed([expected]))[0], atol=1e-9
            )


@pytest.mark.parametrize("kind", [State, Goal, Neighbour, Tick, pipeline.PipelineParams])
def test_a_value_written_to_a_row_is_read_as_the_same_value_of_the_same_types(kind: type) -> None:
    layout = Layout(zero(kind))

    numbers = np.arange(1.0, layout.width + 1.0)
    value = layout.read(numbers.tolist())

    rows = layout.packed([value])
    assert layout.values(rows) == [value]
    assert repr(layout.values(rows)[0]) == repr(value)


def test_memories_with_lists_and_long_tuples_survive_their_row_and_columns_have_names() -> None:
    params = pipeline.pipeline_params(load_fleet("configs/fleets/sih.toml"), "mav0")
    memory = pipeline.initial(params, Vec3(1.0, 2.0, 3.0))

    rows = layouts.MEMORY.packed([memory, memory])

    assert layouts.MEMORY.values(rows) == [memory, memory]
    assert (
        rows["hover_thrust"]["hover_thrust_frac"].tolist()
        == [params.hover_thrust.configured_frac] * 2
    )
    assert rows["law"]["commands"]["duration_s"].shape == (2, len(memory.law.commands))


def test_code_compiled_by_one_process_is_found_by_the_next(tmp_path: Path) -> None:
    """One compiles Python's own code too, and the other reads that from .pyc files."""
    program = "from onboard.rollout import loops; print(loops.digest())"

    told = [
        subprocess.run(
            [sys.executable, *options, "-c", program], capture_output=True, text=True, check=True
        ).stdout
        for options in (("-B", "-X", f"pycache_prefix={tmp_path}"), ())
    ]
    assert told[0] == told[1]
