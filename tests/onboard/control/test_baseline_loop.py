"""The baseline alone in a closed loop with the paper's weak vehicle: every stage with its own imperfect input."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from onboard import frames
from onboard.control import allocation, backstepping, trajectory
from onboard.estimation import disturbance_observer, hover_thrust, kalman
from onboard.types import GRAVITY_M_S2, Array, Goal, Thrust

G = GRAVITY_M_S2
DT = 0.02
UP = np.array([0.0, 0.0, G])


@dataclass(frozen=True)
class Flight:
    """Errors over time (T, n, 3)."""

    velocity_error_m_s: Array
    tracking_m: Array
    thrust_enu_m_s2: Array


def fly(*, seconds: float = 16.0, n: int = 20, observes: bool = True, seed: int = 0) -> Flight:
    """Two legs; wn 6 +- 10 %, gain 0.9, 1.5 deg tilt bias, hover throttle wrong by 6 %, gusts, 20 ms old mocap."""
    rng = np.random.default_rng(seed)
    wn = 6.0 * (1.0 + rng.uniform(-0.1, 0.1, (n, 1)))
    true_hover = 0.75 * (1.0 + rng.uniform(-0.06, 0.06, n))
    side = rng.uniform(0.0, 2.0 * math.pi, n)
    bias = math.radians(1.5) * np.stack([np.cos(side), np.sin(side)], axis=-1)
    p, v, gust, angle, rate = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 2)), np.zeros((n, 2))
    p[:, 2] = 1.2
    motor = np.full(n, G)
    filter_params = kalman.EstimateParams(drag_1_s=0.3)
    observer_params = disturbance_observer.ObserverParams(wn_rad_s=6.0, zeta=0.7, drag_1_s=0.3)
    hover_params = hover_thrust.HoverThrustParams(0.75)
    limits = allocation.params_from_degrees(25.0, 0.75)
    own, observer = kalman.initial(p, params=filter_params), disturbance_observer.initial(v, params=observer_params)
    hover_memory, leg = hover_thrust.initial((n,), params=hover_params), trajectory.initial(p)
    attitude = allocation.allocate(Thrust(np.tile(UP, (n, 1))), np.zeros(n), np.full(n, 0.75), params=limits)
    sent, net = np.zeros((n, 3)), [np.zeros((n, 3))] * 14
    asked = [np.zeros((n, 2))] * 3
    old = p.copy()
    velocity_error, tracking, thrusts = [], [], []
    for tick in range(round(seconds / DT)):
        half = 0.5 * angle
        pitch = np.stack([np.cos(half[:, 0]), 0 * half[:, 0], np.sin(half[:, 0]), 0 * half[:, 0]], axis=-1)
        roll = np.stack([np.cos(half[:, 1]), np.sin(half[:, 1]), 0 * half[:, 1], 0 * half[:, 1]], axis=-1)
        flown = frames.quaternion_multiply(pitch, roll)
        hover = hover_memory.hover_thrust_frac
        own = kalman.drive(own, flown, attitude.thrust_frac, hover, params=filter_params, dt_s=DT)
        if tick:
            sample = old + rng.normal(0.0, 0.003, (n, 3))
            own = kalman.correct(own, sample, np.full(n, DT), params=filter_params)
        old = p.copy()
        state = kalman.state(own)
        observer = disturbance_observer.observe(observer, state.velocity_enu_m_s, sent, params=observer_params, dt_s=DT)
        hover_memory, hover = hover_thrust.step(
            hover_memory, attitude.thrust_frac, frames.body_up(flown)[:, 2], state.acceleration_enu_m_s2[:, 2],
            state.position_enu_m[:, 2], params=hover_params, dt_s=DT,
        )  # fmt: skip
        ahead, ahead_v = state.position_enu_m.copy(), state.velocity_enu_m_s.copy()
        for u in net[-14:]:  # 0.27 s of own commands, horizontally
            ahead[:, :2] += DT * ahead_v[:, :2] + 0.5 * DT * DT * u[:, :2]
            ahead_v[:, :2] += DT * u[:, :2]
        target = np.array([2.0, 1.0, 1.2]) if tick * DT < 8.0 else np.array([-1.0, 1.5, 1.6])
        goal = Goal(np.tile(target, (n, 1)), np.zeros(n), np.full(n, int(tick * DT >= 8.0)))
        leg, setpoint = trajectory.step(leg, goal, params=trajectory.GuidanceParams(1.0, 1.5, 0.27), dt_s=DT)
        thrust = backstepping.step(ahead, ahead_v, setpoint, params=backstepping.BacksteppingParams()).thrust_enu_m_s2
        extra = 0.3 * ahead_v - (observer.disturbance_enu_m_s2 if observes else 0.0)
        limited = allocation.limit(Thrust(thrust + extra), hover, params=limits)
        attitude = allocation.allocate(limited, np.zeros(n), hover, params=limits)
        sent = limited.thrust_enu_m_s2 - UP
        net.append(sent - extra)
        direction = frames.body_up(attitude.quaternion_wxyz)
        asked.append(np.stack([np.arctan2(direction[:, 0], direction[:, 2]), -np.arcsin(direction[:, 1])], axis=-1))
        velocity_error.append(own.velocity_enu_m_s - v)
        tracking.append(p - setpoint.position_enu_m)
        thrusts.append(thrust)
        h = DT / 5
        for _ in range(5):
            rate = rate + h * (wn * wn * (0.9 * asked[-3] - angle) - 1.4 * wn * rate)
            angle = angle + h * rate
            motor = motor + h / 0.05 * (attitude.thrust_frac / true_hover * G - motor)
            gust = gust - h * gust + 0.05 * np.sqrt(2 * h) * rng.normal(size=gust.shape)
            a = angle + bias
            up = np.stack([np.sin(a[:, 0]) * np.cos(a[:, 1]), -np.sin(a[:, 1]), np.cos(a[:, 0]) * np.cos(a[:, 1])], -1)
            v = v + h * (motor[:, None] * up - UP - 0.3 * v + gust)
            p = p + h * v
    return Flight(np.array(velocity_error), np.array(tracking), np.array(thrusts))


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly()


def test_the_velocity_is_known_to_two_centimetres_per_second_in_closed_loop(flight: Flight) -> None:
    assert flight.velocity_error_m_s[150:].std() < 0.02


def test_every_vehicle_ends_within_ten_centimetres_of_its_goal(flight: Flight) -> None:
    assert np.linalg.norm(flight.tracking_m[-50:], axis=-1).max() < 0.10


def test_tracking_errors_stay_small_all_the_way(flight: Flight) -> None:
    horizontal = np.linalg.norm(flight.tracking_m[..., :2], axis=-1)
    assert horizontal.max() < 0.45  # of which 0.27 s of lead make 0.27 m at full speed
    assert np.abs(flight.tracking_m[..., 2]).max() < 0.15


def test_the_thrust_asked_is_smooth(flight: Flight) -> None:
    slew = np.diff(flight.thrust_enu_m_s2[50:], axis=0) / DT
    assert np.sqrt((slew**2).sum(-1).mean()) < 8.0


def test_without_the_observer_the_static_errors_of_the_weak_vehicle_remain(flight: Flight) -> None:
    without = fly(observes=False)
    rest = np.linalg.norm(without.tracking_m[-50:, :, :2], axis=-1).mean()
    assert rest > 2.0 * np.linalg.norm(flight.tracking_m[-50:, :, :2], axis=-1).mean()
