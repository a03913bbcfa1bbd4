"""Rigid vehicles that fly the commands of an autopilot: commands in, true states out.

Vehicles differ in their `VehicleProfile`. The inner loops of PX4 are not computed. Their measured
responses are computed instead (`step.py`). A weak loop additionally has a gain below one and a
constant tilt bias. All random numbers are seeded. Frames: NED world, FRD body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.physics import frames
from sitl.physics import step as physics
from sitl.physics.frames import Array
from sitl.physics.jit import Records, records
from sitl.physics.random_streams import Stream
from sitl.physics.step import GRAVITY_M_S2, STEP_S, Ground

__all__ = [
    "GRAVITY_M_S2",
    "STEP_S",
    "Commands",
    "VehicleProfile",
    "VehicleStates",
    "Vehicles",
    "second_order_step",
]

# PX4's cascade for the heading, fitted to its measured steps of 30, 90 and 170 deg. The cascade of
# a vehicle is this one, made quicker by yaw_wn_rad_s / _YAW_WN_RAD_S.
_YAW_DELAY_S = 0.024
_YAW_P_1_S = 2.857
_YAW_RATE_P_1_S = 3.044
_YAW_RATE_I_1_S2 = 2.51
_YAW_FILTER_S = 0.156
_YAW_DRAG_1_S = 1.243
_YAW_TORQUE_RAD_S2 = 7.72
_YAW_WN_RAD_S = 3.0

_RATE_LAG_S = 0.03  # time constant with which body rates follow their setpoint
_TRANSITION = ("tilt_by_tilt", "tilt_by_rate", "rate_by_tilt", "rate_by_rate")  # names in RESPONSE
_BLOCK = 64  # random numbers are drawn for this many steps at a time

# Positions of PX4's motors 1 to 4 of a quadrotor X, forward and to the right, in units of
# arm / sqrt(2).
_MOTORS = 4
_MOTOR_POSITION = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
_DEAD_BELOW = 0.1  # effectiveness below which a motor counts as dead
# Share of a dead motor's missing torque that remains; the opposite motor balances the rest.
_UNBALANCED_SHARE = 0.3
_LARGEST_OFFSET_RAD = 0.15  # largest offset of the tilt when a motor becomes weak

_LONGEST_FILTER_S = 0.2  # largest delay of PX4's filter of attitude setpoints
# Delay of that filter times its natural frequency: 2 by theory, and one step of PX4's loop.
_FILTER_RAD = 2.2

# The damping with gains that differ from those of the measurement.
_MIN_RATIO = 0.1  # limits of the ratio of the gains
_MAX_RATIO = 10.0
_LAG_POWER = 0.9  # the lag is inversely proportional to this power of the ratio
_MIN_ZETA = 0.05


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """Physical constants of a kind of vehicle; by default PX4's SIH quadrotor as measured."""

    mass_kg: float = 1.0
    hover_thrust_frac: float = 0.49  # normalised thrust that carries the weight
    attitude_delay_s: float = 0.04  # dead time of roll and pitch
    attitude_wn_rad_s: float = 11.0  # natural frequency of roll and pitch
    attitude_zeta: float = 0.6  # damping of roll and pitch
    drag_1_s: float = 1.0  # linear drag over mass
    static_gain: float = 1.0  # ratio of the tilt reached to the tilt commanded
    # Largest constant tilt error per axis. The actual error is drawn from the seed.
    tilt_bias_deg: float = 0.0
    # Speed of the heading response; the whole cascade scales with it. 3 was measured.
    yaw_wn_rad_s: float = 3.0
    thrust_delay_s: float = 0.012  # dead time of the thrust
    motor_lag_s: float = 0.05  # time constant of the thrust
    thrust_noise_frac: float = 0.0  # standard deviation of the relative thrust error
    # Standard deviation per horizontal axis of the acceleration by the vehicle's own gusts: wind.py
    gust_std_m_s2: float = 0.0
    max_tilt_rate_deg_s: float = 220.0  # MC_ROLLRATE_MAX, MC_PITCHRATE_MAX
    max_yaw_rate_deg_s: float = 200.0  # MC_YAWRATE_MAX
    # The effect of a failing motor follows from inertia and arm.
    inertia_kg_m2: tuple[float, float, float] = (0.025, 0.025, 0.03)
    arm_m: float = 0.2
    # PX4's THR_MDL_FAC: 0 for a lift linear in the thrust command, 1 for a quadratic one.
    thrust_curve_frac: float = 0.0
    # Time in which the attitude loop removes a constant torque; 0: never.
    attitude_integral_s: float = 0.5
    rate_switch_s: float = 0.26  # dead time of the switch from attitudes to body rates
    # Parameters with which the response above was measured.
    attitude_p_1_s: tuple[float, float] = (6.5, 6.5)  # MC_ROLL_P and MC_PITCH_P
    setpoint_filter_rad_s: float = 0.0  # MC_REF_W_N; 0: PX4 has no such filter

    def damping(self, axis: int, attitude_p_1_s: float) -> float:
        """Return the damping with a gain that differs from that of the measurement.

        The lag behind a tilt that moves at a constant rate is delay + 2 zeta / wn. It varies with
        a power of the gain, which was measured on SIH. Delay and natural frequency do not change,
        since they come from PX4's rate control and the motors.

        Args:
            axis: body x (0) or y (1).
            attitude_p_1_s: gain of the attitude loop about that axis.
        """
        measured_p_1_s = self.attitude_p_1_s[axis]
        if attitude_p_1_s == measured_p_1_s:
            return self.attitude_zeta

        ratio = min(_MAX_RATIO, max(_MIN_RATIO, attitude_p_1_s / measured_p_1_s))
        measured_lag_s = self.attitude_delay_s + 2.0 * self.attitude_zeta / self.attitude_wn_rad_s
        lag_s = measured_lag_s / float(ratio**_LAG_POWER)
        return max(_MIN_ZETA, 0.5 * self.attitude_wn_rad_s * (lag_s - self.attitude_delay_s))

    def filter_delay_s(self, setpoint_filter_rad_s: float) -> float:
        """Return the delay that a filter of setpoints adds to that of the measurement's filter.

        The filter is of second order and critically damped. 0 rad/s stands for no filter.
        """
        return _filter_s(setpoint_filter_rad_s) - _filter_s(self.setpoint_filter_rad_s)

    @property
    def yaw_delay_s(self) -> float:
        """Dead time of the heading."""
        return _YAW_DELAY_S * _YAW_WN_RAD_S / self.yaw_wn_rad_s

    def lift_share(self, thrust_frac: float) -> float:
        """Return the share of the largest lift at a normalised thrust."""
        curve = self.thrust_curve_frac
        return (1.0 - curve) * thrust_frac + curve * thrust_frac * thrust_frac


