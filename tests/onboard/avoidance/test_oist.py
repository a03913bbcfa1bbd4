"""The avoidance law for N neighbours: signs, symmetries, limits and bad input."""

from dataclasses import fields, replace

import numpy as np
import pytest

from onboard.avoidance import constraints, oist
from onboard.types import GRAVITY_M_S2, LawStatus, Neighbours, State, Thrust

PARAMS = oist.LawParams(lag_s=0.15)


def state_of(position, velocity):
    shape = np.shape(position)[:-1]
    zero = np.zeros(shape)
    p, v = np.asarray(position, float), np.asarray(velocity, float)
    return State(p, v, np.zeros((*shape, 3)), zero, zero, zero, zero)


def neighbours_of(position, velocity, command=None, **changes):
    position, velocity = np.asarray(position, float), np.asarray(velocity, float)
    command = np.zeros_like(position) if command is None else np.asarray(command, float)
    shape = position.shape[:-1]
    zero, true = np.zeros(shape), np.ones(shape, bool)
    first = true & (np.arange(shape[-1]) == 0)
    made = Neighbours(
        position, velocity, command, position, velocity, command, zero, zero, zero, true, true, first
    )  # fmt: skip
    return replace(made, **changes)


def run(position, velocity, accel, neighbours, params=PARAMS, **options):
    thrust = np.asarray(accel, float) + np.array([0, 0, GRAVITY_M_S2])
    batch = thrust.shape[:-1]
    memory = oist.initial(batch)
    state = state_of(position, velocity)
    predicted = oist.predict(memory, state, params=params)
    _, out = oist.saturate(memory, Thrust(thrust), predicted, state, neighbours, params=params, dt_s=0.02, **options)
    return out


def random_case(seed, batch=(), count=4):
    rng = np.random.default_rng(seed)
    draw = lambda *s, scale: rng.normal(size=(*batch, *s, 3)) * scale  # noqa: E731
    spots = draw(count, scale=0.8)
    spots[..., :2] += np.sign(spots[..., :2]) * 0.5
    neighbours = neighbours_of(spots, draw(count, scale=0.3), draw(count, scale=0.5))
    return draw(scale=0.1), draw(scale=0.3), draw(scale=1.5), neighbours


def mapped(neighbours, function):
    values = {field.name: getattr(neighbours, field.name) for field in fields(neighbours)}
    return Neighbours(**{name: function(name, value) for name, value in values.items() if value is not None})


def test_vehicle_flying_at_a_neighbour_is_braked_and_turned_counter_clockwise():
    out = run([0, 0, 1], [1, 0, 0], [2, 0, 0], neighbours_of([[1.3, 0, 1]], [[0, 0, 0]]))
    assert out.status == LawStatus.SATURATED
    assert out.thrust.thrust_enu_m_s2[0] < 0.0
    assert out.thrust.thrust_enu_m_s2[1] < 0.0  # seen from the neighbour it starts to circle it to the left
    assert out.active_neighbour == 0


def test_vehicle_flying_away_is_left_alone_bit_for_bit():
    out = run([0, 0, 1], [-1, 0, 0], [-1, 0.3, 0.1], neighbours_of([[1.3, 0, 1]], [[0, 0, 0]]))
    assert out.status == LawStatus.INACTIVE
    np.testing.assert_array_equal(out.thrust.thrust_enu_m_s2[:2], [-1, 0.3])
    assert out.intervention_m_s2 == 0.0
    assert out.active_neighbour == -1


def test_height_is_never_touched():
    for seed in range(30):
        p, v, a, neighbours = random_case(seed)
        out = run(p, v, a, neighbours)
        assert out.thrust.thrust_enu_m_s2[2] == a[2] + GRAVITY_M_S2


