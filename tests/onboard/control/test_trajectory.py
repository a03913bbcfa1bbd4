"""Trajectory: continuous, bounded, on time, equivariant."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from onboard.control import trajectory
from onboard.control.trajectory import TrajectoryMemory, TrajectoryParams
from onboard.types import Goal
from onboard.vectors import ZERO_3, Vec3, add, scaled
from tests.oracles import quintic
from tests.oracles.rotation import quaternion_from_yaw, rotate

PARAMS = TrajectoryParams(max_speed_m_s=1.0, max_acceleration_m_s2=1.5)
DT = 0.02


class Flown(NamedTuple):
    """Setpoints of all ticks, time first."""

    position_enu_m: np.ndarray
    velocity_enu_m_s: np.ndarray
    acceleration_enu_m_s2: np.ndarray


def vec(values: object) -> Vec3:
    return Vec3(*map(float, values))  # type: ignore[call-overload]


def goal(position: object, sequence: int = 1, duration: float = 0.0) -> Goal:
    return Goal(vec(position), duration, sequence)


def fly(
    memory: TrajectoryMemory,
    target: Goal,
    seconds: float,
    params: TrajectoryParams = PARAMS,
    rate: float = 1.0,
) -> tuple[TrajectoryMemory, Flown]:
    setpoints = []
    for _ in range(round(seconds / DT)):
        memory, s = trajectory.step(memory, target, params, DT, rate)
        setpoints.append(s)
    return memory, Flown(*(np.array(values) for values in zip(*setpoints, strict=True)))


def norm(values: object) -> np.ndarray:
    return np.linalg.norm(values, axis=-1)  # type: ignore[call-overload]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_goal_to_the_east_north_or_up_moves_the_setpoint_that_way(axis: int, sign: float) -> None:
    target = np.zeros(3)
    target[axis] = sign
    _, s = fly(trajectory.initial(ZERO_3), goal(target), 0.4)
    for values in (s.position_enu_m, s.velocity_enu_m_s, s.acceleration_enu_m_s2):
        assert values[-1, axis] * sign > 0.0
        assert np.allclose(np.delete(values[-1], axis), 0.0)


def test_the_leg_ends_at_rest_exactly_on_the_goal() -> None:
    memory, s = fly(trajectory.initial(Vec3(0.0, 0.0, 1.0)), goal([2.0, -1.0, 1.5]), 8.0)
    assert memory.elapsed_s >= trajectory.duration_s(memory)
    assert np.allclose(s.position_enu_m[-1], [2.0, -1.0, 1.5], atol=1e-12)
    assert np.allclose(s.velocity_enu_m_s[-1], 0.0, atol=1e-9)
    assert np.allclose(s.acceleration_enu_m_s2[-1], 0.0, atol=1e-9)


def test_without_a_goal_of_its_own_the_setpoint_rests() -> None:
    _, s = fly(trajectory.initial(Vec3(1.0, 2.0, 3.0)), goal([1.0, 2.0, 3.0]), 0.5)
    assert np.array_equal(s.position_enu_m, np.tile([1.0, 2.0, 3.0], (25, 1)))
    assert np.array_equal(s.velocity_enu_m_s, np.zeros((25, 3)))


@pytest.mark.parametrize("duration", [5.0, 7.0, 20.0])
def test_the_asked_duration_is_kept_when_the_bounds_allow_it(duration: float) -> None:
    memory, _ = fly(trajectory.initial(ZERO_3), goal([2.0, 0.0, 0.0], duration=duration), DT)
    assert trajectory.duration_s(memory) == pytest.approx(duration)


def test_a_duration_that_the_bounds_do_not_allow_is_stretched() -> None:
    memory, s = fly(trajectory.initial(ZERO_3), goal([4.0, 0.0, 0.0], duration=1.0), 10.0)
    assert trajectory.duration_s(memory) == pytest.approx(7.5)  # 15/8 of 4 m at 1 m/s
    assert norm(s.velocity_enu_m_s).max() <= 1.0 + 1e-9


def test_the_lead_is_taken_off_the_duration() -> None:
    params = TrajectoryParams(1.0, 1.5, lead_s=0.27)
    memory, _ = fly(trajectory.initial(ZERO_3), goal([1.0, 0.0, 0.0], duration=5.0), DT, params)
    assert trajectory.duration_s(memory) == pytest.approx(4.73)


@pytest.mark.parametrize("distance", [0.001, 0.05, 0.5, 3.0, 50.0])
def test_from_rest_speed_and_acceleration_reach_a_bound_and_never_pass_it(distance: float) -> None:
    start = trajectory.initial(ZERO_3)
    seconds = trajectory.shortest_duration_s(distance, 0.8 * distance, PARAMS) + 0.1
    _, s = fly(start, goal(np.array([0.6, 0.0, 0.8]) * distance), seconds)
    speed = norm(s.velocity_enu_m_s).max()
    force = norm(s.acceleration_enu_m_s2).max()
    assert speed <= 1.0 + 1e-9
    assert force <= 1.5 + 1e-9
    assert max(speed / 1.0, force / 1.5) > 0.8 or distance < 0.1


@pytest.mark.parametrize("acceleration", [1.5, 4.0])
@pytest.mark.parametrize("climb", [0.5, -7.0, 30.0])
def test_legs_keep_the_bound_of_the_vertical_acceleration(
    climb: float, acceleration: float
) -> None:
    """A heavy vehicle climbs and sinks with less acceleration than it flies sideways."""
    params = TrajectoryParams(3.0, acceleration, max_vertical_m_s2=0.6)
    memory, first = fly(trajectory.initial(ZERO_3), goal([2.0, 0.0, climb]), 1.0, params)
    _, second = fly(memory, goal([2.0, 0.0, 0.0], sequence=2), 40.0, params)
    for s in (first, second):
        assert np.abs(s.acceleration_enu_m_s2[:, 2]).max() <= 0.6 + 1e-9
    assert np.allclose(second.position_enu_m[-1], [2.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("max_vertical", [math.inf, 0.6])
@pytest.mark.parametrize("period", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("end", [[0.0, 0.0, -2.0], [0.0, 0.0, 8.0], [8.0, 0.0, 0.0]], ids=str)
def test_a_goal_that_is_sent_again_and_again_is_reached_smoothly(
    end: list[float], period: float, max_vertical: float
) -> None:
    """As to a vehicle that follows another one, or flies around an obstacle."""
    params = TrajectoryParams(1.0, 1.5, max_vertical_m_s2=max_vertical, lead_s=0.15)
    memory = trajectory.initial(ZERO_3)
    velocities = [np.zeros(3)]
    for sequence in range(round(30.0 / period)):
        memory, s = fly(memory, goal(end, sequence=sequence), period, params)
        velocities += list(s.velocity_enu_m_s)
    assert norm(np.diff(velocities, axis=0)).max() < 0.05
    assert np.allclose(s.position_enu_m[-1], end, atol=1e-3)


@pytest.mark.parametrize("duration", [0.0, 10.0, 20.0, 60.0])
@pytest.mark.parametrize(
    ("first", "second"),
    [
        # "in 20", or slowly, in a descent: the ground is below
        ([0.0, 0.0, -8.0], [0.0, 0.0, -8.0]),
        ([0.0, 0.0, 8.0], [0.0, 0.0, 8.0]),
        ([8.0, 0.0, 0.0], [8.0, 0.0, 0.0]),
        ([0.0, 0.0, -8.0], [9.0, 0.0, -8.0]),
        ([9.0, 0.0, 0.0], [4.0, 3.0, 0.0]),
        ([9.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    ],
    ids=str,
)
def test_an_order_in_flight_leads_nowhere_that_the_vehicle_need_not_go(
    first: list[float], second: list[float], duration: float
) -> None:
    """A vehicle in motion flies neither past its new goal nor far beside its way."""
    memory, _ = fly(trajectory.initial(ZERO_3), goal(first), 5.0)
    now = trajectory.setpoint(memory)
    begin = np.array(now.position_enu_m)
    stop = begin + 1.2 * np.array(now.velocity_enu_m_s)  # farther than a brake leads
    end = np.array(second)
    _, s = fly(memory, goal(second, sequence=2, duration=duration), 80.0)
    path = np.array(s.position_enu_m)
    assert np.allclose(path[-1], end, atol=1e-6)

    heights = np.array([begin[2], stop[2], end[2]])
    assert heights.min() - 0.05 < path[:, 2].min()
    assert path[:, 2].max() < heights.max() + 0.05
    from_end = norm((path - end)[:, :2])
    assert from_end.max() < max(norm((begin - end)[:2]), norm((stop - end)[:2])) + 0.05
    along = (path - begin)[:, :2] @ (end - begin)[:2]
    farthest = max((end - begin)[:2] @ (end - begin)[:2], (stop - begin)[:2] @ (end - begin)[:2])
    assert along.max() < farthest + 0.05 * norm((end - begin)[:2]) + 1e-9


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))]
)
def test_bounds_hold_however_often_the_goal_changes(seed: int) -> None:
    """Random goals, bounds and durations, changed at random moments, also within a leg."""
    rng = np.random.default_rng(seed)
    worst_speed = 0.0
    worst_force = 0.0
    for _ in range(20):
        params = TrajectoryParams(float(rng.uniform(0.3, 4.0)), float(rng.uniform(0.5, 4.0)))
        memory = trajectory.initial(vec(rng.uniform(-1, 1, 3)))
        target = goal(np.zeros(3), 0)
        for tick in range(1200):
            if tick == 0 or rng.random() < 0.02:
                spot = 10.0 ** rng.uniform(-2, 1) * rng.normal(size=3)
                target = goal(spot, tick + 1, float(rng.choice([0.0, 0.0, 2.0, 6.0])))
            memory, s = trajectory.step(memory, target, params, DT, 1.0)
            worst_speed = max(worst_speed, math.hypot(*s.velocity_enu_m_s) / params.max_speed_m_s)
            worst_force = max(
                worst_force, math.hypot(*s.acceleration_enu_m_s2) / params.max_acceleration_m_s2
            )
    assert worst_speed <= 1.01
    assert worst_force <= 1.05


@pytest.mark.parametrize("when", np.linspace(0.1, 5.6, 12).tolist())
def test_a_new_goal_continues_position_velocity_and_acceleration(when: float) -> None:
    memory, before = fly(trajectory.initial(ZERO_3), goal([3.0, 0.0, 0.0]), when)
    tiny = 1e-7
    _, after = trajectory.step(memory, goal([0.0, 2.0, 1.0], sequence=2), PARAMS, tiny, 1.0)
    assert np.allclose(after.position_enu_m, before.position_enu_m[-1], atol=1e-5)
    assert np.allclose(after.velocity_enu_m_s, before.velocity_enu_m_s[-1], atol=1e-4)
    assert np.allclose(after.acceleration_enu_m_s2, before.acceleration_enu_m_s2[-1], atol=1e-3)


def test_velocity_and_acceleration_are_the_derivatives_of_the_position() -> None:
    memory, first = fly(trajectory.initial(ZERO_3), goal([3.0, 1.0, 0.0]), 1.5)
    _, second = fly(memory, goal([-1.0, 0.0, 0.0], sequence=2), 8.0)
    p = np.concatenate([first.position_enu_m, second.position_enu_m])
    v = np.concatenate([first.velocity_enu_m_s, second.velocity_enu_m_s])
    a = np.concatenate([first.acceleration_enu_m_s2, second.acceleration_enu_m_s2])
    assert np.allclose((p[2:] - p[:-2]) / (2 * DT), v[1:-1], atol=3e-3)
    assert np.allclose((v[2:] - v[:-2]) / (2 * DT), a[1:-1], atol=6e-2)


def test_the_same_sequence_does_not_plan_anew() -> None:
    memory, _ = fly(trajectory.initial(ZERO_3), goal([3.0, 0.0, 0.0]), 1.0)
    later, _ = trajectory.step(memory, goal([-3.0, 0.0, 0.0]), PARAMS, DT, 1.0)
    assert np.array_equal(later.goal_position_enu_m, [3.0, 0.0, 0.0])


def test_a_goal_that_is_not_finite_leaves_the_old_leg() -> None:
    memory, _ = fly(trajectory.initial(ZERO_3), goal([3.0, 0.0, 0.0]), 1.0)
    later, s = trajectory.step(memory, goal([math.nan, 0.0, 0.0], sequence=2), PARAMS, DT, 1.0)
    later, s = trajectory.step(
        later, goal([1.0, 0.0, 0.0], 3, duration=math.inf), PARAMS, DT, math.nan
    )
    assert later.goal_position_enu_m == Vec3(3.0, 0.0, 0.0)
    assert np.isfinite(s.position_enu_m).all()


def test_a_leg_is_the_quintic_that_its_ends_determine() -> None:
    memory, first = fly(trajectory.initial(ZERO_3), goal([3.0, 1.0, 0.0]), 1.5)
    memory, second = fly(memory, goal([4.0, 0.0, 0.5], sequence=2), 2.0)
    assert memory.second_duration_s == 0.0  # one polynomial
    for axis in range(3):
        begin = tuple(float(values[-1, axis]) for values in first)
        at = quintic.at_time(begin, memory.goal_position_enu_m[axis], memory.first_duration_s, 2.0)
        assert [float(values[-1, axis]) for values in second] == pytest.approx(at, abs=1e-9)


def test_a_slowed_clock_stretches_the_leg_and_a_stopped_one_stands_still() -> None:
    start = trajectory.initial(ZERO_3)
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
    q = quaternion_from_yaw(0.8)
    shift = Vec3(5.0, 1.0, -2.0)
    legs = [(Vec3(2.0, 1.0, 0.5), 1.3), (Vec3(-1.0, 0.5, 0.0), 6.0)]
    plain = trajectory.initial(ZERO_3)
    turned = trajectory.initial(shift)
    for number, (target, seconds) in enumerate(legs):
        plain, a = fly(plain, goal(target, number), seconds)
        turned, b = fly(turned, goal(add(rotate(q, target), shift), number), seconds)
        for i in range(0, len(a.position_enu_m), 10):
            np.testing.assert_allclose(
                b.position_enu_m[i], add(rotate(q, a.position_enu_m[i].tolist()), shift), atol=1e-9
            )
            np.testing.assert_allclose(
                b.acceleration_enu_m_s2[i],
                rotate(q, a.acceleration_enu_m_s2[i].tolist()),
                atol=1e-8,
            )


def test_scaling_length_and_time_scales_the_trajectory() -> None:
    length = 3.0
    time = 2.0
    params = TrajectoryParams(1.0 * length / time, 1.5 * length / time**2)
    one = trajectory.initial(ZERO_3)
    two = trajectory.initial(ZERO_3)
    for tick in range(400):
        target = Vec3(2.0, 1.0, 0.5) if tick < 70 else Vec3(-1.0, 0.5, 0.0)
        one, a = trajectory.step(one, goal(target, int(tick >= 70)), PARAMS, DT, 1.0)
        two, b = trajectory.step(
            two, goal(scaled(length, target), int(tick >= 70)), params, time * DT, 1.0
        )
        np.testing.assert_allclose(b.position_enu_m, scaled(length, a.position_enu_m), atol=1e-9)
        np.testing.assert_allclose(
            b.velocity_enu_m_s, scaled(length / time, a.velocity_enu_m_s), atol=1e-9
        )
        np.testing.assert_allclose(
            b.acceleration_enu_m_s2, scaled(length / time**2, a.acceleration_enu_m_s2), atol=1e-9
        )


RISING = PARAMS._replace(rise_m=1.5, highest_m=4.0)


def test_a_level_leg_rises_between_its_ends_within_the_bounds_and_as_far_as_without() -> None:
    begin = trajectory.initial(vec([0.0, 0.0, 1.0]))
    memory, risen = fly(begin, goal([6.0, 0.0, 1.0]), 12.0, RISING)
    _, level = fly(begin, goal([6.0, 0.0, 1.0]), 12.0)
    rise_m = risen.position_enu_m[:, 2] - 1.0

    np.testing.assert_array_equal(risen.position_enu_m[:, :2], level.position_enu_m[:, :2])
    assert rise_m.max() == pytest.approx(1.5)
    assert rise_m.min() == 0.0
    assert np.all(np.abs(risen.velocity_enu_m_s[:, 2]) <= 1.0 + 1e-9)
    assert np.all(np.abs(risen.acceleration_enu_m_s2[:, 2]) <= 1.5 + 1e-9)

    # up to the top in one piece, and down before the end of the leg
    is_at_top = rise_m > 1.5 - 1e-9
    assert np.diff(np.flatnonzero(is_at_top)).max() == 1
    end = round(0.96 * trajectory.duration_s(memory) / DT)
    assert np.all(rise_m[end:] == 0.0)

    by_difference = np.gradient(risen.position_enu_m[:, 2], DT)
    np.testing.assert_allclose(by_difference, risen.velocity_enu_m_s[:, 2], atol=0.02)
    by_difference = np.gradient(risen.velocity_enu_m_s[:, 2], DT)
    np.testing.assert_allclose(by_difference, risen.acceleration_enu_m_s2[:, 2], atol=0.06)


@pytest.mark.parametrize(
    ("begin_m", "target_m"),
    [
        ((0.0, 0.0, 1.0), (2.0, 0.0, 1.0)),  # over before it has risen
        ((0.0, 0.0, 1.0), (6.0, 0.0, 1.5)),  # a climb
        ((0.0, 0.0, 2.6), (6.0, 0.0, 2.6)),  # the ceiling is at 4 m
        ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)),
    ],
)
def test_a_leg_that_is_short_or_not_level_or_near_the_ceiling_does_not_rise(
    begin_m: tuple[float, float, float], target_m: tuple[float, float, float]
) -> None:
    begin = trajectory.initial(vec(begin_m))
    _, risen = fly(begin, goal(target_m), 12.0, RISING)
    _, level = fly(begin, goal(target_m), 12.0)
    np.testing.assert_array_equal(risen.position_enu_m, level.position_enu_m)


def test_a_higher_goal_in_a_rise_continues_its_motion() -> None:
    memory, up = fly(trajectory.initial(vec([0.0, 0.0, 1.0])), goal([6.0, 0.0, 1.0]), 1.5, RISING)
    _, after = fly(memory, goal([0.0, 0.0, 4.0], sequence=2), 0.1, RISING)
    assert up.velocity_enu_m_s[-1, 2] > 0.5
    np.testing.assert_allclose(
        after.position_enu_m[0], up.position_enu_m[-1] + DT * up.velocity_enu_m_s[-1], atol=1e-3
    )


def test_others_are_told_the_height_that_is_reached_in_a_second() -> None:
    memory, risen = fly(
        trajectory.initial(vec([0.0, 0.0, 1.0])), goal([6.0, 0.0, 1.0]), 1.0, RISING
    )
    _, later = fly(memory, goal([6.0, 0.0, 1.0]), 1.0, RISING)
    assert trajectory.rise_soon_m(memory) == pytest.approx(later.position_enu_m[-1, 2] - 1.0)
    assert trajectory.rise_soon_m(memory) > risen.position_enu_m[-1, 2] - 1.0
