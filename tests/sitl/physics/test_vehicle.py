"""Physics of one vehicle against the measured responses of PX4's own simulator."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from sitl.mavlink.messages import distance_sensor
from sitl.mavlink.view import View
from sitl.physics import frames
from sitl.physics import step as physics
from sitl.physics.vehicle import (
    GRAVITY_M_S2,
    STEP_S,
    Commands,
    VehicleProfile,
    Vehicles,
    VehicleStates,
)
from tests.oracles import emulated_vehicles
from tests.sitl.sitl_flying import ARDRONE, SIH, emulator, height_m, run_for


def hovering(profile: VehicleProfile, yaw_rad: float = 0.0) -> tuple[Vehicles, Commands]:
    """A vehicle that has hovered for a second, 20 m high."""
    vehicles = Vehicles([profile], np.array([[0.0, 0.0, -20.0]]), np.array([yaw_rad]), seed=1)
    commands = Commands.level(np.array([yaw_rad]))
    commands.motors_on[:] = True
    commands.thrust_frac[:] = profile.hover_thrust_frac
    for _ in range(250):
        vehicles.step(commands)
    return vehicles, commands


def step_response(
    profile: VehicleProfile, axis: int, size_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times and the fraction of a commanded step about roll (0), pitch (1) or yaw (2)."""
    vehicles, commands = hovering(profile)
    size = np.radians(size_deg)
    if axis < 2:
        tilt = np.zeros((1, 2))
        tilt[0, axis] = size
        commands.attitude[:] = frames.from_yaw_and_tilt(np.zeros(1), tilt)
    else:
        commands.attitude[:] = frames.yaw_quaternion(np.array([size]))
    fractions = []
    for _ in range(625):
        vehicles.step(commands)
        s = vehicles.states
        fractions.append((s.tilt_rad[0, axis] if axis < 2 else s.yaw_rad[0]) / size)
    return (np.arange(625) + 1) * STEP_S, np.unwrap(np.array(fractions) * size) / size


def reached_s(times: np.ndarray, fractions: np.ndarray, level: float) -> float:
    return float(times[np.argmax(fractions >= level)])


def agrees(value_s: float, measured_s: float) -> bool:
    return abs(value_s - measured_s) <= max(0.010, 0.10 * measured_s)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("size_deg", [5.0, 30.0])
def test_roll_and_pitch_of_the_sih_quad_step_as_measured(axis: int, size_deg: float) -> None:
    times, fractions = step_response(SIH, axis, size_deg)
    for level, measured_s in ((0.05, 0.068), (0.5, 0.170), (0.63, 0.195), (0.9, 0.255)):
        assert agrees(reached_s(times, fractions, level), measured_s), level
    assert fractions.max() - 1.0 == pytest.approx(0.095, abs=0.01)
    assert agrees(float(times[fractions.argmax()]), 0.378)


@pytest.mark.parametrize(
    ("size_deg", "levels", "overshoot"),
    [
        (10.0, {0.05: 0.220, 0.63: 0.615, 0.9: 0.765}, 0.30),
        (30.0, {0.05: 0.220, 0.63: 0.615, 0.9: 0.765}, 0.30),
        (90.0, {0.63: 0.736, 0.9: 0.930}, 0.16),
        (170.0, {0.63: 1.049}, 0.11),
    ],
)
def test_yaw_of_the_sih_quad_steps_as_measured(
    size_deg: float, levels: dict[float, float], overshoot: float
) -> None:
    times, fractions = step_response(SIH, 2, size_deg)
    for level, measured_s in levels.items():
        assert agrees(reached_s(times, fractions, level), measured_s), level
    assert fractions.max() - 1.0 == pytest.approx(overshoot, rel=0.10)
    if size_deg <= 30.0:
        assert agrees(float(times[fractions.argmax()]), 1.25)
    if size_deg == 170.0:
        peak_deg_s = np.gradient(fractions, STEP_S).max() * size_deg
        assert peak_deg_s == pytest.approx(167.0, rel=0.10)
        assert peak_deg_s < 200.0


