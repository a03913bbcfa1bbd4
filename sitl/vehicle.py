"""Rigid vehicles that fly what an autopilot asks: attitude response, thrust, drag, ground. Vectorised and seeded.

The inner attitude loop of PX4 is not computed; its measured response is: a dead time, then a second-order system in
the tilt vector, another one in the heading. A weak loop additionally has a gain below one and a constant tilt bias.
Frames: NED world, FRD body, ground at z = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sitl import rotation
from sitl.rotation import Array

GRAVITY_M_S2 = 9.80665
STEP_S = 0.004  # 250 Hz: the loop of PX4's own simulator, and the resolution of every dead time below
_THRUST_NOISE_CORRELATION_S = 0.1
_GUST_CORRELATION_S = 1.0
_RATE_LOOP_S = 0.15


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """What distinguishes one kind of vehicle from another; the defaults are PX4's SIH quadrotor as measured.

    Attributes:
        mass_kg: only kept for users of the profile; every force below is already divided by it.
        hover_thrust_frac: normalised thrust that carries the weight; thrust is linear in the command.
        attitude_delay_s, attitude_wn_rad_s, attitude_zeta: response of roll and pitch.
        drag_1_s: linear drag over mass [1/s].
        static_gain: tilt reached over tilt asked.
        tilt_bias_deg: largest constant tilt error per axis; the actual one is drawn from the seed.
        yaw_delay_s, yaw_wn_rad_s, yaw_zeta: response of the heading.
        motor_lag_s: time constant of the thrust.
        thrust_noise_frac: standard deviation of the relative thrust error.
        gust_std_m_s2: standard deviation of the acceleration by gusts, per horizontal axis.
    """

    mass_kg: float = 1.0
    hover_thrust_frac: float = 0.49
    attitude_delay_s: float = 0.04
    attitude_wn_rad_s: float = 11.0
    attitude_zeta: float = 0.6
    drag_1_s: float = 1.0
    static_gain: float = 1.0
    tilt_bias_deg: float = 0.0
    yaw_delay_s: float = 0.12
    yaw_wn_rad_s: float = 3.0
    yaw_zeta: float = 0.4
    motor_lag_s: float = 0.05
    thrust_noise_frac: float = 0.0
    gust_std_m_s2: float = 0.0
    max_tilt_rate_deg_s: float = 220.0
    max_yaw_rate_deg_s: float = 200.0


@dataclass(slots=True)
class Commands:
    """What the autopilots ask of their vehicles; one row each, written in place.

    Attributes:
        attitude: quaternion NED <- FRD (n, 4).
        rate_rad_s: body rates (n, 3), used where `is_rate`.
        is_rate: (n,) body rates instead of an attitude.
        thrust_frac: collective thrust in [0, 1] (n,).
        motors_on: (n,) without it the thrust is zero at once.
    """

    attitude: Array
    rate_rad_s: Array
    is_rate: NDArray[np.bool_]
    thrust_frac: Array
    motors_on: NDArray[np.bool_]

    @classmethod
    def level(cls, yaw_rad: Array) -> Commands:
        """Motors off, level, each at its heading."""
        n = yaw_rad.shape[0]
        return cls(
            attitude=rotation.yaw_quaternion(yaw_rad),
            rate_rad_s=np.zeros((n, 3)),
            is_rate=np.zeros(n, dtype=np.bool_),
            thrust_frac=np.zeros(n),
            motors_on=np.zeros(n, dtype=np.bool_),
        )


def second_order_step(wn_rad_s: Array, zeta: Array, dt_s: float) -> tuple[Array, Array, Array, Array]:
    """Exact transition of x'' = -wn^2 x - 2 zeta wn x' over one step, for any damping.

    The Taylor series of the matrix exponential converges to rounding, since wn dt is far below one.

    Returns:
        the four entries (n,) of the 2x2 transition matrix, row by row.
    """
    n = wn_rad_s.shape[0]
    generator = np.zeros((n, 2, 2))
    generator[:, 0, 1] = 1.0
    generator[:, 1, 0] = -(wn_rad_s**2)
    generator[:, 1, 1] = -2.0 * zeta * wn_rad_s
    term = np.broadcast_to(np.eye(2), (n, 2, 2)).copy()
    total = term.copy()
    for order in range(1, 20):
        term = term @ generator * (dt_s / order)
        total += term
    return total[:, 0, 0], total[:, 0, 1], total[:, 1, 0], total[:, 1, 1]


@dataclass(slots=True)
class _Response:
    """Constants of one second-order response and its dead time."""

    p00: Array
    p01: Array
    p10: Array
    p11: Array
    delay_steps: NDArray[np.int64]


def _response(delay_s: list[float], wn_rad_s: list[float], zeta: list[float]) -> _Response:
    p00, p01, p10, p11 = second_order_step(np.array(wn_rad_s), np.array(zeta), STEP_S)
    delay = np.rint(np.array(delay_s) / STEP_S).astype(np.int64)
    return _Response(p00, p01, p10, p11, delay)


@dataclass(slots=True)
class VehicleStates:
    """Truth, one row per vehicle: NED [m, m/s], tilt vector and heading [rad], their rates, thrust [-]."""

    position_ned_m: Array
    velocity_ned_m_s: Array
    acceleration_ned_m_s2: Array
    tilt_rad: Array
    tilt_rate_rad_s: Array
    yaw_rad: Array
    yaw_rate_rad_s: Array
    thrust_frac: Array
    attitude: Array
    on_ground: NDArray[np.bool_]
    motors_dead: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))


class Vehicles:
    """Physics of several vehicles, advanced 4 ms at a time."""

    def __init__(self, profiles: list[VehicleProfile], position_ned_m: Array, yaw_rad: Array, *, seed: int) -> None:
        n = len(profiles)
        self.profiles = list(profiles)
        self._rng = np.random.default_rng([seed, 1])
        self._tilt = _response(
            [p.attitude_delay_s for p in profiles],
            [p.attitude_wn_rad_s for p in profiles],
            [p.attitude_zeta for p in profiles],
        )
        self._yaw = _response(
            [p.yaw_delay_s for p in profiles], [p.yaw_wn_rad_s for p in profiles], [p.yaw_zeta for p in profiles]
        )
        self._gain = np.array([p.static_gain for p in profiles])[:, None]
        bias_limit_rad = np.radians([p.tilt_bias_deg for p in profiles])[:, None]
        self.tilt_bias_rad = bias_limit_rad * self._rng.uniform(-1.0, 1.0, (n, 2))
        self._accel_per_thrust = GRAVITY_M_S2 / np.array([p.hover_thrust_frac for p in profiles])
        self._drag_1_s = np.array([p.drag_1_s for p in profiles])[:, None]
        self._motor_blend = 1.0 - np.exp(-STEP_S / np.maximum([p.motor_lag_s for p in profiles], 1e-6))
        self._thrust_noise = np.array([p.thrust_noise_frac for p in profiles])
        self._gust = np.array([p.gust_std_m_s2 for p in profiles])[:, None]
        self._has_gust = bool(np.any(self._gust > 0.0))
        self._max_tilt_rate = np.radians([p.max_tilt_rate_deg_s for p in profiles])[:, None]
        self._max_yaw_rate = np.radians([p.max_yaw_rate_deg_s for p in profiles])
        self._noise_state = np.zeros(n)
        self._gust_state = np.zeros((n, 2))
        depth = int(max(self._tilt.delay_steps.max(initial=0), self._yaw.delay_steps.max(initial=0))) + 1
        yaw = np.array(yaw_rad, dtype=np.float64)
        attitude = rotation.yaw_quaternion(yaw)
        self._attitude_history = np.repeat(attitude[None], depth, axis=0)
        self._rate_history = np.zeros((depth, n, 3))
        self._rows = np.arange(n)
        self._rate_blend = 1.0 - math.exp(-STEP_S / _RATE_LOOP_S)
        self.steps = 0
        self.states = VehicleStates(
            position_ned_m=np.array(position_ned_m, dtype=np.float64),
            velocity_ned_m_s=np.zeros((n, 3)),
            acceleration_ned_m_s2=np.zeros((n, 3)),
            tilt_rad=np.zeros((n, 2)),
            tilt_rate_rad_s=np.zeros((n, 2)),
            yaw_rad=yaw,
            yaw_rate_rad_s=np.zeros(n),
            thrust_frac=np.zeros(n),
            attitude=attitude.copy(),
            on_ground=np.array(position_ned_m)[:, 2] >= 0.0,
            motors_dead=np.zeros(n, dtype=np.bool_),
        )

    def step(self, commands: Commands) -> None:
        """Advance all vehicles by `STEP_S` under `commands`."""
        slot = self.steps % self._attitude_history.shape[0]
        self._attitude_history[slot] = commands.attitude
        self._rate_history[slot] = commands.rate_rad_s
        self._turn(commands)
        self._move(commands)
        self.steps += 1

    def _delayed(self, history: Array, delay_steps: NDArray[np.int64]) -> Array:
        return np.asarray(history[(self.steps - delay_steps) % history.shape[0], self._rows])

    def _turn(self, commands: Commands) -> None:
        s = self.states
        asked = self._delayed(self._attitude_history, self._tilt.delay_steps)
        down = rotation.body_down(asked)
        # The direction of the thrust has priority over the heading, as in PX4: the asked direction is looked at from
        # the heading that the vehicle really has.
        cos_yaw, sin_yaw = np.cos(s.yaw_rad), np.sin(s.yaw_rad)
        down_heading = np.stack(
            [cos_yaw * down[:, 0] + sin_yaw * down[:, 1], -sin_yaw * down[:, 0] + cos_yaw * down[:, 1], down[:, 2]],
            axis=-1,
        )
        goal = self._gain * rotation.tilt_from_down(down_heading) + self.tilt_bias_rad
        error = s.tilt_rad - goal
        t, y = self._tilt, self._yaw
        tilt = goal + t.p00[:, None] * error + t.p01[:, None] * s.tilt_rate_rad_s
        tilt_rate = t.p10[:, None] * error + t.p11[:, None] * s.tilt_rate_rad_s

        yaw_goal = rotation.heading(self._delayed(self._attitude_history, y.delay_steps))
        yaw_error = rotation.wrap(s.yaw_rad - yaw_goal)
        yaw = s.yaw_rad + (y.p00 - 1.0) * yaw_error + y.p01 * s.yaw_rate_rad_s
        yaw_rate = y.p10 * yaw_error + y.p11 * s.yaw_rate_rad_s

        if commands.is_rate.any():
            rate = self._delayed(self._rate_history, t.delay_steps)
            free_tilt_rate = s.tilt_rate_rad_s + self._rate_blend * (rate[:, :2] - s.tilt_rate_rad_s)
            free_yaw_rate = s.yaw_rate_rad_s + self._rate_blend * (rate[:, 2] - s.yaw_rate_rad_s)
            tilt = np.where(commands.is_rate[:, None], s.tilt_rad + STEP_S * free_tilt_rate, tilt)
            tilt_rate = np.where(commands.is_rate[:, None], free_tilt_rate, tilt_rate)
            yaw = np.where(commands.is_rate, s.yaw_rad + STEP_S * free_yaw_rate, yaw)
            yaw_rate = np.where(commands.is_rate, free_yaw_rate, yaw_rate)

        # A vehicle on its feet does not turn, whatever is asked.
        flies = ~s.on_ground
        s.tilt_rad = tilt * flies[:, None]
        s.tilt_rate_rad_s = np.clip(tilt_rate, -self._max_tilt_rate, self._max_tilt_rate) * flies[:, None]
        s.yaw_rad = np.where(flies, rotation.wrap(yaw), s.yaw_rad)
        s.yaw_rate_rad_s = np.clip(yaw_rate, -self._max_yaw_rate, self._max_yaw_rate) * flies
        s.attitude = rotation.from_yaw_and_tilt(s.yaw_rad, s.tilt_rad)

    def _move(self, commands: Commands) -> None:
        s = self.states
        turning = commands.motors_on & ~s.motors_dead
        asked = np.where(turning, commands.thrust_frac, 0.0)
        s.thrust_frac = np.where(turning, s.thrust_frac + self._motor_blend * (asked - s.thrust_frac), 0.0)

        blend = STEP_S / _THRUST_NOISE_CORRELATION_S
        draw = self._rng.standard_normal(s.thrust_frac.shape[0])
        self._noise_state += -blend * self._noise_state + math.sqrt(2.0 * blend) * draw
        lift = s.thrust_frac * self._accel_per_thrust * (1.0 + self._thrust_noise * self._noise_state)
        acceleration = -lift[:, None] * rotation.body_down(s.attitude) - self._drag_1_s * s.velocity_ned_m_s
        acceleration[:, 2] += GRAVITY_M_S2
        if self._has_gust:
            blend = STEP_S / _GUST_CORRELATION_S
            draw2 = self._rng.standard_normal(self._gust_state.shape)
            self._gust_state += -blend * self._gust_state + math.sqrt(2.0 * blend) * draw2
            acceleration[:, :2] += self._gust * self._gust_state

        velocity = s.velocity_ned_m_s + STEP_S * acceleration
        position = s.position_ned_m + STEP_S * velocity
        contact = position[:, 2] >= 0.0
        position[:, 2] = np.where(contact, 0.0, position[:, 2])
        # Feet grip: on the ground nothing slides, and the start of a climb is vertical.
        s.velocity_ned_m_s = velocity * ~contact[:, None]
        held = contact & s.on_ground
        s.position_ned_m = np.where(held[:, None], s.position_ned_m, position)
        s.acceleration_ned_m_s2 = acceleration * ~contact[:, None]
        s.on_ground = contact
