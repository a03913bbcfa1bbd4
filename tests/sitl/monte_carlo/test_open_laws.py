"""Other people's laws: each has a name, avoids, and is as good as an independent form of it."""

import itertools
import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from onboard.avoidance.own_law import LawInputs, LawNeighbour, judged
from onboard.avoidance.params import Capsule
from onboard.avoidance.prediction import Motion
from onboard.config.law_import import GROUP, find_own_law
from onboard.constants import GRAVITY_M_S2
from onboard.types import Thrust
from onboard.vectors import Vec2, Vec3
from sitl.monte_carlo import batch_flight
from sitl.monte_carlo.open_benchmark import laws, scene_file, scene_plans
from sitl.monte_carlo.open_benchmark.judged_law import JudgedLaw
from sitl.monte_carlo.open_benchmark.laws import around, orca
from tests.onboard.avoidance.law_cases import law_of, state_of, vec

REPOSITORY = Path(__file__).parents[3]
FILES = {path.stem for path in Path(laws.__path__[0]).glob("*.py")}
NAMES = sorted(name.replace("_", "-") for name in FILES - {"__init__", "around", "covey"})


def function_of(name):
    file_name = name.replace("-", "_")
    law = find_own_law(f"sitl.monte_carlo.open_benchmark.laws.{file_name}:law", [], "test")
    return law.load()


def inputs_of(position, velocity, wanted, others=(), obstacles=()):
    """One vehicle; ``others`` are pairs of position and velocity."""
    neighbours = []
    for index, (other_m, other_m_s) in enumerate(others):
        neighbour = LawNeighbour(
            e_m=Vec2(position[0] - other_m[0], position[1] - other_m[1]),
            w_m_s=Vec2(velocity[0] - other_m_s[0], velocity[1] - other_m_s[1]),
            d_m=0.9,
            is_cooperative=True,
            table_index=index,
        )
        neighbours.append(neighbour)
    vehicle = law_of()
    return LawInputs(
        state=state_of((*position, 1.0), (*velocity, 0.0)),
        predicted=Motion(vec((*position, 1.0)), vec((*velocity, 0.0))),
        baseline=Thrust(vec((*wanted, GRAVITY_M_S2))),
        compensation_enu_m_s2=Vec3(0.0, 0.0, 0.0),
        intent_enu_m_s=vec((*wanted, 0.0)),
        neighbours=tuple(neighbours),
        received=(),
        obstacles=tuple(obstacles),
        fence=vehicle.fence,
        largest_m_s2=4.5,
        vehicle=vehicle,
        dt_s=0.02,
    )


def test_each_law_has_an_entry_point_and_no_entry_point_lacks_its_law():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    written = project["project"]["entry-points"][GROUP]
    assert written == {
        name: f"sitl.monte_carlo.open_benchmark.laws.{name.replace('-', '_')}:law" for name in NAMES
    }
    assert len(NAMES) >= 10


@pytest.mark.parametrize("name", NAMES)
def test_a_law_flies_the_baseline_while_it_is_alone_and_brakes_before_another_vehicle(name):
    law = function_of(name)
    alone = inputs_of((0.0, 0.0), (0.5, 0.0), (0.2, 0.0))
    memory, thrust, refusal = judged(law(None, alone), alone)
    assert not refusal
    if name != "rbl":  # it chooses its own speed
        np.testing.assert_allclose(thrust[:2], (0.2, 0.0), atol=1e-9)

    head_on = inputs_of((0.0, 0.0), (0.8, 0.0), (0.5, 0.0), [((1.05, 0.02), (-0.8, 0.0))])
    _, braking, refusal = judged(law(memory, head_on), head_on)
    assert not refusal
    assert braking.x < 0.0


@pytest.mark.parametrize("name", NAMES)
def test_a_law_brakes_before_a_wall_and_flies_whatever_it_is_given(name):
    law = function_of(name)
    wall = Capsule(Vec2(0.6, -2.0), Vec2(0.6, 2.0), 0.1)
    before = inputs_of((0.0, 0.0), (0.8, 0.0), (0.5, 0.0), obstacles=[wall])
    _, thrust, refusal = judged(law(None, before), before)
    assert not refusal
    assert thrust.x < 0.0

    rng = np.random.default_rng(2)
    memory = None
    for _ in range(10):
        others = [(rng.normal(0.0, 0.7, 2), rng.normal(0.0, 0.7, 2)) for _ in range(8)]
        some = inputs_of((0.0, 0.0), rng.normal(0.0, 0.7, 2), rng.normal(0.0, 2.0, 2), others)
        memory, _, refusal = judged(law(memory, some), some)
        assert not refusal


