"""What nobody should send: a finite and bounded thrust, a status that says so, and no warning, in all three forms."""

from dataclasses import fields, replace

import numpy as np
import pytest

from onboard.avoidance import oist
from onboard.config.fleet import load_fleet
from onboard.control import pipeline
from onboard.rollout import compiled
from onboard.types import Goal, LawStatus, Neighbours, State, Thrust

FLEET = load_fleet("configs/fleets/paper.toml")
PARAMS = pipeline.pipeline_params(FLEET, "mav0")
SANE = {LawStatus.INACTIVE, LawStatus.SATURATED, LawStatus.RELAXED}
ANY = {*SANE, LawStatus.INFEASIBLE}


def neighbours_at(*spots, **changes):
    position = np.array(spots, dtype=np.float64).reshape(-1, 3)
    still, zero = np.zeros_like(position), np.zeros(len(position))
    true = np.ones(len(position), bool)
    made = Neighbours(
        position, still, still, position, still, still, zero + 0.04, zero, zero, true, true, true,
        zero + 0.2, zero, still,
    )  # fmt: skip
    return replace(made, **changes)


def filled(neighbours, value):
    changes = {
        field.name: np.full_like(getattr(neighbours, field.name), value)
        for field in fields(neighbours)
        if getattr(neighbours, field.name).dtype == np.float64
    }
    return replace(neighbours, **changes)


def only(name, value):
    two = neighbours_at([1.0, 0.1, 1.0], [-1.2, 0.0, 1.0])
    return replace(two, **{name: np.full_like(getattr(two, name), value)})


TWO = neighbours_at([1.0, 0.1, 1.0], [-1.2, 0.0, 1.0])
BOXED = neighbours_at([0.6, 0, 1], [-0.6, 0, 1], [0, 0.6, 1], [0, -0.6, 1])
TABLE = {
    "nobody at all (N = 1)": (neighbours_at(), {LawStatus.INACTIVE}),
    "everybody masked, holding garbage": (
        replace(filled(TWO, np.nan), is_present=np.zeros(2, bool)),
        {LawStatus.INACTIVE},
    ),
    "not a number": (filled(TWO, np.nan), {LawStatus.INFEASIBLE}),
    "infinite": (filled(TWO, np.inf), {LawStatus.INFEASIBLE}),
    "huge": (filled(TWO, 1e300), SANE),
    "huge and negative": (filled(TWO, -1e300), SANE),
    "on top of us": (neighbours_at([0, 0, 1.0]), {LawStatus.INFEASIBLE}),
    "two on top of us": (neighbours_at([0, 0, 1.0], [0, 0, 1.0]), {LawStatus.INFEASIBLE}),
    "on top of each other": (neighbours_at([0.7, 0, 1.0], [0.7, 0, 1.0]), SANE),
    "at a hair's breadth": (neighbours_at([1e-9, 0, 1.0]), {LawStatus.INFEASIBLE}),
    "inside the safety distance at start": (neighbours_at([0.5, 0, 1.0]), {LawStatus.SATURATED, LawStatus.RELAXED}),
    "all rows parallel": (neighbours_at([0.7, 0, 1], [0.8, 0, 1], [0.9, 0, 1]), SANE),
    "all rows contradictory": (BOXED, {LawStatus.RELAXED}),
    "not cooperating, boxed in": (replace(BOXED, is_cooperative=np.zeros(4, bool)), {LawStatus.RELAXED}),
    "racing towards us": (replace(TWO, predicted_velocity_enu_m_s=np.full((2, 3), -1e4)), SANE),
    **{
        f"{name} = {value}": (only(name, value), ANY)
        for name in ("age_s", "position_std_m", "crowd_count", "lead_time_s", "velocity_std_m_s", "intent_enu_m_s",
                     "acceleration_enu_m_s2", "commanded_acceleration_enu_m_s2", "predicted_velocity_enu_m_s")
        for value in (np.nan, np.inf, -np.inf, 1e300, -1.0)
    },
}  # fmt: skip


