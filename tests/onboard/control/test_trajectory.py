"""Guidance: continuous, bounded, on time, equivariant."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from onboard import frames
from onboard.control import trajectory
from onboard.control.trajectory import GuidanceMemory, GuidanceParams
from onboard.types import Array, Goal, TrajectorySetpoint

PARAMS = GuidanceParams(max_speed_m_s=1.0, max_acceleration_m_s2=1.5)
DT = 0.02


def goal(position: object, sequence: int = 1, duration: float = 0.0) -> Goal:
    p = np.array(position, dtype=float)
    shape = p.shape[:-1]
    return Goal(p, np.full(shape, duration), np.full(shape, sequence))


def fly(
    memory: GuidanceMemory, target: Goal, seconds: float, params: GuidanceParams = PARAMS, rate: float = 1.0
) -> tuple[GuidanceMemory, TrajectorySetpoint]:
    """Setpoints of all ticks, time first."""
    p, v, a = [], [], []
    for _ in range(round(seconds / DT)):
        memory, s = trajectory.step(memory, target, params=params, dt_s=DT, clock_rate=rate)
        p.append(s.position_enu_m), v.append(s.velocity_enu_m_s), a.append(s.acceleration_enu_m_s2)
    return memory, TrajectorySetpoint(np.array(p), np.array(v), np.array(a))


def norm(values: Array) -> Array:
    return np.linalg.norm(values, axis=-1)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_goal_to_the_east_north_or_up_moves_the_setpoint_that_way(axis: int, sign: float) -> None:
    target = np.zeros(3)
    target[axis] = sign
    _, s = fly(trajectory.initial(np.zeros(3)), goal(target), 0.4)
    for values in (s.position_enu_m, s.velocity_enu_m_s, s.acceleration_enu_m_s2):
        assert values[-1, axis] * sign > 0.0
        assert np.allclose(np.delete(values[-1], axis), 0.0)


def test_the_leg_ends_at_rest_exactly_on_the_goal() -> None:
    memory, s = fly(trajectory.initial(np.array([0.0, 0.0, 1.0])), goal([2.0, -1.0, 1.5]), 8.0)
    assert trajectory.is_finished(memory)
    assert np.allclose(s.position_enu_m[-1], [2.0, -1.0, 1.5], atol=1e-12)
    assert np.allclose(s.velocity_enu_m_s[-1], 0.0, atol=1e-9)
    assert np.allclose(s.acceleration_enu_m_s2[-1], 0.0, atol=1e-9)


def test_without_a_goal_of_its_own_the_setpoint_rests() -> None:
    _, s = fly(trajectory.initial(np.array([1.0, 2.0, 3.0])), goal([1.0, 2.0, 3.0]), 0.5)
    assert np.array_equal(s.position_enu_m, np.tile([1.0, 2.0, 3.0], (25, 1)))
    assert np.array_equal(s.velocity_enu_m_s, np.zeros((25, 3)))


@pytest.mark.parametrize("duration", [5.0, 7.0, 20.0])
def test_the_asked_duration_is_kept_when_the_bounds_allow_it(duration: float) -> None:
    memory, _ = fly(trajectory.initial(np.zeros(3)), goal([2.0, 0.0, 0.0], duration=duration), DT)
    assert memory.duration_s == pytest.approx(duration)


def test_a_duration_that_the_bounds_do_not_allow_is_stretched() -> None:
    memory, s = fly(trajectory.initial(np.zeros(3)), goal([4.0, 0.0, 0.0], duration=1.0), 10.0)
    assert memory.duration_s == pytest.approx(7.5)  # 15/8 of 4 m at 1 m/s
    assert norm(s.velocity_enu_m_s).max() <= 1.0 + 1e-9


def test_the_lead_is_taken_off_the_duration() -> None:
    params = GuidanceParams(1.0, 1.5, lead_s=0.27)
    memory, _ = fly(trajectory.initial(np.zeros(3)), goal([1.0, 0.0, 0.0], duration=5.0), DT, params)
    assert memory.duration_s == pytest.approx(4.73)


@pytest.mark.parametrize("distance", [0.001, 0.05, 0.5, 3.0, 50.0])
def test_from_rest_speed_and_acceleration_reach_a_bound_and_never_pass_it(distance: float) -> None:
    start = trajectory.initial(np.zeros(3))
    seconds = float(trajectory.shortest_duration_s(distance, PARAMS)) + 0.1
    _, s = fly(start, goal(np.array([0.6, 0.0, 0.8]) * distance), seconds)
    speed, force = norm(s.velocity_enu_m_s).max(), norm(s.acceleration_enu_m_s2).max()
    assert speed <= 1.0 + 1e-9
    assert force <= 1.5 + 1e-9
    assert max(speed / 1.0, force / 1.5) > 0.8 or distance < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_bounds_hold_however_often_the_goal_changes(seed: int) -> None:
    """60 vehicles with random goals, bounds and durations, changed at random moments, also in the middle of a leg."""
    rng = np.random.default_rng(seed)
    n = 60
    params = GuidanceParams(rng.uniform(0.3, 4.0, n), rng.uniform(0.5, 4.0, n))
    memory = trajectory.initial(rng.uniform(-1, 1, (n, 3)))
    sequence, target, duration = np.zeros(n, dtype=np.int64), np.zeros((n, 3)), np.zeros(n)
    worst_speed, worst_force = 0.0, 0.0
    for tick in range(1200):
        new = (rng.random(n) < 0.02) | (tick == 0)
        sequence = sequence + new
        scale = 10.0 ** rng.uniform(-2, 1, (n, 1))
        target = np.where(new[:, None], scale * rng.normal(size=(n, 3)), target)
        duration = np.where(new, rng.choice([0.0, 0.0, 2.0, 6.0], n), duration)
        memory, s = trajectory.step(memory, Goal(target, duration, sequence), params=params, dt_s=DT)
        worst_speed = max(worst_speed, float((norm(s.velocity_enu_m_s) / params.max_speed_m_s).max()))
        worst_force = max(worst_force, float((norm(s.acceleration_enu_m_s2) / params.max_acceleration_m_s2).max()))
    assert worst_speed <= 1.01
    assert worst_force <= 1.05


@pytest.mark.parametrize("when", np.linspace(0.1, 5.6, 12).tolist())
def test_a_new_goal_continues_position_velocity_and_acceleration(when: float) -> None:
    memory, before = fly(trajectory.initial(np.zeros(3)), goal([3.0, 0.0, 0.0]), when)
    tiny = 1e-7
    _, after = trajectory.step(memory, goal([0.0, 2.0, 1.0], sequence=2), params=PARAMS, dt_s=tiny)
    assert np.allclose(after.position_enu_m, before.position_enu_m[-1], atol=1e-5)
    assert np.allclose(after.velocity_enu_m_s, before.velocity_enu_m_s[-1], atol=1e-4)
    assert np.allclose(after.acceleration_enu_m_s2, before.acceleration_enu_m_s2[-1], atol=1e-3)


def test_velocity_and_acceleration_are_the_derivatives_of_the_position() -> None:
    memory, first = fly(trajectory.initial(np.zeros(3)), goal([3.0, 1.0, 0.0]), 1.5)
    _, second = fly(memory, goal([-1.0, 0.0, 0.0], sequence=2), 8.0)
    p = np.concatenate([first.position_enu_m, second.position_enu_m])
    v = np.concatenate([first.velocity_enu_m_s, second.velocity_enu_m_s])
    a = np.concatenate([first.acceleration_enu_m_s2, second.acceleration_enu_m_s2])
    assert np.allclose((p[2:] - p[:-2]) / (2 * DT), v[1:-1], atol=3e-3)
    assert np.allclose((v[2:] - v[:-2]) / (2 * DT), a[1:-1], atol=6e-2)


def test_the_same_sequence_does_not_plan_anew() -> None:
    memory, _ = fly(trajectory.initial(np.zeros(3)), goal([3.0, 0.0, 0.0]), 1.0)
    later, _ = trajectory.step(memory, goal([-3.0, 0.0, 0.0]), params=PARAMS, dt_s=DT)
    assert np.array_equal(later.goal_position_enu_m, [3.0, 0.0, 0.0])


def test_a_goal_that_is_not_finite_leaves_the_old_leg_without_a_warning() -> None:
    memory, _ = fly(trajectory.initial(np.zeros(3)), goal([3.0, 0.0, 0.0]), 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        later, s = trajectory.step(memory, goal([np.nan, 0.0, 0.0], sequence=2), params=PARAMS, dt_s=DT)
        later, s = trajectory.step(later, goal([1.0, 0.0, 0.0], 3, duration=np.inf), params=PARAMS, dt_s=DT)
    assert np.array_equal(later.goal_position_enu_m, [3.0, 0.0, 0.0])
    assert np.isfinite(s.position_enu_m).all()


def test_reset_rests_at_the_given_place_and_takes_the_same_order_again() -> None:
    memory, _ = fly(trajectory.initial(np.zeros(3)), goal([3.0, 0.0, 0.0]), 1.0)
    memory = trajectory.reset(memory, np.array([0.5, 0.5, 0.0]))
    s = trajectory.setpoint(memory)
    assert np.array_equal(s.position_enu_m, [0.5, 0.5, 0.0])
    assert not s.velocity_enu_m_s.any()
    memory, s_all = fly(memory, goal([3.0, 0.0, 0.0]), 6.0)
    assert np.allclose(s_all.position_enu_m[-1], [3.0, 0.0, 0.0])


def test_a_slowed_clock_stretches_the_leg_and_a_stopped_one_stands_still() -> None:
    start = trajectory.initial(np.zeros(3))
    _, full = fly(start, goal([2.0, 0.0, 0.0]), 3.0)
    _, half = fly(start, goal([2.0, 0.0, 0.0]), 6.0, rate=0.5)
    assert np.allclose(half.position_enu_m[1::2], full.position_enu_m)
    assert np.allclose(half.velocity_enu_m_s[1::2], 0.5 * full.velocity_enu_m_s)
    assert np.allclose(half.acceleration_enu_m_s2[1::2], 0.25 * full.acceleration_enu_m_s2)
    memory, _ = fly(start, goal([2.0, 0.0, 0.0]), 1.0)
    _, stopped = fly(memory, goal([2.0, 0.0, 0.0]), 0.5, rate=0.0)
    assert not stopped.velocity_enu_m_s.any()
    assert np.array_equal(stopped.position_enu_m[0], stopped.position_enu_m[-1])


def test_turning_and_moving_the_world_turns_and_moves_the_trajectory() -> None:
    q, shift = frames.quaternion_from_yaw(0.8), np.array([5.0, 1.0, -2.0])
    legs = [(np.array([2.0, 1.0, 0.5]), 1.3), (np.array([-1.0, 0.5, 0.0]), 6.0)]
    plain, turned = trajectory.initial(np.zeros(3)), trajectory.initial(shift)
    for number, (target, seconds) in enumerate(legs):
        plain, a = fly(plain, goal(target, number), seconds)
        turned, b = fly(turned, goal(frames.rotate(q, target) + shift, number), seconds)
        for i in range(0, len(a.position_enu_m), 10):
            assert np.allclose(b.position_enu_m[i], frames.rotate(q, a.position_enu_m[i]) + shift, atol=1e-9)
            assert np.allclose(b.acceleration_enu_m_s2[i], frames.rotate(q, a.acceleration_enu_m_s2[i]), atol=1e-8)


def test_scaling_length_and_time_scales_the_trajectory() -> None:
    length, time = 3.0, 2.0
    scaled = GuidanceParams(1.0 * length / time, 1.5 * length / time**2)
    one, two = trajectory.initial(np.zeros(3)), trajectory.initial(np.zeros(3))
    for tick in range(400):
        target = np.array([2.0, 1.0, 0.5]) if tick < 70 else np.array([-1.0, 0.5, 0.0])
        one, a = trajectory.step(one, goal(target, tick // 70 > 0), params=PARAMS, dt_s=DT)
        two, b = trajectory.step(two, goal(length * target, tick // 70 > 0), params=scaled, dt_s=time * DT)
        assert np.allclose(b.position_enu_m, length * a.position_enu_m, atol=1e-9)
        assert np.allclose(b.velocity_enu_m_s, length / time * a.velocity_enu_m_s, atol=1e-9)
        assert np.allclose(b.acceleration_enu_m_s2, length / time**2 * a.acceleration_enu_m_s2, atol=1e-9)


def test_batch_equals_loop() -> None:
    rng = np.random.default_rng(5)
    starts, targets = rng.normal(size=(2, 3, 4, 3))
    second = rng.normal(size=(3, 4, 3))
    together = trajectory.initial(starts)
    alone = {(i, j): trajectory.initial(starts[i, j]) for i in range(3) for j in range(4)}
    for tick in range(150):
        g = Goal(targets if tick < 60 else second, np.zeros((3, 4)), np.full((3, 4), tick // 60))
        together, s = trajectory.step(together, g, params=PARAMS, dt_s=DT)
        for (i, j), memory in alone.items():
            own = Goal(g.position_enu_m[i, j], g.duration_s[i, j], g.sequence[i, j])
            alone[i, j], one = trajectory.step(memory, own, params=PARAMS, dt_s=DT)
            assert np.allclose(one.position_enu_m, s.position_enu_m[i, j], atol=1e-13)
            assert np.allclose(one.acceleration_enu_m_s2, s.acceleration_enu_m_s2[i, j], atol=1e-12)
