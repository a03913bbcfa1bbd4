"""The kernels against the array forms, interpreted and compiled: one law, three ways to run it."""

import os
import subprocess
import sys
import time
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from onboard.avoidance import oist
from onboard.avoidance.params import OPEN_FENCE, LawParams
from onboard.config.fleet import load_fleet
from onboard.control import pipeline
from onboard.estimation import kalman
from onboard.rollout import compiled
from onboard.types import Goal, LawStatus, Neighbours, State

FENCE = (-3.0, 3.0, -3.0, 3.0)
CAPSULES = ((1.0, 1.0, 1.0, 1.0, 0.4), (-2.0, -1.0, -1.0, 2.0, 0.0), (0.0, -2.0, 2.0, -2.0, 0.0))
VARIANTS = [
    {},
    {"responsibility": "full"},
    {"responsibility": "half", "rotation": "always", "direction": "fixed"},
    {"rotation": "never", "margin": "fixed"},
    {"direction": "pair", "prediction": "none"},
    {"direction": "crowd", "max_neighbours": 2, "range_m": 2.0},
]


def random_neighbours(rng, size, count, spread=1.2):
    def draw(*shape, scale=1.0):
        return rng.normal(size=(size, *shape)) * scale

    position, velocity = draw(count, 3, scale=spread), draw(count, 3, scale=0.5)
    positive = lambda scale: np.abs(draw(count, scale=scale))  # noqa: E731
    return Neighbours(
        position, velocity, draw(count, 3), position + 0.15 * velocity, velocity + draw(count, 3, scale=0.1),
        draw(count, 3), positive(0.1), positive(0.02), rng.integers(0, 6, (size, count)).astype(float),
        rng.random((size, count)) < 0.9, rng.random((size, count)) < 0.8, rng.random((size, count)) < 0.5,
        positive(0.2), positive(0.05), draw(count, 3, scale=0.4) * (rng.random((size, count, 1)) < 0.8),
    )  # fmt: skip


def random_law_input(seed, size, count):
    rng = np.random.default_rng(seed)
    radius = rng.uniform(1.0, 5.0, size)
    wanted = oist._into_disc(rng.normal(size=(size, 2)) * 2.0, radius)
    own = tuple(rng.normal(size=(size, 2)) * 0.5 for _ in range(3))
    std = np.abs(rng.normal(size=size)) * 0.01, np.abs(rng.normal(size=size)) * 0.05
    neighbours = random_neighbours(rng, size, count, 1.2 + 0.1 * count)
    floor = np.where(rng.random(size) < 0.3, 4.0, 0.0)
    return wanted, rng.normal(size=(size, 2)) * 0.3, radius, own, std, floor, neighbours


def by_arrays(monkeypatch, function):
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "uses_kernel", lambda size: False)
        return function()


def one_of(value, k):
    if is_dataclass(value):
        return replace(value, **{f.name: one_of(getattr(value, f.name), k) for f in fields(value)})
    if isinstance(value, tuple):
        return tuple(one_of(part, k) for part in value)
    return value[k]


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
@pytest.mark.parametrize("count", [0, 1, 3, 12])
def test_compiled_law_equals_the_array_form(monkeypatch, variant, count):
    for fence, capsules in ((FENCE, CAPSULES), (OPEN_FENCE, ())):
        params = LawParams(fence_enu_m=fence, capsules_enu_m=capsules).changed(**variant)
        given = random_law_input(count, 400, count)
        plain = by_arrays(monkeypatch, lambda given=given, params=params: oist._covey(*given, params))
        quick = oist._covey(*given, params)
        for name, one, two in zip(("point", "status", "slack", "crowd", "active"), plain, quick, strict=True):
            np.testing.assert_allclose(one, two, atol=1e-9, err_msg=name)
        if count >= 3 and capsules:
            assert set(plain[1]) >= {LawStatus.INACTIVE, LawStatus.SATURATED, LawStatus.RELAXED}


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_interpreted_law_equals_the_array_form(monkeypatch, variant):
    params = LawParams(fence_enu_m=FENCE, capsules_enu_m=CAPSULES).changed(**variant)
    given = random_law_input(7, 80, 6)
    plain = by_arrays(monkeypatch, lambda: oist._covey(*given, params))
    for k in range(80):
        alone = oist._covey(*(one_of(part, slice(k, k + 1)) for part in given), params)
        for name, one, two in zip(("point", "status", "slack", "crowd", "active"), plain, alone, strict=True):
            np.testing.assert_allclose(one[k], two[0], atol=1e-9, err_msg=name)