def fly(neighbours, batch, position=(0.0, 0.0, 1.0), velocity=(0.0, 0.0, 0.0)):
    p = np.broadcast_to(np.array(position, dtype=np.float64), (*batch, 3)).copy()
    v = np.broadcast_to(np.array(velocity, dtype=np.float64), (*batch, 3)).copy()
    zero = np.zeros(batch)
    state = State(p, v, np.zeros_like(p), zero, zero, zero, zero)
    goal = Goal(np.zeros_like(p) + np.array([1.0, 0.5, 1.0]), zero, np.ones(batch, np.int64))
    around = Neighbours(
        **{f.name: np.broadcast_to(getattr(neighbours, f.name), (*batch, *getattr(neighbours, f.name).shape)).copy()
           for f in fields(neighbours)}
    )  # fmt: skip
    memory = pipeline.initial(PARAMS, np.zeros_like(p) + np.array([0.0, 0.0, 1.0]))
    ticks = []
    for _ in range(5):
        memory, tick = pipeline.step(memory, state, goal, around, params=PARAMS, dt_s=0.02)
        ticks.append(tick)
    return ticks


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("way", ["one vehicle", "compiled batch", "array batch"])
@pytest.mark.parametrize("kind", TABLE)
def test_bad_neighbours_leave_a_bounded_thrust_and_a_status_that_says_so(monkeypatch, kind, way):
    neighbours, statuses = TABLE[kind]
    if way == "array batch":
        monkeypatch.setattr(compiled, "uses_kernel", lambda size: False)
    ticks = fly(neighbours, () if way == "one vehicle" else (3,))
    for tick in ticks:
        thrust = tick.law.thrust.thrust_enu_m_s2
        limit = oist.horizontal_limit(thrust[..., 2], params=PARAMS.law)
        assert np.isfinite(thrust).all()
        assert (np.hypot(thrust[..., 0], thrust[..., 1]) <= 1.5 * limit + 1e-6).all()  # half of it may be compensation
        assert np.isfinite(tick.attitude.quaternion_wxyz).all()
        assert ((tick.attitude.thrust_frac >= 0.0) & (tick.attitude.thrust_frac <= 1.0)).all()
        assert np.isfinite(tick.law.slack_m_s2).all()
        assert tick.is_finite.all()
    # later the own commands have moved the prediction off a neighbour that was on top of us
    assert {int(status) for status in ticks[0].law.status.reshape(-1)} <= statuses


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("batch", [(), (3,)], ids=["one", "many"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_bad_own_state_is_levelled_and_said_so(bad, batch):
    for position, velocity in (([bad] * 3, [0.0] * 3), ([0.0, 0.0, 1.0], [bad] * 3)):
        tick = fly(TWO, batch, position, velocity)[-1]
        assert (tick.law.status == LawStatus.INFEASIBLE).all()
        assert not tick.is_finite.any()
        assert np.isfinite(tick.law.thrust.thrust_enu_m_s2).all()
        assert np.isfinite(tick.attitude.quaternion_wxyz).all()


@pytest.mark.filterwarnings("error")
def test_zero_relative_velocity_at_the_design_distance_asks_for_nothing():
    tick = fly(neighbours_at([-PARAMS.law.d_design_m - 0.01, 0.0, 1.0]), (), velocity=(0.0, 0.0, 0.0))[-1]
    assert int(tick.law.status) in SANE
    assert tick.law.intervention_m_s2 == pytest.approx(0.0, abs=1e-9)


GARBAGE = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e154, 1e9, 0.0, -0.0, 5e-324, 0.8)


def littered(rng, shape, scale, share):
    return np.where(rng.random(shape) < share, rng.choice(GARBAGE, shape), rng.normal(0.0, scale, shape))


def row(values, place):
    return type(values)(*(getattr(values, field.name)[place] for field in fields(values)))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("has_kernels", [True, False], ids=["kernels", "arrays"])
@pytest.mark.parametrize("seed", range(12))
def test_garbage_anywhere_is_bounded_and_the_same_for_one_vehicle_and_many(monkeypatch, seed, has_kernels):
    if not has_kernels:
        monkeypatch.setattr(compiled, "uses_kernel", lambda size: False)
    rng = np.random.default_rng(seed)
    for _ in range(8):
        count, around, name = 4, int(rng.integers(0, 6)), str(rng.choice(["covey", "covey", "paper", "off"]))
        params = replace(PARAMS.law.changed(name=name), fence_enu_m=(-2.0, 2.0, -2.0, 2.0))
        theirs, own = rng.choice([0.0, 0.1, 1.0]), rng.choice([0.0, 0.1, 0.5])
        vectors = [littered(rng, (count, around, 3), 1.5, theirs) for _ in range(7)]
        scalars = [littered(rng, (count, around), 0.1, theirs) for _ in range(5)]
        masks = [rng.random((count, around)) < 0.8 for _ in range(3)]
        neighbours = Neighbours(*vectors[:6], *scalars[:3], *masks, *scalars[3:], vectors[6])
        state = State(
            *(littered(rng, (count, 3), 1.0, own) for _ in range(3)),
            *(littered(rng, (count,), 0.05, own) for _ in range(4)),
        )
        thrust = littered(rng, (count, 3), 2.0, own) + np.array([0.0, 0.0, 9.8])
        compensation = littered(rng, (count, 3), 0.5, own)
        memory, alone = oist.initial((count,)), [oist.initial(()) for _ in range(count)]
        for _ in range(2):
            given = {"params": params, "dt_s": 0.02}
            predicted = oist.predict(memory, state, params=params)
            memory, out = oist.saturate(
                memory, Thrust(thrust), predicted, state, neighbours, compensation_enu_m_s2=compensation, **given
            )
            safe = out.thrust.thrust_enu_m_s2
            assert np.isfinite(safe).all()
            known = np.where(oist.is_plausible(compensation)[:, None], compensation, 0.0)
            limit = oist.horizontal_limit(safe[:, 2], params=params)
            assert (np.hypot(*(safe + known)[:, :2].T) <= limit + 1e-6).all()
            unusable = ~(oist.is_plausible(thrust) & oist.is_plausible(compensation))
            assert (out.status[unusable] == LawStatus.INFEASIBLE).all()
            for k in range(count):
                mine = row(state, k)
                alone[k], one = oist.saturate(
                    alone[k], Thrust(thrust[k]), oist.predict(alone[k], mine, params=params), mine,
                    row(neighbours, k), compensation_enu_m_s2=compensation[k], **given,
                )  # fmt: skip
                np.testing.assert_allclose(one.thrust.thrust_enu_m_s2, safe[k], rtol=0.0, atol=1e-9)
                assert int(one.status) == int(out.status[k])
