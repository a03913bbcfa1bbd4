"""The pipeline as a whole: modes, anti-windup, symmetries and bad input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from onboard.avoidance.params import OPEN_FENCE, Walls
from onboard.config.fleet import load_fleet
from onboard.constants import GRAVITY_M_S2
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.frames import yaw_from_quaternion
from onboard.types import Goal, LawStatus, Neighbour, State
from onboard.vectors import ZERO_3, Vec3

FLEET = load_fleet("configs/fleets/paper.toml")
FENCED = pipeline.pipeline_params(FLEET, "mav0")
PARAMS = FENCED._replace(law=FENCED.law._replace(fence=Walls(*OPEN_FENCE)))


def vec(values):
    return Vec3(*map(float, values))


def state_of(position, velocity=(0.0, 0.0, 0.0)):
    return State(
        position_enu_m=vec(position),
        velocity_enu_m_s=vec(velocity),
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=0.0,
        age_s=0.0,
        position_std_m=0.0,
        velocity_std_m_s=0.0,
    )


def goal_of(position, sequence=1, duration=0.0):
    return Goal(vec(position), duration, sequence)


def neighbours_of(positions, velocities=None):
    velocities = np.zeros_like(positions, dtype=float) if velocities is None else velocities
    return [
        Neighbour(
            position_enu_m=vec(p),
            velocity_enu_m_s=vec(v),
            acceleration_enu_m_s2=ZERO_3,
            predicted_position_enu_m=vec(p),
            predicted_velocity_enu_m_s=vec(v),
            commanded_acceleration_enu_m_s2=ZERO_3,
            intent_enu_m_s=vec(v),
            age_s=0.0,
            lead_time_s=math.nan,
            position_std_m=0.0,
            velocity_std_m_s=math.nan,
            crowd_count=0.0,
            is_cooperative=True,
            is_paper_obstacle=True,
            table_index=index,
            radius_m=0.0,
        )
        for index, (p, v) in enumerate(zip(positions, velocities, strict=True))
    ]  # fmt: skip


def run(ticks, state, goal, neighbours=(), params=PARAMS, memory=None, mode=ControlMode.FLYING):
    memory = pipeline.initial(params, state.position_enu_m) if memory is None else memory
    for _ in range(ticks):
        memory, tick = pipeline.step(memory, state, goal, neighbours, (), mode, params, 0.02)
    return memory, tick


def test_hovering_on_the_spot_asks_for_level_and_hover_thrust():
    _, tick = run(1, state_of([1.0, 2.0, 1.0]), goal_of([1.0, 2.0, 1.0]))
    np.testing.assert_allclose(tick.attitude.quaternion_wxyz, [1, 0, 0, 0], atol=1e-9)
    assert tick.attitude.thrust_frac == pytest.approx(0.75)
    assert tick.law.status == LawStatus.INACTIVE
    assert tick.is_finite


def test_goal_to_the_east_tilts_to_the_east():
    _, tick = run(30, state_of([0.0, 0.0, 1.0]), goal_of([3.0, 0.0, 1.0]))
    assert tick.law.thrust.thrust_enu_m_s2[0] > 0.2
    # rotation about +y (left) leans the thrust to +x
    assert tick.attitude.quaternion_wxyz[2] > 0.01
    assert abs(tick.attitude.quaternion_wxyz[1]) < 1e-6


def test_on_the_ground_there_is_no_thrust_and_nothing_is_learned():
    memory, _ = run(50, state_of([0.0, 0.0, 0.0], [0.3, 0, 0]), goal_of([2.0, 0, 1.0]))
    memory, tick = run(
        1,
        state_of([0.0, 0.0, 0.0]),
        goal_of([2.0, 0, 1.0]),
        memory=memory,
        mode=ControlMode.GROUND,
    )
    assert tick.attitude.thrust_frac == 0.0
    np.testing.assert_array_equal(tick.attitude.quaternion_wxyz, [1, 0, 0, 0])
    np.testing.assert_array_equal(memory.observer.disturbance_enu_m_s2, 0.0)
    assert all(command.duration_s == 0.0 for command in memory.law.commands)


def test_a_vehicle_takes_off_with_the_heading_with_which_it_stands():
    standing = state_of([0.0, 0.0, 0.0])._replace(yaw_rad=2.8)
    up = goal_of([0.0, 0.0, 1.0])
    memory, _ = run(1, standing, up, mode=ControlMode.GROUND)
    _, tick = run(5, standing, up, memory=memory, mode=ControlMode.LIFTOFF)
    assert yaw_from_quaternion(tick.attitude.quaternion_wxyz) == pytest.approx(2.8)

    unknown = standing._replace(yaw_rad=math.nan)
    memory, _ = run(1, unknown, up, mode=ControlMode.GROUND)
    assert memory.yaw_rad == 0.0


def test_the_hover_throttle_is_learned_at_the_same_height_above_a_lower_ground():
    fence = replace(FLEET.fleet.geofence_m, z=(-2.0, 3.0))
    vehicle = replace(FLEET.vehicles["mav0"], start_enu_m=(0.0, 0.0, -2.0))
    lower = replace(
        FLEET,
        fleet=replace(FLEET.fleet, geofence_m=fence),
        vehicles={**FLEET.vehicles, "mav0": vehicle},
    )
    low_params = pipeline.pipeline_params(lower, "mav0")._replace(law=PARAMS.law)

    for height_m, is_learned in ((1.0, True), (0.2, False)):
        _, usual = run(100, state_of([0.0, 0.0, height_m]), goal_of([0.0, 0.0, 2.0]))
        low = state_of([0.0, 0.0, height_m - 2.0])
        _, tick = run(100, low, goal_of([0.0, 0.0, 0.0]), params=low_params)
        assert tick.hover_thrust_frac == pytest.approx(usual.hover_thrust_frac)
        assert (abs(tick.hover_thrust_frac - 0.75) > 0.01) is is_learned


LARGEST_LIFTOFF_TILT_RAD = math.radians(12.0)  # MPC_TILTMAX_LND of PX4


def tilt_rad(tick):
    w, x, y, z = tick.attitude.quaternion_wxyz
    return math.acos(w * w - x * x - y * y + z * z)


def test_lift_off_tilts_as_far_as_px4_allows_on_the_ground_and_no_further():
    far = goal_of([0.0, 0.0, 1.0])
    pushed = state_of([1.0, 0.0, 0.0], [1.5, 0.0, 0.0])
    memory = pipeline.initial(PARAMS, ZERO_3)
    _, tick = run(20, pushed, far, memory=memory, mode=ControlMode.LIFTOFF)
    assert tilt_rad(tick) == pytest.approx(LARGEST_LIFTOFF_TILT_RAD)
    _, tick = run(20, pushed, far, mode=ControlMode.FLYING)
    assert tilt_rad(tick) > LARGEST_LIFTOFF_TILT_RAD + 0.05

    # the law cannot tilt it further, even away from a neighbour that flies towards it
    near = neighbours_of([[1.0, 0.0, 0.0]], [[-2.0, 0.0, 0.0]])
    memory = pipeline.initial(PARAMS, ZERO_3)
    still = state_of([0.0, 0.0, 0.0])
    for _ in range(20):
        memory, tick = pipeline.step(
            memory, still, far, near, [], ControlMode.LIFTOFF, PARAMS, 0.02
        )
    assert tick.law.intervention_m_s2 > 3.0
    assert tilt_rad(tick) == pytest.approx(LARGEST_LIFTOFF_TILT_RAD)


def test_lift_off_learns_the_push_of_the_wind_and_uses_it_once_the_vehicle_flies():
    up = goal_of([0.0, 0.0, 1.0])
    blown = state_of(ZERO_3)._replace(acceleration_enu_m_s2=Vec3(1.2, 0.0, 0.0))
    memory = pipeline.initial(PARAMS, ZERO_3)
    memory, level = run(1, blown, up, memory=memory, mode=ControlMode.LIFTOFF)
    assert memory.observer.disturbance_enu_m_s2 == (pytest.approx(1.2, abs=0.05), 0.0, 0.0)
    assert tilt_rad(level) == pytest.approx(0.0, abs=0.01)

    memory, _ = run(1, blown, up, memory=memory, mode=ControlMode.FLYING)
    assert memory.sent_enu_m_s2.x < -1.0


def test_who_expects_a_push_leans_against_it_from_the_ground_on():
    still = state_of(ZERO_3)
    up = goal_of([0.0, 0.0, 1.0])
    memory, _ = run(1, still, up, mode=ControlMode.GROUND)
    memory = pipeline.expecting_push(memory, Vec3(1.0, 0.0, 0.0), PARAMS)
    memory, _ = run(1, still, up, memory=memory, mode=ControlMode.LIFTOFF)
    assert memory.sent_enu_m_s2.x == pytest.approx(-1.0, abs=0.05)

    # nobody can expect more than it can compensate
    memory = pipeline.expecting_push(memory, Vec3(0.0, -50.0, 0.0), PARAMS)
    assert memory.observer.mean_enu_m_s2.y == -PARAMS.observer.max_disturbance_m_s2


@pytest.mark.parametrize(
    ("mode", "slowest_m_s2", "fastest_m_s2"),
    [(ControlMode.LANDING, -2.5, -1.2), (ControlMode.FLYING, -0.6, 0.0)],
)
def test_a_jam_slows_a_flight_and_no_landing_downwards(
    mode: int, slowest_m_s2: float, fastest_m_s2: float
) -> None:
    # the setpoint is on the ground, and wind has carried the vehicle away from it
    carried = state_of([6.0, 0.0, 0.6])
    memory = pipeline.initial(PARAMS, ZERO_3)
    jammed = memory._replace(law=memory.law._replace(relaxed_share=0.9))
    _, tick = run(1, carried, goal_of([0.0, 0.0, 0.0]), memory=jammed, mode=mode)

    down_m_s2 = tick.thrust_baseline.thrust_enu_m_s2[2] - GRAVITY_M_S2
    assert slowest_m_s2 < down_m_s2 < fastest_m_s2
    # against the wind it is slow in both
    assert abs(tick.thrust_baseline.thrust_enu_m_s2[0]) < 1.5


def test_clock_of_the_trajectory_slows_while_the_law_holds_the_vehicle_back_and_runs_otherwise():
    wall = neighbours_of([[0.85, 0.0, 1.0]])
    held, _ = run(150, state_of([0.0, 0.0, 1.0]), goal_of([3.0, 0.0, 1.0]), wall)
    free, _ = run(150, state_of([0.0, 0.0, 1.0]), goal_of([3.0, 0.0, 1.0]))
    assert held.clock_rate < 0.4
    # The vehicle of this test never moves, so it wants to accelerate with all it has, and the limit
    # of the speed holds it back for moments.
    assert free.clock_rate > 0.85
    assert held.trajectory.elapsed_s < 0.9 * free.trajectory.elapsed_s


def test_commanded_state_is_published_for_the_neighbours():
    memory, tick = run(1, state_of([0.0, 0.0, 1.0], [0.4, 0, 0]), goal_of([3.0, 0.0, 1.0]))
    lag = FLEET.vehicles["mav0"].lag_s
    assert tick.law.lead_time_s == pytest.approx(lag)
    assert tick.law.predicted_position_enu_m[0] == pytest.approx(0.4 * lag)  # no command yet
    thrust = np.array(tick.law.thrust.thrust_enu_m_s2)
    np.testing.assert_allclose(
        tick.law.commanded_acceleration_enu_m_s2, thrust - [0, 0, GRAVITY_M_S2]
    )
    assert memory.law.commands[0].acceleration_enu_m_s2 == tick.law.commanded_acceleration_enu_m_s2


def test_drag_is_compensated_after_the_law():
    def sent_and_commanded(drag):
        params = PARAMS._replace(drag_1_s=drag)
        state = state_of([0.0, 0.0, 1.0], [0.2, 0, 0])
        memory, tick = run(1, state, goal_of([0.0, 0.0, 1.0]), params=params)
        return memory.sent_enu_m_s2[0], tick.law.commanded_acceleration_enu_m_s2[0]

    sent, commanded = sent_and_commanded(0.0)
    sent_with, commanded_with = sent_and_commanded(0.5)
    assert commanded_with == pytest.approx(commanded)
    assert sent_with - sent == pytest.approx(0.5 * 0.2)


def random_inputs(seed):
    rng = np.random.default_rng(seed)
    spots = 0.7 * rng.normal(size=(3, 3))
    spots[:, :2] += np.sign(spots[:, :2]) * 0.6
    return (
        0.1 * rng.normal(size=3),
        0.3 * rng.normal(size=3),
        2.0 * rng.normal(size=3),
        spots,
        0.3 * rng.normal(size=(3, 3)),
    )


@settings(max_examples=30, deadline=None)
@given(st.floats(-3.0, 3.0))
def test_turning_and_shifting_the_world_turns_the_thrust(angle):
    shift = np.array([4.0, -1.0, 0.0])
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    for seed in range(5):
        p, v, goal, q, w = random_inputs(seed)
        p[2] = 1.0
        goal[2] = 1.0
        _, plain = run(6, state_of(p, v), goal_of(goal), neighbours_of(q, w))
        _, moved = run(
            6,
            state_of(turn @ p + shift, turn @ v),
            goal_of(turn @ goal + shift),
            neighbours_of(q @ turn.T + shift, w @ turn.T),
        )
        turned = turn @ np.array(plain.law.thrust.thrust_enu_m_s2)
        np.testing.assert_allclose(moved.law.thrust.thrust_enu_m_s2, turned, atol=1e-6)


@pytest.mark.parametrize("law", ["covey", "paper", "off"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_unusable_state_levels_the_vehicle_for_that_tick_only(bad, law):
    params = pipeline.pipeline_params(FLEET, "mav0", law=law)
    memory, _ = run(20, state_of([0.0, 0.0, 1.0]), goal_of([1.0, 0.0, 1.0]), params=params)
    near = neighbours_of([[1.5, 0.0, 1.0]])
    memory, tick = run(
        3, state_of([bad] * 3, [bad] * 3), goal_of([1.0, 0, 1.0]), near, params, memory
    )
    assert not tick.is_finite
    assert tick.law.status == LawStatus.INFEASIBLE
    assert np.isnan(tick.law.predicted_position_enu_m).all()
    assert np.isfinite(tick.attitude.quaternion_wxyz).all()
    assert 0.5 < tick.attitude.thrust_frac < 0.95
    _, tick = run(5, state_of([0.0, 0.0, 1.0]), goal_of([1.0, 0, 1.0]), near, params, memory)
    assert tick.is_finite
    assert np.isfinite(tick.attitude.quaternion_wxyz).all()
    assert tick.law.status != LawStatus.INFEASIBLE


def test_every_value_of_a_tick_is_finite_under_random_inputs():
    for seed in range(30):
        p, v, goal, q, w = random_inputs(seed)
        _, tick = run(5, state_of(5 * p, 5 * v), goal_of(goal), neighbours_of(0.3 * q, 5 * w))
        for stage in (tick.setpoint, tick.thrust_baseline, tick.law.thrust, tick.attitude):
            for value in stage:
                assert np.isfinite(value).all()
        assert 0.0 <= tick.attitude.thrust_frac <= 1.0


def test_parameters_follow_the_fleet_file():
    vehicle = FLEET.vehicles["mav1"]
    params = pipeline.pipeline_params(FLEET, "mav1")
    assert params.law.lag_s == pytest.approx(0.04 + 1.4 / 6.0)
    assert params.law.spacing.safety_distance_m + params.law.spacing.margin_m == pytest.approx(
        0.80 + FLEET.law.margin_m(params.law.lag_s)
    )
    assert params.law.max_tilt_rad == pytest.approx(math.radians(25.0))
    assert params.trajectory.lead_s == params.law.lag_s
    assert params.drag_1_s == vehicle.drag_1_s
    assert pipeline.pipeline_params(FLEET, "mav1", law="paper").trajectory.lead_s == 0.0


def test_unknown_law_is_refused_in_words():
    with pytest.raises(ValueError, match="off, paper, covey"):
        pipeline.pipeline_params(FLEET, "mav0", law="orca")