def test_two_vehicles_seeing_the_same_pair_share_the_work_equally():
    left = run([0, 0, 1], [0.8, 0, 0], [0, 0, 0], neighbours_of([[1.4, 0, 1]], [[-0.8, 0, 0]]))
    right = run([1.4, 0, 1], [-0.8, 0, 0], [0, 0, 0], neighbours_of([[0, 0, 1]], [[0.8, 0, 0]]))
    np.testing.assert_allclose(left.thrust.thrust_enu_m_s2[:2], -right.thrust.thrust_enu_m_s2[:2], atol=1e-12)


def test_neighbour_that_does_not_deliver_its_half_gets_more_from_us():
    idle = run([0, 0, 1], [0.4, 0, 0], [0, 0, 0], neighbours_of([[1.2, 0, 1]], [[-0.4, 0, 0]]))
    helping = run([0, 0, 1], [0.4, 0, 0], [0, 0, 0], neighbours_of([[1.2, 0, 1]], [[-0.4, 0, 0]], [[5.0, 0, 0]]))
    assert idle.intervention_m_s2 > helping.intervention_m_s2 > 0


def test_neighbour_that_does_not_cooperate_gets_the_full_share():
    base = replace(neighbours_of([[1.3, 0, 1]], [[-0.4, 0, 0]]), predicted_position_enu_m=np.array([[1.24, 0, 1]]))
    alone = run([0, 0, 1], [0.4, 0, 0], [0, 0, 0], replace(base, is_cooperative=np.array([False])))
    shared = run([0, 0, 1], [0.4, 0, 0], [0, 0, 0], base)
    assert alone.intervention_m_s2 > shared.intervention_m_s2


def test_one_neighbour_with_full_share_and_no_lag_obeys_equation_17():
    params = replace(PARAMS, lag_s=0.0).changed(kappa_1_1_s=2.0, kappa_2_1_s=2.0, uncooperative_margin_m=0.0)
    hit = 0
    for seed in range(60):
        p, v, a, neighbours = random_case(seed, count=1)
        neighbours = replace(neighbours, is_cooperative=np.array([False]))
        out = run(p, v, a, neighbours, params)
        e, w = p[:2] - neighbours.position_enu_m[0, :2], v[:2] - neighbours.velocity_enu_m_s[0, :2]
        need = -(w @ w) - 4.0 * (e @ w) - 2.0 * (e @ e - 0.81)
        if out.status == LawStatus.SATURATED:
            hit += 1
            assert e @ out.thrust.thrust_enu_m_s2[:2] >= need - 1e-8
    assert hit > 10


def test_turning_and_shifting_the_world_turns_the_thrust():
    angle, shift = 1.1, np.array([5.0, -3.0, 0.5])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])

    def move(name, values):
        if "position_enu" in name:
            return values @ turn.T + shift
        return values @ turn.T if values.ndim and values.shape[-1:] == (3,) and "enu" in name else values

    for seed in range(40):
        p, v, a, neighbours = random_case(seed)
        plain = run(p, v, a, neighbours)
        moved = run(turn @ p + shift, turn @ v, turn @ a, mapped(neighbours, move))
        np.testing.assert_allclose(moved.thrust.thrust_enu_m_s2, turn @ plain.thrust.thrust_enu_m_s2, atol=1e-6)
        assert moved.status == plain.status


def test_order_of_neighbours_does_not_matter():
    order = np.array([2, 0, 3, 1])
    for seed in range(40):
        p, v, a, neighbours = random_case(seed)
        plain = run(p, v, a, neighbours)
        shuffled = run(p, v, a, mapped(neighbours, lambda name, values: values[order]))
        np.testing.assert_allclose(shuffled.thrust.thrust_enu_m_s2, plain.thrust.thrust_enu_m_s2, atol=1e-6)
        if plain.active_neighbour >= 0:
            assert order[shuffled.active_neighbour] == plain.active_neighbour