def _filter_s(natural_frequency_rad_s: float) -> float:
    if natural_frequency_rad_s <= 0.0:
        return 0.0
    return min(_LONGEST_FILTER_S, _FILTER_RAD / natural_frequency_rad_s)


@dataclass(slots=True)
class Commands:
    """Commands of the autopilots to their vehicles: one row per vehicle, written in place."""

    attitude: Array  # (n, 4) quaternion NED <- FRD
    rate_rad_s: Array  # (n, 3) body rates, used where `is_rate`
    is_rate: NDArray[np.bool_]  # (n,) whether body rates are commanded instead of an attitude
    thrust_frac: Array  # (n,) collective thrust in [0, 1]
    motors_on: NDArray[np.bool_]  # (n,) where False, the thrust is zero at once

    @classmethod
    def level(cls, yaw_rad: Array) -> Commands:
        """Return commands with motors off and a level attitude at each heading."""
        n = yaw_rad.shape[0]
        return cls(
            attitude=frames.yaw_quaternion(yaw_rad),
            rate_rad_s=np.zeros((n, 3)),
            is_rate=np.zeros(n, dtype=np.bool_),
            thrust_frac=np.zeros(n),
            motors_on=np.zeros(n, dtype=np.bool_),
        )


def second_order_step(
    wn_rad_s: Array, zeta: Array, dt_s: float
) -> tuple[Array, Array, Array, Array]:
    """Return the exact transition of x'' = -wn^2 x - 2 zeta wn x' over a step, for any damping.

    The Taylor series of the matrix exponential converges to rounding error within the 19 terms
    used, since wn dt is far below one.

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
    """True states, one row per vehicle.

    All fields are views of the records of the physics, and each step changes their values. Copy
    values to store them. Write values in place.
    """

    position_ned_m: Array  # (n, 3)
    velocity_ned_m_s: Array  # (n, 3)
    acceleration_ned_m_s2: Array  # (n, 3)
    tilt_rad: Array  # (n, 2) rotation vector about body x and y
    tilt_rate_rad_s: Array  # (n, 2)
    yaw_rad: Array  # (n,)
    yaw_rate_rad_s: Array  # (n,)
    thrust_frac: Array  # (n,) thrust after the lag of the motors
    attitude: Array  # (n, 4) NED <- FRD, wxyz
    on_ground: NDArray[np.bool_]  # (n,)
    motors_dead: NDArray[np.bool_]  # (n,)


class Vehicles:
    """Physics of several vehicles, advanced 4 ms at a time.

    Args:
        profiles: profile of each vehicle.
        position_ned_m: start positions (n, 3).
        yaw_rad: headings at the start (n,).
        seed: seed of noise and biases.
        ground: the ground below them; None: level, at height 0.
    """

    def __init__(
        self,
        profiles: list[VehicleProfile],
        position_ned_m: Array,
        yaw_rad: Array,
        *,
        seed: int,
        ground: Ground | None = None,
    ) -> None:
        n = len(profiles)
        if ground is None:
            ground = Ground(down=0.0, spots=np.zeros((0, 3)), radius=0.0)
        self.profiles = list(profiles)
        self.motor_effectiveness = np.ones((n, _MOTORS))
        self.air_ned_m_s = np.zeros((n, 3))
        self.push_ned_m_s2 = np.zeros((n, 3))
        self.steps = 0

        self._rng = np.random.default_rng([seed, Stream.VEHICLES])
        self._draws = np.zeros((_BLOCK, n, 3))
        self._is_noisy = any(p.thrust_noise_frac > 0.0 for p in profiles)

        self._response = _response(profiles)
        largest_bias_rad = np.radians([p.tilt_bias_deg for p in profiles])[:, None]
        self._response["bias"] = largest_bias_rad * self._rng.uniform(-1.0, 1.0, (n, 2))

        # The ring of commands is as deep as the longest dead time that any parameters cause.
        yaw = np.array(yaw_rad, dtype=np.float64)
        attitude = frames.yaw_quaternion(yaw)
        longest_delay = max(
            self._response[name].max(initial=0)
            for name in ("tilt_delay", "yaw_delay", "thrust_delay")
        )
        depth = int(longest_delay) + 1 + round(_LONGEST_FILTER_S / STEP_S)
        self._commanded = records((depth, n), physics.COMMAND)
        self._commanded["attitude"] = attitude
        self._ring = [
            self._commanded[name] for name in ("attitude", "rate", "thrust", "is_rate", "motors_on")
        ]

        self.motion = records(n, physics.MOTION)
        self.motion["position"] = position_ned_m
        self.motion["yaw"] = yaw
        self.motion["attitude"] = attitude
        self.motion["lift_scale"] = 1.0
        self.motion["lift_cap"] = 1.0
        self._ground = ground
        self.motion["on_ground"] = [self.height_m(index) <= 0.0 for index in range(n)]
        self.states = VehicleStates(
            position_ned_m=self.motion["position"],
            velocity_ned_m_s=self.motion["velocity"],
            acceleration_ned_m_s2=self.motion["acceleration"],
            tilt_rad=self.motion["tilt"],
            tilt_rate_rad_s=self.motion["tilt_rate"],
            yaw_rad=self.motion["yaw"],
            yaw_rate_rad_s=self.motion["yaw_rate"],
            thrust_frac=self.motion["thrust"],
            attitude=self.motion["attitude"],
            on_ground=self.motion["on_ground"],
            motors_dead=self.motion["motors_dead"],
        )

    @property
    def tilt_bias_rad(self) -> Array:
        """Constant tilt errors (n, 2) about body x and y; callers may write them."""
        return self._response["bias"]

    @tilt_bias_rad.setter
    def tilt_bias_rad(self, bias_rad: Array) -> None:
        self._response["bias"] = bias_rad

    def step(self, commands: Commands) -> None:
        """Advance all vehicles by `STEP_S` under `commands`."""
        newest = self.steps % self._commanded.shape[0]
        attitudes, rates, thrusts, is_rate, motors_on = self._ring
        attitudes[newest] = commands.attitude
        rates[newest] = commands.rate_rad_s
        thrusts[newest] = commands.thrust_frac
        is_rate[newest] = commands.is_rate
        motors_on[newest] = commands.motors_on
        if self.steps == 0:
            # A vehicle that starts in the air has received its thrust command before the start.
            thrusts[:] = commands.thrust_frac

        block = self.steps % _BLOCK
        if block == 0 and self._is_noisy:
            self._rng.standard_normal(out=self._draws)

        physics.step(
            self.motion,
            self._response,
            self._commanded,
            newest,
            self.air_ned_m_s,
            self.push_ned_m_s2,
            self._draws[block],
            self._ground,
        )
        self.steps += 1

    def height_m(self, index: int) -> float:
        """Return the height of a vehicle above the ground below it."""
        position_ned_m = self.motion["position"][index]
        return physics.ground_below(position_ned_m, self._ground) - float(position_ned_m[2])

    def set_attitude_control(
        self, index: int, attitude_p_1_s: tuple[float, float], setpoint_filter_rad_s: float
    ) -> None:
        """Give a vehicle the response that it has with other parameters of PX4.

        Args:
            index: index of the vehicle.
            attitude_p_1_s: gains of roll and pitch.
            setpoint_filter_rad_s: natural frequency of the filter of setpoints; 0: no filter.
        """
        profile = self.profiles[index]
        response = self._response[index]

        wn = np.full(2, profile.attitude_wn_rad_s)
        zeta = np.array([profile.damping(axis, gain) for axis, gain in enumerate(attitude_p_1_s)])
        transition = second_order_step(wn, zeta, STEP_S)
        for name, entry in zip(_TRANSITION, transition, strict=True):
            response[name] = entry

        filter_s = profile.filter_delay_s(setpoint_filter_rad_s)
        response["tilt_delay"] = round(max(0.0, profile.attitude_delay_s + filter_s) / STEP_S)
        response["yaw_delay"] = round(max(0.0, profile.yaw_delay_s + filter_s) / STEP_S)

    @property
    def lift_share(self) -> Array:
        """Lift of every vehicle (n,) in units of its weight: a view, not a copy."""
        return self.motion["lift_share"]

    def set_motor(self, index: int, motor: int, effectiveness: float) -> None:
        """Set the share of its thrust that motor 1 to 4 of a vehicle gives.

        PX4's loop balances weak motors. With shares e_k the lift is the harmonic mean of the e_k,
        up to the lift at which the weakest motor is at its limit while all torques are balanced.
        The vehicle tilts towards a weakened motor until the integral of the loop has removed the
        missing torque, which a weak loop never does. A dead motor cannot be balanced, so the
        vehicle turns over and falls.
        """
        profile = self.profiles[index]
        motion = self.motion[index]

        shares = self.motor_effectiveness[index]
        lost_share = shares[motor - 1] - effectiveness
        shares[motor - 1] = effectiveness

        # Lift.
        alive = shares[shares >= _DEAD_BELOW]
        has_dead = alive.size < _MOTORS
        if has_dead:
            motion["lift_scale"] = float(shares.mean())
            motion["lift_cap"] = motion["lift_scale"]
        else:
            motion["lift_scale"] = _MOTORS / float((1.0 / alive).sum())
            motion["lift_cap"] = float(alive.min())

        # Torque: a missing lift on the right turns the vehicle to the right (positive about x), a
        # missing lift in front turns its nose down (negative about y).
        lever_m = profile.arm_m / math.sqrt(2.0)
        forward, right = _MOTOR_POSITION[motor - 1]
        turn = np.array([right, -forward])
        roll_inertia_kg_m2, pitch_inertia_kg_m2, _ = profile.inertia_kg_m2
        inertia_kg_m2 = np.array([roll_inertia_kg_m2, pitch_inertia_kg_m2])
        per_lift = turn * profile.mass_kg * lever_m / (_MOTORS * inertia_kg_m2)

        if effectiveness < _DEAD_BELOW:
            motion["tumble"] += _UNBALANCED_SHARE * per_lift
        elif not has_dead:
            motion["tumble"] = 0.0

        offset_rad = lost_share * GRAVITY_M_S2 * per_lift / profile.attitude_wn_rad_s**2
        motion["tilt_offset"] += np.clip(offset_rad, -_LARGEST_OFFSET_RAD, _LARGEST_OFFSET_RAD)


def _response(profiles: list[VehicleProfile]) -> Records:
    """Return one record RESPONSE per profile; the caller adds the biases."""
    responses = records(len(profiles), physics.RESPONSE)

    wn = np.array([p.attitude_wn_rad_s for p in profiles], dtype=np.float64)
    zeta = np.array([p.attitude_zeta for p in profiles], dtype=np.float64)
    transition = second_order_step(wn, zeta, STEP_S)
    for name, entry in zip(_TRANSITION, transition, strict=True):
        responses[name] = entry[:, None]

    for r, p in zip(responses, profiles, strict=True):
        r["gain"] = p.static_gain
        r["full_lift"] = GRAVITY_M_S2 / p.lift_share(p.hover_thrust_frac)
        r["curve"] = p.thrust_curve_frac
        r["drag"] = p.drag_1_s
        r["motor_blend"] = 1.0 - math.exp(-STEP_S / max(p.motor_lag_s, 1e-6))
        r["thrust_noise_std"] = p.thrust_noise_frac
        r["max_tilt_rate"] = math.radians(p.max_tilt_rate_deg_s)
        r["max_yaw_rate"] = math.radians(p.max_yaw_rate_deg_s)

        quickness = p.yaw_wn_rad_s / _YAW_WN_RAD_S
        r["yaw_p"] = _YAW_P_1_S * quickness
        r["yaw_rate_p"] = _YAW_RATE_P_1_S * quickness
        r["yaw_rate_i"] = _YAW_RATE_I_1_S2 * quickness * quickness
        r["yaw_blend"] = 1.0 - math.exp(-STEP_S * quickness / _YAW_FILTER_S)
        r["max_yaw_torque"] = _YAW_TORQUE_RAD_S2 * quickness * quickness
        r["yaw_drag"] = _YAW_DRAG_1_S * quickness

        r["rate_blend"] = 1.0 - math.exp(-STEP_S / _RATE_LAG_S)
        r["offset_keep"] = 1.0
        if p.attitude_integral_s > 0.0:
            r["offset_keep"] = math.exp(-STEP_S / p.attitude_integral_s)

        r["tilt_delay"] = round(p.attitude_delay_s / STEP_S)
        r["rate_delay"] = r["tilt_delay"]
        r["yaw_delay"] = round(p.yaw_delay_s / STEP_S)
        r["thrust_delay"] = round(p.thrust_delay_s / STEP_S)
        r["switch_steps"] = round(p.rate_switch_s / STEP_S)
    return responses
