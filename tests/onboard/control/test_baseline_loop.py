"""The baseline alone in a closed loop with the paper's weak vehicle: every stage with its own
imperfect input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from onboard import frames
from onboard.constants import GRAVITY_M_S2
from onboard.control import allocation, backstepping, trajectory
from onboard.estimation import disturbance_observer, hover_thrust, kalman
from onboard.types import AttitudeSetpoint, Goal, Thrust
from onboard.vectors import ZERO_3, Vec3
from tests.oracles.rotation import quaternion_multiply

Array = np.ndarray
G = GRAVITY_M_S2
DT = 0.02
UP = np.array([0.0, 0.0, G])


@dataclass(frozen=True)
class Flight:
    """Errors over time (T, n, 3)."""

    velocity_error_m_s: Array
    tracking_m: Array
    thrust_enu_m_s2: Array


@dataclass
class Vehicle:
    """The weak vehicle: wn 6 +- 10 %, gain 0.9, 1.5 deg tilt bias, hover throttle wrong by 6 %,
    gusts.
    """

    rng: np.random.Generator

    def __post_init__(self) -> None:
        self.wn = 6.0 * (1.0 + self.rng.uniform(-0.1, 0.1))
        self.true_hover = 0.75 * (1.0 + self.rng.uniform(-0.06, 0.06))
        side = self.rng.uniform(0.0, 2.0 * math.pi)
        self.bias = math.radians(1.5) * np.array([math.cos(side), math.sin(side)])
        self.p = np.array([0.0, 0.0, 1.2])
        self.v = np.zeros(3)
        self.gust = np.zeros(3)
        self.angle = np.zeros(2)
        self.rate = np.zeros(2)
        self.motor = G
        self.commanded = [np.zeros(2)] * 3

    def attitude(self) -> frames.Quaternion:
        pitch, roll = 0.5 * self.angle
        return quaternion_multiply(
            (math.cos(pitch), 0.0, math.sin(pitch), 0.0), (math.cos(roll), math.sin(roll), 0.0, 0.0)
        )

    def move(self, attitude: AttitudeSetpoint) -> None:
        up = frames.body_up(attitude.quaternion_wxyz)
        self.commanded.append(np.array([math.atan2(up.x, up.z), -math.asin(up.y)]))
        h = DT / 5
        for _ in range(5):
            push = self.wn * self.wn * (0.9 * self.commanded[-3] - self.angle)
            self.rate = self.rate + h * (push - 1.4 * self.wn * self.rate)
            self.angle = self.angle + h * self.rate
            self.motor += h / 0.05 * (attitude.thrust_frac / self.true_hover * G - self.motor)
            self.gust = (
                self.gust - h * self.gust + 0.05 * math.sqrt(2 * h) * self.rng.normal(size=3)
            )
            x, y = self.angle + self.bias
            lean = np.array([math.sin(x) * math.cos(y), -math.sin(y), math.cos(x) * math.cos(y)])
            self.v = self.v + h * (self.motor * lean - UP - 0.3 * self.v + self.gust)
            self.p = self.p + h * self.v


def fly_one(
    rng: np.random.Generator, seconds: float, observes: bool
) -> list[tuple[Array, Array, Array]]:
    """Two legs of one vehicle with 20 ms old mocap: error of the velocity, of the tracking, and
    thrust of each tick.
    """
    vehicle = Vehicle(rng)
    filter_params = kalman.KalmanParams(drag_1_s=0.3)
    observer_params = disturbance_observer.ObserverParams(wn_rad_s=6.0, zeta=0.7, drag_1_s=0.3)
    hover_params = hover_thrust.HoverThrustParams(0.75)
    limits = allocation.AllocationParams(math.radians(25.0), 0.75)
    start = Vec3(*vehicle.p.tolist())
    own = kalman.initial(start, filter_params)
    observer = disturbance_observer.initial(ZERO_3)
    lift = hover_thrust.initial(hover_params)
    leg = trajectory.initial(start)
    attitude = allocation.allocate(Thrust(Vec3(0.0, 0.0, G)), 0.0, 0.75, limits)
    sent = ZERO_3
    net = [np.zeros(3)] * 14
    old = vehicle.p
    samples = []
    for tick in range(round(seconds / DT)):
        flown = vehicle.attitude()
        own = kalman.drive(
            own, flown, attitude.thrust_frac, lift.hover_thrust_frac, filter_params, DT, False
        )
        if tick:
            own = kalman.correct(
                own, Vec3(*(old + rng.normal(0.0, 0.003, 3)).tolist()), DT, filter_params
            )
        old = vehicle.p
        state = kalman.state(own, 0.0, 0.0, 0.0)
        observer, disturbance = disturbance_observer.step(
            observer, state.velocity_enu_m_s, sent, observer_params, DT, False
        )
        lift, hover = hover_thrust.step(
            lift, attitude.thrust_frac, frames.body_up(flown).z, state.acceleration_enu_m_s2.z,
            state.position_enu_m.z, hover_params, DT, True,
        )  # fmt: skip
        ahead = np.array(state.position_enu_m)
        ahead_v = np.array(state.velocity_enu_m_s)
        for u in net[-14:]:  # 0.27 s of own commands, horizontally
            ahead[:2] += DT * ahead_v[:2] + 0.5 * DT * DT * u[:2]
            ahead_v[:2] += DT * u[:2]
        is_second = tick * DT >= 8.0
        goal = Goal(Vec3(-1.0, 1.5, 1.6) if is_second else Vec3(2.0, 1.0, 1.2), 0.0, int(is_second))
        leg, setpoint = trajectory.step(
            leg, goal, trajectory.TrajectoryParams(1.0, 1.5, lead_s=0.27), DT, 1.0
        )
        thrust = np.array(
            backstepping.step(
                Vec3(*ahead.tolist()),
                Vec3(*ahead_v.tolist()),
                setpoint,
                backstepping.BacksteppingParams(),
            ).thrust_enu_m_s2
        )
        extra = 0.3 * ahead_v - (np.array(disturbance) if observes else 0.0)
        limited = allocation.limit(Thrust(Vec3(*(thrust + extra).tolist())), hover, limits)
        attitude = allocation.allocate(limited, 0.0, hover, limits)
        x, y, z = limited.thrust_enu_m_s2
        sent = Vec3(x, y, z - G)
        net.append(np.array(sent) - extra)
        samples.append(
            (own.velocity_enu_m_s - vehicle.v, vehicle.p - setpoint.position_enu_m, thrust)
        )
        vehicle.move(attitude)
    return samples


def fly(*, seconds: float = 16.0, n: int = 6, observes: bool = True, seed: int = 0) -> Flight:
    flown = [fly_one(np.random.default_rng([seed, k]), seconds, observes) for k in range(n)]
    return Flight(*np.array(flown).transpose(2, 1, 0, 3))


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly()


@pytest.mark.long
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


@pytest.mark.long
def test_without_the_observer_the_static_errors_of_the_weak_vehicle_remain(flight: Flight) -> None:
    without = fly(observes=False)
    rest = np.linalg.norm(without.tracking_m[-50:, :, :2], axis=-1).mean()
    assert rest > 2.0 * np.linalg.norm(flight.tracking_m[-50:, :, :2], axis=-1).mean()