def test_body_rates_are_followed_after_the_switch_of_controllers() -> None:
    vehicles, commands = hovering(SIH)
    commands.is_rate[:] = True
    commands.rate_rad_s[0] = np.radians([25.0, 0.0, 0.0])
    rates = []
    for _ in range(100):
        vehicles.step(commands)
        rates.append(np.degrees(vehicles.states.tilt_rate_rad_s[0, 0]))
    assert abs(rates[49]) < 1.0  # 0.2 s: the attitude is still held
    assert rates[99] == pytest.approx(25.0, rel=0.10)  # 0.4 s


def test_a_weak_motor_costs_lift_and_leans_the_vehicle_until_its_integral_has_learnt() -> None:
    vehicles, commands = hovering(SIH)
    vehicles.set_motor(0, 1, 0.6)
    leans = []
    for _ in range(1000):
        vehicles.step(commands)
        leans.append(vehicles.states.tilt_rad[0].copy())
    assert leans[60][0] > 0.01  # motor 1 is front right: the vehicle leans to the right
    assert leans[60][1] < -0.01  # and nose down
    assert np.abs(leans[-1]).max() < 0.01
    assert vehicles.lift_share[0] == pytest.approx(4.0 / (3.0 + 1.0 / 0.6), rel=1e-6)
    commands.thrust_frac[:] = 1.0
    for _ in range(250):
        vehicles.step(commands)
    assert vehicles.lift_share[0] == pytest.approx(0.6 / SIH.hover_thrust_frac, rel=1e-3)


def test_the_weak_vehicle_keeps_leaning_since_its_loop_has_no_integral() -> None:
    vehicles, commands = hovering(replace(ARDRONE, tilt_bias_deg=0.0, attitude_integral_s=0.0))
    vehicles.set_motor(0, 2, 0.8)
    for _ in range(1000):
        vehicles.step(commands)
    assert vehicles.states.tilt_rad[0, 0] < -0.03


@pytest.mark.parametrize("profile", [SIH, ARDRONE])
def test_a_dead_motor_turns_the_vehicle_over_and_it_stays_down(profile: VehicleProfile) -> None:
    vehicles, commands = hovering(profile)
    vehicles.set_motor(0, 3, 0.0)
    for _ in range(1500):
        vehicles.step(commands)
    assert vehicles.states.motors_dead[0]
    assert vehicles.states.on_ground[0]


def test_a_quadratic_thrust_curve_hovers_at_the_same_command_and_has_less_below() -> None:
    curved = replace(SIH, thrust_curve_frac=1.0)
    lifts = []
    for profile in (SIH, curved):
        vehicles, commands = hovering(profile)
        assert vehicles.lift_share[0] == pytest.approx(1.0, rel=1e-3)
        commands.thrust_frac[:] = 0.5 * profile.hover_thrust_frac
        for _ in range(250):
            vehicles.step(commands)
        lifts.append(float(vehicles.lift_share[0]))
    assert lifts[0] == pytest.approx(0.5, rel=1e-2)
    assert lifts[1] == pytest.approx(0.25, rel=1e-2)


