"""Rigid vehicles that fly what an autopilot asks: profiles as data, commands in, true states out. Seeded.

The inner loops of PX4 are not computed; their measured responses are (`physics.py`). A weak loop additionally has a
gain below one and a constant tilt bias. Frames: NED world, FRD body, ground at z = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.physics import frames, kernels
from sitl.physics import step as physics
from sitl.physics.frames import Array
from sitl.physics.step import GRAVITY_M_S2, STEP_S

__all__ = ["GRAVITY_M_S2", "STEP_S", "Commands", "VehicleProfile", "VehicleStates", "Vehicles", "second_order_step"]

# PX4's cascade for the heading, fitted to its measured steps of 30, 90 and 170 deg; scaled by yaw_wn_rad_s / 3.
_YAW_DELAY_S, _YAW_P_1_S, _YAW_RATE_P_1_S, _YAW_RATE_I_1_S2 = 0.024, 2.857, 3.044, 2.51
_YAW_FILTER_S, _YAW_DRAG_1_S, _YAW_TORQUE_RAD_S2, _YAW_WN_RAD_S = 0.156, 1.243, 7.72, 3.0
_RATE_LAG_S = 0.03
_BLOCK = 64  # random numbers are drawn for so many steps at once
_MOTORS = 4
# Where PX4's motors 1 to 4 of a quadrotor X sit: forward and to the right, in units of arm / sqrt(2).
_MOTOR_PLACE = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
_LARGEST_OFFSET_RAD = 0.15
_UNCONTROLLED = 0.3  # of the torque of a dead motor: the rest is what the opposite motor gives back
_DEAD_BELOW = 0.1


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """What distinguishes one kind of vehicle from another; the defaults are PX4's SIH quadrotor as measured.

    Attributes:
        mass_kg, inertia_kg_m2, arm_m: what a failing motor does to the attitude.
        hover_thrust_frac: normalised thrust that carries the weight.
        thrust_curve_frac: PX4's THR_MDL_FAC, 0 for a linear thrust, 1 for a quadratic one.
        attitude_delay_s, attitude_wn_rad_s, attitude_zeta: response of roll and pitch.
        attitude_integral_s: time in which the attitude loop removes a constant torque; 0 for never.
        drag_1_s: linear drag over mass [1/s].
        static_gain: tilt reached over tilt asked.
        tilt_bias_deg: largest constant tilt error per axis; the actual one is drawn from the seed.
        yaw_wn_rad_s: quickness of the heading; 3 is as measured, all of its cascade scales with it.
        thrust_delay_s, motor_lag_s: dead time and time constant of the thrust.
        thrust_noise_frac: standard deviation of the relative thrust error.
        gust_std_m_s2: standard deviation of the acceleration by gusts, per horizontal axis.
        max_tilt_rate_deg_s, max_yaw_rate_deg_s: limits of the rates (MC_ROLLRATE_MAX, MC_YAWRATE_MAX).
        rate_switch_s: dead time before body rates are followed after attitudes.
    """

    mass_kg: float = 1.0
    hover_thrust_frac: float = 0.49
    attitude_delay_s: float = 0.04
    attitude_wn_rad_s: float = 11.0
    attitude_zeta: float = 0.6
    drag_1_s: float = 1.0
    static_gain: float = 1.0
    tilt_bias_deg: float = 0.0
    yaw_wn_rad_s: float = 3.0
    thrust_delay_s: float = 0.012
    motor_lag_s: float = 0.05
    thrust_noise_frac: float = 0.0
    gust_std_m_s2: float = 0.0
    max_tilt_rate_deg_s: float = 220.0
    max_yaw_rate_deg_s: float = 200.0
    inertia_kg_m2: tuple[float, float, float] = (0.025, 0.025, 0.03)
    arm_m: float = 0.2
    thrust_curve_frac: float = 0.0
    attitude_integral_s: float = 0.5
    rate_switch_s: float = 0.26

    def lift_share(self, thrust_frac: float) -> float:
        """Share of the largest lift at a normalised thrust."""
        return (1.0 - self.thrust_curve_frac) * thrust_frac + self.thrust_curve_frac * thrust_frac * thrust_frac


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
            attitude=frames.yaw_quaternion(yaw_rad),
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


@dataclass(frozen=True, slots=True)
class VehicleStates:
    """Truth, one row per vehicle: NED [m, m/s], tilt vector and heading [rad], their rates, thrust [-].

    All of them are windows on one matrix and change when time goes on: copy what has to be kept, write in place.
    """

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
    motors_dead: NDArray[np.bool_]


class Vehicles:
    """Physics of several vehicles, advanced 4 ms at a time.

    Args:
        profiles: one per vehicle.
        position_ned_m: (n, 3) start. yaw_rad: (n,) headings.
        seed: of noise, gusts and biases.
        uses_numba: the compiled loop, or numpy; by default the loop where numba is installed.
    """

    def __init__(
        self,
        profiles: list[VehicleProfile],
        position_ned_m: Array,
        yaw_rad: Array,
        *,
        seed: int,
        uses_numba: bool = kernels.HAS_NUMBA,
    ) -> None:
        n = len(profiles)
        self.profiles = list(profiles)
        self._step = kernels.step if uses_numba else physics.step
        self._rng = np.random.default_rng([seed, 1])
        self._constants = _constants(profiles)
        largest_rad = np.radians([p.tilt_bias_deg for p in profiles])[:, None]
        self._constants[:, physics.BIAS] = largest_rad * self._rng.uniform(-1.0, 1.0, (n, 2))
        self._health = np.zeros((n, physics.HEALTHS))
        self._health[:, : physics.LIFT_CAP + 1] = 1.0
        self.motor_effectiveness = np.ones((n, _MOTORS))
        self._counts = np.zeros((n, physics.COUNTS), dtype=np.int64)
        for column, seconds in (
            (physics.TILT_DELAY, [p.attitude_delay_s for p in profiles]),
            (physics.YAW_DELAY, [_YAW_DELAY_S * _YAW_WN_RAD_S / p.yaw_wn_rad_s for p in profiles]),
            (physics.THRUST_DELAY, [p.thrust_delay_s for p in profiles]),
            (physics.SWITCH_STEPS, [p.rate_switch_s for p in profiles]),
        ):
            self._counts[:, column] = np.rint(np.array(seconds) / STEP_S)
        depth = int(self._counts[:, : physics.THRUST_DELAY + 1].max(initial=0)) + 1
        yaw = np.array(yaw_rad, dtype=np.float64)
        attitude = frames.yaw_quaternion(yaw)
        self._attitudes = np.repeat(attitude[None], depth, axis=0)
        self._rates = np.zeros((depth, n, 3))
        self._thrusts = np.zeros((depth, n))
        self._draws = np.zeros((_BLOCK, n, 3))
        self._is_noisy = any(p.thrust_noise_frac > 0.0 or p.gust_std_m_s2 > 0.0 for p in profiles)
        self.air_ned_m_s = np.zeros((n, 3))
        self.push_ned_m_s2 = np.zeros((n, 3))
        self.steps = 0
        self._state = np.zeros((n, physics.STATES))
        self._state[:, physics.POSITION] = position_ned_m
        self._state[:, physics.YAW] = yaw
        self._state[:, physics.ATTITUDE] = attitude
        self.states = VehicleStates(
            position_ned_m=self._state[:, physics.POSITION],
            velocity_ned_m_s=self._state[:, physics.VELOCITY],
            acceleration_ned_m_s2=self._state[:, physics.ACCELERATION],
            tilt_rad=self._state[:, physics.TILT],
            tilt_rate_rad_s=self._state[:, physics.TILT_RATE],
            yaw_rad=self._state[:, physics.YAW],
            yaw_rate_rad_s=self._state[:, physics.YAW_RATE],
            thrust_frac=self._state[:, physics.THRUST],
            attitude=self._state[:, physics.ATTITUDE],
            on_ground=self._state[:, 2] >= 0.0,
            motors_dead=np.zeros(n, dtype=np.bool_),
        )

    @property
    def tilt_bias_rad(self) -> Array:
        """Constant errors (n, 2) about body x and y; may be written."""
        return self._constants[:, physics.BIAS]

    @tilt_bias_rad.setter
    def tilt_bias_rad(self, bias_rad: Array) -> None:
        self._constants[:, physics.BIAS] = bias_rad

    def step(self, commands: Commands) -> None:
        """Advance all vehicles by `STEP_S` under `commands`."""
        slot = self.steps % self._attitudes.shape[0]
        self._attitudes[slot] = commands.attitude
        self._rates[slot] = commands.rate_rad_s
        if self.steps == 0:
            self._thrusts[:] = commands.thrust_frac  # who begins in the air has been commanded before
        self._thrusts[slot] = commands.thrust_frac
        place = self.steps % _BLOCK
        if place == 0 and self._is_noisy:
            self._rng.standard_normal(out=self._draws)
        s = self.states
        self._step(
            self._state,
            self._constants,
            self._health,
            self._counts,
            self._attitudes,
            self._rates,
            slot,
            commands.is_rate,
            self._thrusts,
            commands.motors_on,
            s.on_ground,
            s.motors_dead,
            self.air_ned_m_s,
            self.push_ned_m_s2,
            self._draws[place],
        )
        self.steps += 1

    @property
    def lift_share(self) -> Array:
        """Lift of every vehicle (n,) in units of its weight, since the last step: a window, not a copy."""
        return self._state[:, physics.LIFT]

    def set_motor(self, index: int, motor: int, effectiveness: float) -> None:
        """Let motor 1 to 4 of a vehicle give only a share of its thrust from now on.

        The loop shares the work anew: with motors e_k the lift is the harmonic mean of the e_k, at most what the
        weakest allows with all torques in balance. Until its integral has learnt the missing torque (never, for a weak
        loop) the vehicle leans towards that motor. A dead motor cannot be balanced: the vehicle turns over and falls.
        """
        profile, effective = self.profiles[index], self.motor_effectiveness[index]
        lost = effective[motor - 1] - effectiveness
        effective[motor - 1] = effectiveness
        lever_m = profile.arm_m / math.sqrt(2.0)
        # What a motor lifts on the right pushes the left side down; forward and right are x and y of the body.
        lean = np.array([1.0, -1.0]) * _MOTOR_PLACE[motor - 1][::-1]
        per_lift = lean * profile.mass_kg * lever_m / (_MOTORS * np.array(profile.inertia_kg_m2[:2]))
        health = self._health[index]
        alive = effective[effective >= _DEAD_BELOW]
        has_dead = alive.size < _MOTORS
        health[physics.LIFT_SCALE] = float(effective.mean()) if has_dead else _MOTORS / float((1.0 / alive).sum())
        health[physics.LIFT_CAP] = health[physics.LIFT_SCALE] if has_dead else float(alive.min())
        if effectiveness < _DEAD_BELOW:
            health[physics.TUMBLE] += _UNCONTROLLED * per_lift
        elif not has_dead:
            health[physics.TUMBLE] = 0.0
        offset = lost * GRAVITY_M_S2 * per_lift / profile.attitude_wn_rad_s**2
        limit = _LARGEST_OFFSET_RAD
        self._state[index, physics.TILT_OFFSET] += np.clip(offset, -limit, limit)


def _constants(profiles: list[VehicleProfile]) -> Array:
    """One row of `physics.CONSTANTS` numbers per profile; the biases are filled in by the caller."""
    out = np.zeros((len(profiles), physics.CONSTANTS))
    wn = np.array([p.attitude_wn_rad_s for p in profiles], dtype=np.float64)
    zeta = np.array([p.attitude_zeta for p in profiles], dtype=np.float64)
    for column, entry in enumerate(second_order_step(wn, zeta, STEP_S)):
        out[:, column] = entry
    for row, p in zip(out, profiles, strict=True):
        quick = p.yaw_wn_rad_s / _YAW_WN_RAD_S
        row[physics.GAIN] = p.static_gain
        row[physics.FULL_LIFT] = GRAVITY_M_S2 / p.lift_share(p.hover_thrust_frac)
        row[physics.CURVE] = p.thrust_curve_frac
        row[physics.DRAG] = p.drag_1_s
        row[physics.MOTOR_BLEND] = 1.0 - math.exp(-STEP_S / max(p.motor_lag_s, 1e-6))
        row[physics.THRUST_NOISE_STD] = p.thrust_noise_frac
        row[physics.GUST_STD] = p.gust_std_m_s2
        row[physics.MAX_TILT_RATE] = math.radians(p.max_tilt_rate_deg_s)
        row[physics.MAX_YAW_RATE] = math.radians(p.max_yaw_rate_deg_s)
        row[physics.YAW_P] = _YAW_P_1_S * quick
        row[physics.YAW_RATE_P] = _YAW_RATE_P_1_S * quick
        row[physics.YAW_RATE_I] = _YAW_RATE_I_1_S2 * quick * quick
        row[physics.YAW_BLEND] = 1.0 - math.exp(-STEP_S * quick / _YAW_FILTER_S)
        row[physics.MAX_YAW_TORQUE] = _YAW_TORQUE_RAD_S2 * quick * quick
        row[physics.YAW_DRAG] = _YAW_DRAG_1_S * quick
        row[physics.RATE_BLEND] = 1.0 - math.exp(-STEP_S / _RATE_LAG_S)
        row[physics.OFFSET_KEEP] = math.exp(-STEP_S / p.attitude_integral_s) if p.attitude_integral_s > 0.0 else 1.0
    return out