def test_the_nearest_point_of_half_planes_is_the_best_of_all_feet_and_corners():
    rng = np.random.default_rng(3)
    for _ in range(60):
        angles = rng.uniform(0.0, 2.0 * math.pi, 5)
        rows = [
            around.HalfPlane(Vec2(math.cos(angle), math.sin(angle)), bound)
            for angle, bound in zip(angles, rng.uniform(-1.0, 0.2, 5).tolist(), strict=True)
        ]
        point = np.array(rng.normal(0.0, 1.5, 2))
        normals = np.array([row.normal for row in rows])
        bounds = np.array([row.bound for row in rows])

        feet = point + (bounds - normals @ point)[:, None] * normals
        corners = [
            np.linalg.solve(normals[[i, j]], bounds[[i, j]])
            for i, j in itertools.combinations(range(5), 2)
        ]
        candidates = np.concatenate([[point], feet, corners])
        holds = (candidates @ normals.T >= bounds - 1e-9).all(axis=1)
        if not holds.any():
            continue  # these rows have no point in common
        best = np.linalg.norm(candidates[holds] - point, axis=1).min()

        found = np.array(around.nearest(Vec2(*point.tolist()), rows))
        assert (normals @ found >= bounds - 1e-6).all()
        assert np.linalg.norm(found - point) == pytest.approx(best, abs=1e-6)


def test_rows_that_cannot_all_hold_give_way_by_the_same_amount():
    rows = [around.HalfPlane(Vec2(1.0, 0.0), 0.5), around.HalfPlane(Vec2(-1.0, 0.0), 0.5)]
    found = around.nearest(Vec2(3.0, 1.0), rows)
    assert found.x == pytest.approx(0.0, abs=0.31)
    assert found.y == pytest.approx(1.0)


def test_a_row_of_orca_is_that_of_the_library_of_its_authors():
    pyrvo = pytest.importorskip("pyrvo")
    rng = np.random.default_rng(5)
    for _ in range(40):
        other_m, own_m_s, other_m_s = rng.normal(0.0, 1.2, (3, 2))
        if np.hypot(*other_m) < 1.0:
            continue
        simulator = pyrvo.RVOSimulator(0.02, 100.0, 5, 4.0, 4.0, 0.45, 50.0)
        for place, speed in (((0.0, 0.0), own_m_s), (tuple(other_m), other_m_s)):
            agent = simulator.add_agent(place)
            simulator.set_agent_velocity(agent, tuple(speed))
            simulator.set_agent_pref_velocity(agent, tuple(speed))
        simulator.do_step()
        expected = simulator.get_agent_velocity(0).to_tuple()

        inputs = inputs_of((0.0, 0.0), own_m_s, (0.0, 0.0), [(other_m, other_m_s)])
        (body,) = around.bodies(inputs)
        velocity = Vec2(*own_m_s.tolist())
        row = orca.orca_row(body, velocity, 0.5, 4.0)
        np.testing.assert_allclose(around.nearest(velocity, [row]), expected, atol=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_law_keeps_two_vehicles_apart_that_change_places(name):
    placing = {"type": "circle", "vehicles": 2, "radius_m": 2.0}
    data = {"schema": 1, "name": "pair", "about": "Two.", "placing": placing, "within_s": 30}
    scene = scene_file.parsed(json.dumps(data).encode(), "pair.json")
    judge = JudgedLaw(scene_plans.setup(scene, law=name))
    plans = [scene_plans.plan(scene, 7)]
    (flown,) = batch_flight.fly(plans, judge.setup, controller=judge.interpreted)
    assert not flown.law_refusal
    assert judge.calls > 100
    # potentials and flocks only push: near each other, but not within each other
    assert flown.outcome.min_separation_m > 0.65
    assert flown.outcome.is_success
