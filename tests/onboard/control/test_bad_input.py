"""What nobody should send: a finite and bounded thrust, and a status that says so."""

import math
from typing import Any

import numpy as np
import pytest

from onboard.avoidance import interface, oist
from onboard.avoidance.params import Walls
from onboard.avoidance.prediction import LARGEST
from onboard.config.fleet import load_fleet
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.types import Goal, LawStatus, Neighbour, State, Thrust
from onboard.vectors import ZERO_3, Vec3, is_within

FLEET = load_fleet("configs/fleets/paper.toml")
PARAMS = pipeline.pipeline_params(FLEET, "mav0")
SANE = {LawStatus.INACTIVE, LawStatus.SATURATED, LawStatus.RELAXED}
ANY = {*SANE, LawStatus.INFEASIBLE}
VECTORS = [name for name, kind in Neighbour.__annotations__.items() if "Vec3" in str(kind)]
NUMBERS = [name for name, kind in Neighbour.__annotations__.items() if "float" in str(kind)]


def neighbours_at(*spots, **changes):
    return [
        Neighbour(
            position_enu_m=Vec3(*map(float, p)),
            velocity_enu_m_s=ZERO_3,
            acceleration_enu_m_s2=ZERO_3,
            predicted_position_enu_m=Vec3(*map(float, p)),
            predicted_velocity_enu_m_s=ZERO_3,
            commanded_acceleration_enu_m_s2=ZERO_3,
            intent_enu_m_s=ZERO_3,
            age_s=0.04,
            lead_time_s=0.2,
            position_std_m=0.0,
            velocity_std_m_s=0.0,
            crowd_count=0.0,
            is_cooperative=True,
            is_paper_obstacle=True,
            table_index=index,
            radius_m=0.0,
        )._replace(**changes)
        for index, p in enumerate(spots)
    ]


def only(value, *names):
    changes = {name: Vec3(value, value, value) if name in VECTORS else value for name in names}
    return neighbours_at([1.0, 0.1, 1.0], [-1.2, 0.0, 1.0], **changes)


def filled(value):
    return only(value, *VECTORS, *NUMBERS)


TABLE = {
    "nobody at all (N = 1)": ([], {LawStatus.INACTIVE}),
    "not a number": (filled(math.nan), {LawStatus.INFEASIBLE}),
    "infinite": (filled(math.inf), {LawStatus.INFEASIBLE}),
    "huge": (filled(1e300), SANE),
    "huge and negative": (filled(-1e300), SANE),
    "on top of us": (neighbours_at([0, 0, 1.0]), {LawStatus.INFEASIBLE}),
    "two on top of us": (neighbours_at([0, 0, 1.0], [0, 0, 1.0]), {LawStatus.INFEASIBLE}),
    "on top of each other": (neighbours_at([0.7, 0, 1.0], [0.7, 0, 1.0]), SANE),
    "at a hair's breadth": (neighbours_at([1e-9, 0, 1.0]), {LawStatus.INFEASIBLE}),
    "inside the safety distance at start": (
        neighbours_at([0.5, 0, 1.0]),
        {LawStatus.SATURATED, LawStatus.RELAXED},
    ),
    "all rows parallel": (neighbours_at([0.7, 0, 1], [0.8, 0, 1], [0.9, 0, 1]), SANE),
    "all rows contradictory": (
        neighbours_at([0.6, 0, 1], [-0.6, 0, 1], [0, 0.6, 1], [0, -0.6, 1]),
        {LawStatus.RELAXED},
    ),
    "not cooperating, boxed in": (
        neighbours_at([0.6, 0, 1], [-0.6, 0, 1], [0, 0.6, 1], [0, -0.6, 1], is_cooperative=False),
        {LawStatus.RELAXED},
    ),
    "racing towards us": (only(-1e4, "predicted_velocity_enu_m_s"), SANE),
    **{
        f"{name} = {value}": (only(value, name), ANY)
        for name in (
            *NUMBERS,
            "intent_enu_m_s",
            "acceleration_enu_m_s2",
            "commanded_acceleration_enu_m_s2",
            "predicted_velocity_enu_m_s",
        )
        for value in (math.nan, math.inf, -math.inf, 1e300, -1.0)
    },
}


def fly(neighbours, position=(0.0, 0.0, 1.0), velocity=(0.0, 0.0, 0.0)):
    state = State(
        position_enu_m=Vec3(*position),
        velocity_enu_m_s=Vec3(*velocity),
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=0.0,
        age_s=0.0,
        position_std_m=0.0,
        velocity_std_m_s=0.0,
    )
    goal = Goal(Vec3(1.0, 0.5, 1.0), 0.0, 1)
    memory = pipeline.initial(PARAMS, Vec3(0.0, 0.0, 1.0))
    ticks = []
    for _ in range(5):
        memory, tick = pipeline.step(
            memory, state, goal, neighbours, (), ControlMode.FLYING, PARAMS, 0.02
        )
        ticks.append(tick)
    return ticks