def tumultuous_flight() -> VehicleStates:
    """Eight different vehicles under random commands, with failing motors, wind and a push."""
    rng = np.random.default_rng(2)
    n = 8
    profiles = [
        VehicleProfile(
            hover_thrust_frac=float(rng.uniform(0.3, 0.8)),
            attitude_delay_s=float(rng.uniform(0.0, 0.1)),
            attitude_wn_rad_s=float(rng.uniform(4.0, 20.0)),
            static_gain=float(rng.uniform(0.8, 1.1)),
            tilt_bias_deg=2.0,
            yaw_wn_rad_s=float(rng.uniform(2.0, 6.0)),
            thrust_noise_frac=0.02,
            thrust_curve_frac=float(rng.uniform(0.0, 1.0)),
        )
        for _ in range(n)
    ]
    vehicles = Vehicles(profiles, rng.uniform(-3.0, 0.0, (n, 3)), np.zeros(n), seed=3)
    commands = Commands.level(np.zeros(n))
    for k in range(600):
        if k % 60 == 0:
            commands.attitude[:] = rng.standard_normal((n, 4)) * [4.0, 1.0, 1.0, 2.0]
            commands.attitude /= np.linalg.norm(commands.attitude, axis=1, keepdims=True)
            commands.rate_rad_s[:] = rng.uniform(-3.0, 3.0, (n, 3))
            commands.is_rate[:] = rng.random(n) < 0.4
            commands.thrust_frac[:] = rng.uniform(0.0, 1.0, n)
            commands.motors_on[:] = rng.random(n) < 0.9
        if k == 200:
            vehicles.set_motor(0, 1, 0.0)
            vehicles.set_motor(1, 4, 0.7)
            vehicles.air_ned_m_s[:] = [1.0, -2.0, 0.3]
            vehicles.push_ned_m_s2[2] = [0.0, 0.0, 2.0]
        vehicles.step(commands)
    return vehicles.states


def test_vehicles_move_as_the_oracle_in_numpy_says(monkeypatch: pytest.MonkeyPatch) -> None:
    states = tumultuous_flight()
    monkeypatch.setattr(physics, "step", emulated_vehicles.step)
    expected = tumultuous_flight()
    for name in (
        "position_ned_m",
        "velocity_ned_m_s",
        "attitude",
        "tilt_rate_rad_s",
        "on_ground",
        "motors_dead",
    ):
        np.testing.assert_allclose(
            getattr(states, name), getattr(expected, name), atol=1e-9, err_msg=name
        )


