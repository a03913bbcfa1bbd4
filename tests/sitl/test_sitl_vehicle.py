"""Physics of one vehicle against the measured responses of PX4's own simulator."""

from __future__ import annotations

import numpy as np
import pytest

from sitl import rotation
from sitl.vehicle import GRAVITY_M_S2, STEP_S, Commands, VehicleProfile, Vehicles
from tests.sitl.sitl_flying import ARDRONE, SIH


def hovering(profile: VehicleProfile, yaw_rad: float = 0.0) -> tuple[Vehicles, Commands]:
    """A vehicle that has hovered for a second, 20 m high."""
    vehicles = Vehicles([profile], np.array([[0.0, 0.0, -20.0]]), np.array([yaw_rad]), seed=1)
    commands = Commands.level(np.array([yaw_rad]))
    commands.motors_on[:] = True
    commands.thrust_frac[:] = profile.hover_thrust_frac
    for _ in range(250):
        vehicles.step(commands)
    return vehicles, commands


def step_response(profile: VehicleProfile, axis: int, size_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and the fraction of a commanded step about roll (0), pitch (1) or yaw (2)."""
    vehicles, commands = hovering(profile)
    size = np.radians(size_deg)
    if axis < 2:
        tilt = np.zeros((1, 2))
        tilt[0, axis] = size
        commands.attitude[:] = rotation.from_yaw_and_tilt(np.zeros(1), tilt)
    else:
        commands.attitude[:] = rotation.yaw_quaternion(np.array([size]))
    fractions = []
    for _ in range(625):
        vehicles.step(commands)
        s = vehicles.states
        fractions.append((s.tilt_rad[0, axis] if axis < 2 else s.yaw_rad[0]) / size)
    return (np.arange(625) + 1) * STEP_S, np.array(fractions)


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


def test_yaw_of_the_sih_quad_is_about_three_times_slower() -> None:
    times, fractions = step_response(SIH, 2, 30.0)
    for level, measured_s in ((0.05, 0.220), (0.63, 0.615), (0.9, 0.765)):
        assert agrees(reached_s(times, fractions, level), measured_s), level


def test_the_weak_vehicle_never_reaches_the_tilt_it_is_asked_for() -> None:
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
        commands.attitude[:] = rotation.from_yaw_and_tilt(np.array([yaw_rad]), np.array([[0.2, 0.0]]))
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
    commands.attitude[:] = rotation.from_yaw_and_tilt(np.zeros(1), np.array([[0.3, 0.0]]))
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
    profiles = [SIH, VehicleProfile(hover_thrust_frac=0.7, attitude_wn_rad_s=6.0, attitude_delay_s=0.1)]
    start = np.array([[0.0, 0.0, -5.0], [3.0, 1.0, -6.0]])
    tilt = np.array([[0.1, -0.2], [-0.3, 0.05]])

    def fly(rows: list[int]) -> np.ndarray:
        vehicles = Vehicles([profiles[r] for r in rows], start[rows], np.zeros(len(rows)), seed=0)
        commands = Commands.level(np.zeros(len(rows)))
        commands.motors_on[:] = True
        commands.thrust_frac[:] = 0.6
        commands.attitude[:] = rotation.from_yaw_and_tilt(np.zeros(len(rows)), tilt[rows])
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
    turned = rotation.enu_flu_from_ned_frd(q)
    # Body z up (FLU) is the opposite of body z down (FRD), seen in ENU.
    np.testing.assert_allclose(rotation.body_down(turned), -rotation.swap_enu_ned(rotation.body_down(q)), atol=1e-12)
    north = rotation.enu_flu_from_ned_frd(np.array([1.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(rotation.heading(north), np.pi / 2, atol=1e-12)