def test_distance_rows_scale_with_length_and_time():
    rng = np.random.default_rng(0)
    e, w, u = rng.normal(size=(3, 50, 4, 2))
    length, time, full, d = 3.0, 0.5, rng.random((50, 4)) < 0.3, rng.uniform(0.8, 1.2, (50, 4))
    kappas = {f"kappa_{k}_1_s": getattr(PARAMS.config, f"kappa_{k}_1_s") / time for k in (1, 2, 3, 4)}
    scaled = PARAMS.changed(v_perp_m_s=PARAMS.config.v_perp_m_s * length / time, **kappas)
    _, plain = constraints.distance_rows(e, w, d, u, full, n=PARAMS.numbers)
    big_u = u * length / time**2
    _, big = constraints.distance_rows(e * length, w * length / time, d * length, big_u, full, n=scaled.numbers)
    np.testing.assert_allclose(big, plain * length / time**2, rtol=1e-9)


def test_batch_equals_loop():
    p, v, a, neighbours = random_case(7, batch=(60,))
    together = run(p, v, a, neighbours)
    for k in range(60):
        alone = run(p[k], v[k], a[k], mapped(neighbours, lambda name, values, k=k: values[k]))
        np.testing.assert_allclose(alone.thrust.thrust_enu_m_s2, together.thrust.thrust_enu_m_s2[k], atol=1e-7)
        assert alone.status == together.status[k]
        assert alone.crowd_count == together.crowd_count[k]
        assert alone.active_neighbour == together.active_neighbour[k]


def test_masked_neighbours_count_for_nothing_whatever_they_hold():
    p, v, a, neighbours = random_case(3)
    plain = run(p, v, a, mapped(neighbours, lambda name, values: values[:2]))
    garbage = mapped(neighbours, lambda name, values: values.copy())
    for name in ("position_enu_m", "predicted_position_enu_m", "commanded_acceleration_enu_m_s2", "age_s"):
        getattr(garbage, name)[2:] = np.nan
    masked = run(p, v, a, replace(garbage, is_present=np.array([True, True, False, False])))
    np.testing.assert_allclose(masked.thrust.thrust_enu_m_s2, plain.thrust.thrust_enu_m_s2, atol=1e-12)
    assert masked.status == plain.status


def test_no_neighbours_at_all_change_nothing():
    empty = neighbours_of(np.zeros((0, 3)), np.zeros((0, 3)))
    out = run([0, 0, 1], [0, 0, 0], [1.0, 2.0, 0], empty)
    np.testing.assert_array_equal(out.thrust.thrust_enu_m_s2[:2], [1.0, 2.0])


def test_thrust_and_compensation_together_stay_within_the_tilt_limit():
    for seed in range(60):
        p, v, a, neighbours = random_case(seed)
        extra = np.random.default_rng(seed).normal(size=3)
        out = run(p, v, 3 * a, neighbours, compensation_enu_m_s2=extra)
        total = out.thrust.thrust_enu_m_s2[:2] + extra[:2]
        limit = oist.horizontal_limit(out.thrust.thrust_enu_m_s2[2], params=PARAMS)
        assert np.hypot(*total) <= limit + 1e-6


def test_squeezed_vehicle_is_relaxed_with_its_slack_and_slows_the_pursuit_down():
    around = [[0.5, 0, 1], [-0.25, 0.43, 1], [-0.25, -0.43, 1]]
    towards = [[-2.0, 0, 0], [1.0, -1.7, 0], [1.0, 1.7, 0]]
    memory, state = oist.initial(()), state_of([0, 0, 1], [0, 0, 0])
    thrust = Thrust(np.array([0, 0, GRAVITY_M_S2]))
    for _ in range(20):
        predicted = oist.predict(memory, state, params=PARAMS)
        memory, out = oist.saturate(
            memory, thrust, predicted, state, neighbours_of(around, towards), params=PARAMS, dt_s=0.02
        )
    assert out.status == LawStatus.RELAXED
    assert out.slack_m_s2 > 0
    assert out.crowd_count == 3
    assert oist.speed_share(memory, params=PARAMS) < 0.5