FLEET = load_fleet("configs/fleets/sih.toml")
PARAMS = pipeline.pipeline_params(FLEET, next(iter(FLEET.vehicles)))


def flown(size, ticks, pick=None):
    """States and outputs of everything from the mocap to the throttle, for all vehicles at once or for one of them."""
    rng = np.random.default_rng(11)
    shape = (size,)
    start = rng.normal(size=(size, 3)) * 0.5 + np.array([0.0, 0.0, 1.5])
    filter_params = kalman.EstimateParams(drag_1_s=0.3)
    take = (lambda value: value) if pick is None else (lambda value: one_of(value, pick))
    own = kalman.initial(take(start), params=filter_params)
    memory = pipeline.initial(PARAMS, take(start))
    out = []
    for k in range(ticks):
        q = np.concatenate([np.ones((size, 1)), rng.normal(size=(size, 3)) * 0.05], axis=-1)
        q /= np.sqrt((q * q).sum(-1, keepdims=True))
        frac, seen = rng.uniform(0.4, 0.6, size), start + 0.01 * rng.normal(size=(size, 3))
        neighbours = random_neighbours(rng, size, 4)
        goal = Goal(start + 2.0, np.zeros(shape), np.full(shape, k // 20))
        own = kalman.drive(own, take(q), take(frac), take(np.full(shape, 0.5)), params=filter_params, dt_s=0.02)
        own = kalman.correct(own, take(seen), 0.03, params=filter_params)
        memory, tick = pipeline.step(
            memory, kalman.state(own, take(np.zeros(shape))), take(goal), take(neighbours), params=PARAMS, dt_s=0.02
        )
        out.append(tick)
    return out


def leaves(value, path=""):
    if is_dataclass(value):
        for field in fields(value):
            yield from leaves(getattr(value, field.name), f"{path}.{field.name}")
    elif value is not None:
        yield path, np.asarray(value)


def test_every_stage_in_floats_equals_the_same_in_arrays_over_a_flight(monkeypatch):
    together = by_arrays(monkeypatch, lambda: flown(6, 45))
    compiled_ticks = flown(6, 45)
    for one, two in zip(together, compiled_ticks, strict=True):
        for (path, a), (_, b) in zip(leaves(one), leaves(two), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9, err_msg=path)
    for k in (0, 3):
        for batch, alone in zip(together, flown(6, 45, pick=k), strict=True):
            for (path, a), (_, b) in zip(leaves(batch), leaves(alone), strict=True):
                np.testing.assert_allclose(a[k], b, atol=1e-9, err_msg=path)


def test_a_batch_of_one_vehicle_is_that_vehicle_and_needs_no_numba(monkeypatch):
    monkeypatch.setattr(compiled, "numba", lambda: None)
    together = flown(3, 25)
    for batch, alone in zip(together, flown(3, 25, pick=slice(1, 2)), strict=True):
        for (path, a), (_, b) in zip(leaves(batch), leaves(alone), strict=True):
            np.testing.assert_allclose(a[1:2], b, atol=1e-9, err_msg=path)


def test_interpreted_and_compiled_law_agree_to_the_last_bit():
    params = LawParams(fence_enu_m=FENCE, capsules_enu_m=CAPSULES)
    given = random_law_input(8, 150, 6)
    together = oist._covey(*given, params)
    for k in range(150):
        alone = oist._covey(*(one_of(part, slice(k, k + 1)) for part in given), params)
        for one, two in zip(together, alone, strict=True):
            assert one[k].tobytes() == two[0].tobytes()


def test_compiled_runs_repeat_bit_by_bit():
    params = LawParams(fence_enu_m=FENCE, capsules_enu_m=CAPSULES)
    given = random_law_input(3, 200, 5)
    for one, two in zip(oist._covey(*given, params), oist._covey(*given, params), strict=True):
        assert one.tobytes() == two.tobytes()


PROGRAM = """
import sys
import numpy as np
from onboard.control import compiled, oist
sys.path.insert(0, ".")
from tests.onboard.avoidance.test_kernels import flown, leaves
ticks = flown({size}, 3{pick})
assert all(np.isfinite(value).all() for _, value in leaves(ticks[-1].attitude))
print("numba" in sys.modules)
"""


@pytest.mark.parametrize(
    ("size", "pick", "environment", "loads"),
    [(1, ", pick=0", "", "False"), (4, "", "0", "False"), (4, "", "", "True")],
    ids=["a drone never loads numba", "batches fly without it when told so", "batches load it"],
)
def test_who_loads_numba(size, pick, environment, loads):
    program = PROGRAM.format(size=size, pick=pick)
    result = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "COVEY_NUMBA": environment},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == [loads]


def test_warming_up_says_whether_there_is_anything_to_compile(monkeypatch):
    assert compiled.warm_up()
    monkeypatch.setenv(compiled.ENVIRONMENT, "0")
    assert not compiled.warm_up()


def test_whole_numbers_in_a_fleet_file_make_no_other_kind_of_numbers():
    kinds = [type(value) for value in LawParams().numbers]
    other = LawParams(safety_distance_m=1, max_speed_m_s=2, lag_s=0).changed(kappa_1_1_s=4, range_m=8)
    assert [type(value) for value in other.numbers] == kinds


def test_state_has_nothing_left_of_numba_types():
    tick = flown(1, 2, pick=0)[-1]
    assert isinstance(tick.state, State)
    for path, value in leaves(tick):
        assert value.dtype in (np.float64, np.int64, np.bool_), path


def tick_seconds(shape, ticks):
    """Shortest wall time of a whole tick, mocap sample to throttle, with 12 neighbours."""
    rng = np.random.default_rng(2)
    size = int(np.prod(shape))
    around = random_neighbours(rng, size, 12, 2.0)
    pick = (lambda value: value.reshape(*shape, *value.shape[1:])) if shape else (lambda value: value[0])
    around = replace(around, **{f.name: pick(getattr(around, f.name)) for f in fields(around)})
    start = np.zeros((*shape, 3)) + np.array([0.0, 0.0, 1.0])
    goal = Goal(start + np.array([3.0, 0.0, 0.0]), np.zeros(shape), np.ones(shape, np.int64))
    level, half = np.zeros((*shape, 4)) + np.array([1.0, 0.0, 0.0, 0.0]), np.full(shape, 0.5)
    filter_params = kalman.EstimateParams()
    own, memory = kalman.initial(start, params=filter_params), pipeline.initial(PARAMS, start)
    shortest = np.inf
    for _ in range(ticks):
        begin = time.perf_counter()
        own = kalman.drive(own, level, half, half, params=filter_params, dt_s=0.02)
        own = kalman.correct(own, start, 0.02, params=filter_params)
        memory, _ = pipeline.step(memory, kalman.state(own), goal, around, params=PARAMS, dt_s=0.02)
        shortest = min(shortest, time.perf_counter() - begin)
    return shortest


def test_a_tick_is_quick_alone_and_in_a_batch():
    """Twice what an idle machine needs, so that a busy one does not fail: 0.25 ms, and 5 us for each of a thousand."""
    assert tick_seconds((), 300) < 0.6e-3
    assert tick_seconds((1000,), 12) / 1000 < 12e-6