@pytest.mark.long
def test_without_numba_the_same_flight_is_interpreted() -> None:
    program = (
        "import sys; sys.modules['numba'] = None\n"
        "from tests.sitl.physics.test_vehicle import tumultuous_flight\n"
        "print(tumultuous_flight().position_ned_m.ravel().tolist())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    expected = tumultuous_flight().position_ned_m.ravel()
    np.testing.assert_allclose(json.loads(done.stdout), expected, atol=1e-9)


def test_the_weak_vehicle_never_reaches_the_requested_tilt() -> None:
    _, fractions = step_response(ARDRONE, 0, 10.0)
    vehicles, _ = hovering(ARDRONE)
    bias = float(vehicles.tilt_bias_rad[0, 0])
    assert abs(np.degrees(bias)) <= 1.5
    assert fractions[-1] == pytest.approx(0.9 + bias / np.radians(10.0), abs=1e-3)


def test_exact_hover_thrust_holds_the_height_and_a_tenth_more_climbs_as_measured() -> None:
    vehicles, commands = hovering(SIH)
    assert abs(vehicles.states.velocity_ned_m_s[0, 2]) < 0.6  # the motors had to spin up first
    before = float(vehicles.states.velocity_ned_m_s[0, 2])
    commands.thrust_frac[:] += 0.1
    for _ in range(150):
        vehicles.step(commands)
    gained = before - float(vehicles.states.velocity_ned_m_s[0, 2])
    assert gained == pytest.approx(0.88, abs=0.15)


def test_the_weak_vehicle_climbs_at_most_with_a_third_of_gravity() -> None:
    vehicles, commands = hovering(ARDRONE)
    commands.thrust_frac[:] = 1.0
    for _ in range(75):
        vehicles.step(commands)
    climb = -float(vehicles.states.acceleration_ned_m_s2[0, 2])
    assert 0.8 * GRAVITY_M_S2 / 3.0 < climb < 1.05 * GRAVITY_M_S2 / 3.0


def test_a_tilt_to_the_right_accelerates_to_the_right_of_the_nose() -> None:
    for yaw_rad, expected in ((0.0, (0.0, 1.0)), (np.pi / 2, (-1.0, 0.0))):
        vehicles, commands = hovering(SIH, yaw_rad)
        commands.attitude[:] = frames.from_yaw_and_tilt(np.array([yaw_rad]), np.array([[0.2, 0.0]]))
        for _ in range(100):
            vehicles.step(commands)
        velocity = vehicles.states.velocity_ned_m_s[0, :2]
        assert velocity @ np.array(expected) > 0.3
        assert abs(velocity @ np.array([expected[1], -expected[0]])) < 0.02


def test_the_ground_carries_a_vehicle_and_stops_a_falling_one() -> None:
    vehicles, commands = hovering(SIH)
    commands.motors_on[:] = False
    for _ in range(2000):
        vehicles.step(commands)
    states = vehicles.states
    assert states.on_ground[0]
    assert states.position_ned_m[0, 2] == 0.0
    assert not states.velocity_ned_m_s.any()
    before = states.position_ned_m.copy()
    commands.motors_on[:] = True
    commands.thrust_frac[:] = 0.8 * SIH.hover_thrust_frac
    commands.attitude[:] = frames.from_yaw_and_tilt(np.zeros(1), np.array([[0.3, 0.0]]))
    for _ in range(500):
        vehicles.step(commands)
    assert np.array_equal(vehicles.states.position_ned_m, before)


def test_equal_seeds_give_equal_flights_and_other_seeds_do_not() -> None:
    ends = []
    for seed in (4, 4, 5):
        vehicles = Vehicles([ARDRONE], np.array([[0.0, 0.0, -5.0]]), np.zeros(1), seed=seed)
        commands = Commands.level(np.zeros(1))
        commands.motors_on[:] = True
        commands.thrust_frac[:] = 0.76
        for _ in range(300):
            vehicles.step(commands)
        ends.append(vehicles.states.position_ned_m.copy())
    assert np.array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


def test_many_vehicles_fly_as_each_one_alone() -> None:
    profiles = [
        SIH,
        VehicleProfile(hover_thrust_frac=0.7, attitude_wn_rad_s=6.0, attitude_delay_s=0.1),
    ]
    start = np.array([[0.0, 0.0, -5.0], [3.0, 1.0, -6.0]])
    tilt = np.array([[0.1, -0.2], [-0.3, 0.05]])

    def fly(rows: list[int]) -> np.ndarray:
        vehicles = Vehicles([profiles[r] for r in rows], start[rows], np.zeros(len(rows)), seed=0)
        commands = Commands.level(np.zeros(len(rows)))
        commands.motors_on[:] = True
        commands.thrust_frac[:] = 0.6
        commands.attitude[:] = frames.from_yaw_and_tilt(np.zeros(len(rows)), tilt[rows])
        for _ in range(200):
            vehicles.step(commands)
        return vehicles.states.position_ned_m

    together = fly([0, 1])
    for row in (0, 1):
        np.testing.assert_allclose(fly([row])[0], together[row], atol=1e-12)


def test_conversions_to_the_fleet_frame_are_those_of_a_rotation_matrix() -> None:
    rng = np.random.default_rng(0)
    q = rng.standard_normal((50, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    turned = frames.enu_flu_from_ned_frd(q)
    # Body z up (FLU) is the opposite of body z down (FRD), seen in ENU.
    np.testing.assert_allclose(
        emulated_vehicles.body_down(turned),
        -frames.swap_enu_ned(emulated_vehicles.body_down(q)),
        atol=1e-12,
    )
    north = frames.enu_flu_from_ned_frd(np.array([1.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(emulated_vehicles.heading(north), np.pi / 2, atol=1e-12)


def test_each_vehicle_stands_and_lands_on_the_ground_of_its_own_spot() -> None:
    emu = emulator((0.0, 0.0, 0.0), (4.0, 0.0, 5.0), (8.0, 0.0, -0.9))
    states = emu.world.vehicles.states
    spots_m = [0.0, 5.0, -0.9]
    run_for(emu, 0.2)
    assert [height_m(emu, index) for index in range(3)] == spots_m
    assert states.on_ground.all()

    states.position_ned_m[:, 2] -= 1.0  # a metre up, from where they fall
    run_for(emu, 0.2)
    assert not states.on_ground.any()
    run_for(emu, 0.8)
    assert [height_m(emu, index) for index in range(3)] == spots_m
    assert states.on_ground.all()
    assert emu.world.vehicles.motion["touchdowns"].tolist() == [1, 1, 1]
    speeds_m_s = emu.world.vehicles.motion["touchdown_speed"]
    np.testing.assert_allclose(speeds_m_s, speeds_m_s[0], rtol=1e-6)


def test_a_spot_is_a_platform_for_all_vehicles_and_the_ground_beside_it_is_the_lowest() -> None:
    emu = emulator((0.0, 0.0, 2.0), (8.0, 0.0, 0.5))
    states = emu.world.vehicles.states
    for east_m, from_m, ground_m in (
        (0.99, 3.0, 2.0),
        (1.01, 3.0, 0.0),
        (7.5, 3.0, 0.5),
        (0.5, 1.9, 0.0),  # below the platform
    ):
        states.position_ned_m[0] = [0.0, east_m, -from_m]
        states.on_ground[0] = False
        run_for(emu, 1.0)
        assert height_m(emu) == ground_m
        assert states.on_ground[0]


def test_all_spots_on_tables_do_not_lift_the_floor() -> None:
    emu = emulator((0.0, 0.0, 0.6), (4.0, 0.0, 0.6))
    emu.world.vehicles.states.position_ned_m[0] = [0.0, 2.0, -1.0]
    run_for(emu, 1.0)
    assert height_m(emu) == 0.0


def test_a_vehicle_that_comes_below_a_platform_from_aside_is_not_lifted() -> None:
    emu = emulator((0.0, 0.0, 2.0))
    states = emu.world.vehicles.states
    states.position_ned_m[0] = [0.0, 1.2, -1.95]
    states.velocity_ned_m_s[0] = [0.0, -3.0, 0.0]
    states.on_ground[0] = False
    run_for(emu, 0.1)
    assert float(states.position_ned_m[0, 1]) < 1.0
    assert 1.85 < height_m(emu) < 1.95
    assert not states.on_ground[0]


def test_where_platforms_overlap_the_nearest_spot_counts() -> None:
    emu = emulator((0.0, 0.0, 0.0), (0.8, 0.0, 0.4), (0.0, 5.0, 0.0), (0.0, 5.0, 1.5))
    states = emu.world.vehicles.states
    run_for(emu, 0.2)
    assert [height_m(emu, index) for index in range(4)] == [0.0, 0.4, 0.0, 1.5]
    states.position_ned_m[:, 2] -= 0.3
    run_for(emu, 0.5)
    assert [height_m(emu, index) for index in range(4)] == [0.0, 0.4, 0.0, 1.5]


def test_platforms_carry_as_the_oracle_in_numpy_says() -> None:
    rng = np.random.default_rng(5)
    spots = rng.uniform(-2.0, 2.0, (6, 3))
    spots[1, :2] = spots[0, :2]
    ground = physics.Ground(down=2.0, spots=spots, radius=1.0)
    positions = rng.uniform(-2.5, 2.5, (200, 3))
    below = [physics.ground_below(position, ground) for position in positions]
    np.testing.assert_array_equal(below, emulated_vehicles.ground_below(positions, ground))
    assert len(set(below)) == 7


def test_the_distance_sensor_measures_from_the_ground_below() -> None:
    emu = emulator((4.0, 0.0, 5.0))
    position_ned_m = emu.world.vehicles.states.position_ned_m
    for east_m, measured_cm in ((4.0, 250), (6.0, 750)):
        position_ned_m[0] = [0.0, east_m, -7.5]
        message = distance_sensor(View(emu, 0))
        assert message is not None
        assert measured_cm in message