def test_bad_neighbours_leave_a_bounded_thrust_and_a_status_that_says_so():
    for kind, (neighbours, statuses) in TABLE.items():
        ticks = fly(neighbours)
        for tick in ticks:
            thrust = tick.law.thrust.thrust_enu_m_s2
            limit = interface.horizontal_limit(thrust.z, PARAMS.law)
            assert np.isfinite(thrust).all(), kind
            # half of it may be compensation
            assert math.hypot(thrust.x, thrust.y) <= 1.5 * limit + 1e-6, kind
            assert np.isfinite(tick.attitude.quaternion_wxyz).all(), kind
            assert 0.0 <= tick.attitude.thrust_frac <= 1.0, kind
            assert math.isfinite(tick.law.slack_m_s2), kind
            assert tick.is_finite, kind
        # later the own commands have moved the prediction off a neighbour that was on top of us
        assert ticks[0].law.status in statuses, kind


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
def test_bad_own_state_is_levelled_and_said_so(bad):
    for position, velocity in (([bad] * 3, [0.0] * 3), ([0.0, 0.0, 1.0], [bad] * 3)):
        tick = fly(TABLE["huge"][0], position, velocity)[-1]
        assert tick.law.status == LawStatus.INFEASIBLE
        assert not tick.is_finite
        assert np.isfinite(tick.law.thrust.thrust_enu_m_s2).all()
        assert np.isfinite(tick.attitude.quaternion_wxyz).all()


def test_zero_relative_velocity_at_the_design_distance_asks_for_nothing():
    spacing = PARAMS.law.spacing
    tick = fly(neighbours_at([-spacing.safety_distance_m - spacing.margin_m - 0.01, 0.0, 1.0]))[-1]
    assert tick.law.status in SANE
    assert tick.law.intervention_m_s2 == pytest.approx(0.0, abs=1e-9)


GARBAGE = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e154, 1e9, 0.0, -0.0, 5e-324, 0.8)


class Litter:
    """Numbers and vectors of which a share is garbage."""

    def __init__(self, rng, share):
        self.rng = rng
        self.share = share

    def number(self, scale):
        is_garbage = self.rng.random() < self.share
        return float(self.rng.choice(GARBAGE)) if is_garbage else float(self.rng.normal(0.0, scale))

    def vector(self, scale):
        return Vec3(self.number(scale), self.number(scale), self.number(scale))

    def neighbour(self, index):
        cooperates, is_obstacle = (bool(self.rng.random() < 0.8) for _ in range(2))
        vectors = [self.vector(1.5) for _ in VECTORS]
        numbers = [self.number(0.1) for _ in NUMBERS]
        values: list[Any] = [*vectors, *numbers, cooperates, is_obstacle, index]
        return Neighbour(*values)

    def state(self):
        return State(*(self.vector(1.0) for _ in range(3)), *(self.number(0.05) for _ in range(4)))


@pytest.mark.parametrize("seed", range(12))
def test_garbage_anywhere_is_bounded(seed):
    rng = np.random.default_rng(seed)
    for _ in range(32):
        law = pipeline.pipeline_params(
            FLEET, "mav0", str(rng.choice(["covey", "covey", "paper", "off"]))
        ).law
        params = law._replace(fence=Walls(-2.0, 2.0, -2.0, 2.0))
        theirs = Litter(rng, rng.choice([0.0, 0.1, 1.0]))
        own = Litter(rng, rng.choice([0.0, 0.1, 0.5]))
        neighbours = [theirs.neighbour(index) for index in range(int(rng.integers(0, 6)))]
        state = own.state()
        compensation = own.vector(0.5)
        x, y, z = own.vector(2.0)
        thrust = Vec3(x, y, z + 9.8)
        memory = oist.initial()
        for _ in range(2):
            predicted = oist.predict(memory, state, params, 0.02)
            baseline = interface.Baseline(Thrust(thrust), compensation, own.vector(1.0))
            memory, out = oist.step(
                memory, baseline, predicted, state, neighbours, (), params, 0.02
            )
            safe = out.thrust.thrust_enu_m_s2
            assert np.isfinite(safe).all()
            is_known = is_within(compensation, LARGEST)
            known = compensation if is_known else ZERO_3
            limit = interface.horizontal_limit(safe.z, params)
            assert math.hypot(safe.x + known.x, safe.y + known.y) <= limit + 1e-6
            if not (is_known and is_within(thrust, LARGEST)):
                assert out.status == LawStatus.INFEASIBLE