def test_law_off_is_the_identity_within_the_tilt_limit():
    p, v, a, neighbours = random_case(1)
    out = run(p, v, 0.5 * a, neighbours, PARAMS.changed(name="off"))
    np.testing.assert_array_equal(out.thrust.thrust_enu_m_s2, 0.5 * a + [0, 0, GRAVITY_M_S2])
    assert out.status == LawStatus.INACTIVE


def test_paper_law_sees_the_ring_successor_only():
    near, far = [0.9, 0, 1], [5.0, 5.0, 1]
    still = np.zeros((2, 3))
    paper = PARAMS.changed(name="paper")
    ignoring = run([0, 0, 1], [0.5, 0, 0], [0, 0, 0], neighbours_of([far, near], still), paper)
    heeding = run([0, 0, 1], [0.5, 0, 0], [0, 0, 0], neighbours_of([near, far], still), paper)
    assert ignoring.status == LawStatus.INACTIVE
    assert heeding.status == LawStatus.SATURATED
    assert heeding.thrust.thrust_enu_m_s2[0] < 0


BAD = {
    "coincident": lambda n: replace(n, predicted_position_enu_m=np.zeros((4, 3))),
    "not a number": lambda n: mapped(n, lambda k, x: np.full_like(x, np.nan) if x.dtype == float else x),
    "huge": lambda n: mapped(n, lambda k, x: np.full_like(x, 1e300) if x.dtype == float else x),
    "huge and fast": lambda n: replace(n, predicted_velocity_enu_m_s=np.full((4, 3), -1e300)),
    "endless": lambda n: replace(n, predicted_velocity_enu_m_s=np.full((4, 3), np.inf)),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("law", ["covey", "paper", "off"])
@pytest.mark.parametrize("kind", BAD)
def test_bad_neighbours_give_a_bounded_thrust_and_no_warning(kind, law):
    _, _, _, neighbours = random_case(0)
    out = run(np.zeros(3), np.zeros(3), [1.0, 1.0, 0.0], BAD[kind](neighbours), PARAMS.changed(name=law))
    assert np.isfinite(out.thrust.thrust_enu_m_s2).all()
    assert np.hypot(*out.thrust.thrust_enu_m_s2[:2]) <= GRAVITY_M_S2
    if law == "covey" and kind in ("coincident", "not a number"):
        assert out.status == LawStatus.INFEASIBLE


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e300])
def test_bad_own_values_level_the_thrust_and_say_so(bad):
    _, _, _, neighbours = random_case(0)
    out = run(np.full(3, bad), np.zeros(3), np.full(3, bad), neighbours)
    assert np.isfinite(out.thrust.thrust_enu_m_s2).all()
    if not np.isfinite(bad):
        assert out.status == LawStatus.INFEASIBLE


def test_vehicles_that_start_inside_the_safety_distance_move_apart():
    out = run([0, 0, 1], [0, 0, 0], [0, 0, 0], neighbours_of([[0.5, 0, 1]], [[0, 0, 0]]))
    limit = oist.horizontal_limit(np.array(GRAVITY_M_S2), params=PARAMS)
    assert out.thrust.thrust_enu_m_s2[0] == pytest.approx(-limit)  # more is asked than the tilt limit gives
    assert out.status == LawStatus.RELAXED


def test_parallel_and_contradicting_rows_stay_bounded():
    line = [[0.5, 0, 1], [0.6, 0, 1], [-0.5, 0, 1], [-0.6, 0, 1]]
    out = run([0, 0, 1], [0, 0, 0], [0, 0, 0], neighbours_of(line, np.zeros((4, 3))))
    assert np.isfinite(out.thrust.thrust_enu_m_s2).all()
    assert out.status in (LawStatus.SATURATED, LawStatus.RELAXED)
