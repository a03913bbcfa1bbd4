"""One 4-ms step of all vehicles: what a row of numbers means, and the equations, vectorised in numpy.

The same equations stand as a loop in `kernels.py`, compiled by numba where that is installed (about twenty times faster
for a handful of vehicles); a test holds both to each other. Frames: NED world, FRD body, ground at z = 0.

Roll and pitch: dead time, then the exact transition of a second-order system in the tilt vector, limited in rate.
Heading: PX4's own cascade, fitted to its measured steps: a rate limited to MC_YAWRATE_MAX is asked for in proportion to
the error; a rate loop with integral asks for a torque, which is limited, filtered, and opposed by the air.
Body rates: after a dead time for the switch of controllers the rates follow with a short lag.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl.physics import frames
from sitl.physics.frames import Array

GRAVITY_M_S2 = 9.80665
STEP_S = 0.004  # 250 Hz: the loop of PX4's own simulator, and the resolution of every dead time
THRUST_NOISE_CORRELATION_S = 0.1
GUST_CORRELATION_S = 1.0
CRASH_TILT_COS = 0.5  # who meets the ground tilted by more than 60 deg does not fly again
LARGEST_TUMBLE_RAD_S = 15.0

# Columns of the state matrix (n, STATES): slices for vectors, numbers for scalars.
POSITION, VELOCITY, ACCELERATION = slice(0, 3), slice(3, 6), slice(6, 9)
TILT, TILT_RATE = slice(9, 11), slice(11, 13)
YAW, YAW_RATE, YAW_TORQUE, YAW_INTEGRAL, THRUST = 13, 14, 15, 16, 17
ATTITUDE = slice(18, 22)
THRUST_NOISE = 22
GUST, TILT_OFFSET = slice(23, 25), slice(25, 27)
LIFT = 27  # in units of the weight
STATES = 28

# Columns of the constants (n, CONSTANTS), from the profile.
T00, T01, T10, T11 = 0, 1, 2, 3  # transition of the tilt over one step
GAIN = 4
BIAS = slice(5, 7)
FULL_LIFT, CURVE, DRAG, MOTOR_BLEND = 7, 8, 9, 10  # FULL_LIFT: acceleration at full thrust [m/s^2]
THRUST_NOISE_STD, GUST_STD = 11, 12
MAX_TILT_RATE, MAX_YAW_RATE = 13, 14
YAW_P, YAW_RATE_P, YAW_RATE_I, YAW_BLEND, MAX_YAW_TORQUE, YAW_DRAG = 15, 16, 17, 18, 19, 20
RATE_BLEND, OFFSET_KEEP = 21, 22
CONSTANTS = 23

# Columns of the motors' health (n, HEALTHS): lift left, largest lift left, and the turning that a dead motor causes
# per lift [rad/s^2 per m/s^2] about body x and y.
LIFT_SCALE, LIFT_CAP = 0, 1
TUMBLE = slice(2, 4)
HEALTHS = 4

# Columns of the whole numbers (n, COUNTS): dead times in steps, and for how long body rates have been asked for.
TILT_DELAY, YAW_DELAY, THRUST_DELAY, SWITCH_STEPS, RATE_STEPS = 0, 1, 2, 3, 4
COUNTS = 5

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def step(
    state: Array,
    constants: Array,
    health: Array,
    counts: Ints,
    attitudes: Array,
    rates: Array,
    slot: int,
    is_rate: Bools,
    thrusts: Array,
    motors_on: Bools,
    on_ground: Bools,
    motors_dead: Bools,
    air_ned_m_s: Array,
    push_ned_m_s2: Array,
    draws: Array,
) -> None:
    """Advance `state` in place by `STEP_S`.

    Args:
        state, constants, health, counts: matrices (n, ...), columns as above.
        attitudes, rates, thrusts: rings (depth, n, ...) of what was commanded; the newest is at `slot`.
        is_rate, motors_on: (n,) commands.
        on_ground, motors_dead: (n,), updated.
        air_ned_m_s: (n, 3) velocity of the air. push_ned_m_s2: (n, 3) any other acceleration.
        draws: (n, 3) standard normal numbers: thrust, two gusts.
    """
    rows = np.arange(state.shape[0])
    depth = attitudes.shape[0]
    yaw, tilt, tilt_rate = state[:, YAW], state[:, TILT], state[:, TILT_RATE]
    asked = attitudes[(slot - counts[:, TILT_DELAY]) % depth, rows]
    down = frames.body_down(asked)
    # The direction of the thrust has priority over the heading, as in PX4: the asked direction is looked at from the
    # heading that the vehicle really has.
    cos_yaw, sin_yaw = np.cos(yaw), np.sin(yaw)
    seen = np.stack(
        [cos_yaw * down[:, 0] + sin_yaw * down[:, 1], -sin_yaw * down[:, 0] + cos_yaw * down[:, 1], down[:, 2]], axis=-1
    )
    state[:, TILT_OFFSET] *= constants[:, OFFSET_KEEP, None]
    goal = constants[:, GAIN, None] * frames.tilt_from_down(seen) + constants[:, BIAS] + state[:, TILT_OFFSET]
    error = tilt - goal
    tilt_limit = constants[:, MAX_TILT_RATE, None]
    moved = goal + constants[:, T00, None] * error + constants[:, T01, None] * tilt_rate - tilt
    new_tilt = tilt + np.clip(moved, -STEP_S * tilt_limit, STEP_S * tilt_limit)
    turned = constants[:, T10, None] * error + constants[:, T11, None] * tilt_rate
    new_tilt_rate = np.clip(turned, -tilt_limit, tilt_limit)

    yaw_goal = frames.heading(attitudes[(slot - counts[:, YAW_DELAY]) % depth, rows])
    yaw_limit = constants[:, MAX_YAW_RATE]
    rate_goal = np.clip(constants[:, YAW_P] * frames.wrap(yaw_goal - yaw), -yaw_limit, yaw_limit)
    rate_error = rate_goal - state[:, YAW_RATE]
    torque = constants[:, YAW_RATE_P] * rate_error + state[:, YAW_INTEGRAL]
    torque_limit = constants[:, MAX_YAW_TORQUE]
    grows = np.abs(torque) < torque_limit
    integral = state[:, YAW_INTEGRAL] + np.where(grows, STEP_S * constants[:, YAW_RATE_I] * rate_error, 0.0)
    limited = np.clip(torque, -torque_limit, torque_limit)
    filtered = state[:, YAW_TORQUE] + constants[:, YAW_BLEND] * (limited - state[:, YAW_TORQUE])
    new_yaw_rate = state[:, YAW_RATE] + STEP_S * (filtered - constants[:, YAW_DRAG] * state[:, YAW_RATE])
    new_yaw = yaw + STEP_S * new_yaw_rate

    heard = thrusts[(slot - counts[:, THRUST_DELAY]) % depth, rows]
    lift = _lift(state, constants, health, heard, motors_on & ~motors_dead, draws)
    tumbles = (health[:, TUMBLE] != 0.0).any(axis=1)
    counts[:, RATE_STEPS] = np.where(is_rate, counts[:, RATE_STEPS] + 1, 0)
    by_rate = (is_rate & (counts[:, RATE_STEPS] > counts[:, SWITCH_STEPS])) | tumbles
    if by_rate.any():
        wanted = rates[(slot - counts[:, TILT_DELAY]) % depth, rows]
        blend = constants[:, RATE_BLEND, None]
        free_tilt_rate = tilt_rate + blend * (wanted[:, :2] - tilt_rate)
        fallen = np.clip(
            tilt_rate + STEP_S * lift[:, None] * health[:, TUMBLE], -LARGEST_TUMBLE_RAD_S, LARGEST_TUMBLE_RAD_S
        )
        free_tilt_rate = np.where(tumbles[:, None], fallen, free_tilt_rate)
        free_yaw_rate = state[:, YAW_RATE] + blend[:, 0] * (wanted[:, 2] - state[:, YAW_RATE])
        free_yaw_rate = np.where(tumbles, state[:, YAW_RATE], free_yaw_rate)
        q = _turn(state[:, ATTITUDE], free_tilt_rate, free_yaw_rate)
        free_yaw = frames.heading(q)
        new_tilt = np.where(by_rate[:, None], _tilt_of(q, free_yaw), new_tilt)
        new_tilt_rate = np.where(by_rate[:, None], free_tilt_rate, new_tilt_rate)
        new_yaw = np.where(by_rate, free_yaw, new_yaw)
        new_yaw_rate = np.where(by_rate, free_yaw_rate, new_yaw_rate)
        filtered = np.where(by_rate, 0.0, filtered)
        integral = np.where(by_rate, 0.0, integral)

    # A vehicle on its feet does not turn, whatever is asked.
    flies = ~on_ground
    state[:, TILT] = new_tilt * flies[:, None]
    state[:, TILT_RATE] = new_tilt_rate * flies[:, None]
    state[:, YAW] = np.where(flies, frames.wrap(new_yaw), yaw)
    state[:, YAW_RATE] = new_yaw_rate * flies
    state[:, YAW_TORQUE] = filtered * flies
    state[:, YAW_INTEGRAL] = integral * flies
    state[:, ATTITUDE] = frames.from_yaw_and_tilt(state[:, YAW], state[:, TILT])
    _move(state, constants, lift, on_ground, motors_dead, air_ned_m_s, push_ned_m_s2, draws)


def _lift(state: Array, constants: Array, health: Array, thrust_frac: Array, turning: Bools, draws: Array) -> Array:
    asked = np.where(turning, thrust_frac, 0.0)
    lagged = state[:, THRUST] + constants[:, MOTOR_BLEND] * (asked - state[:, THRUST])
    thrust = state[:, THRUST] = np.where(turning, lagged, 0.0)
    blend = STEP_S / THRUST_NOISE_CORRELATION_S
    noise = state[:, THRUST_NOISE] = (1.0 - blend) * state[:, THRUST_NOISE] + math.sqrt(2.0 * blend) * draws[:, 0]
    curve = constants[:, CURVE]
    share = np.minimum(health[:, LIFT_SCALE] * ((1.0 - curve) * thrust + curve * thrust * thrust), health[:, LIFT_CAP])
    lift = share * constants[:, FULL_LIFT] * (1.0 + constants[:, THRUST_NOISE_STD] * noise)
    state[:, LIFT] = lift / GRAVITY_M_S2
    return np.asarray(lift)


def _move(
    state: Array,
    constants: Array,
    lift: Array,
    on_ground: Bools,
    motors_dead: Bools,
    air_ned_m_s: Array,
    push_ned_m_s2: Array,
    draws: Array,
) -> None:
    blend = STEP_S / GUST_CORRELATION_S
    state[:, GUST] = (1.0 - blend) * state[:, GUST] + math.sqrt(2.0 * blend) * draws[:, 1:]
    down = frames.body_down(state[:, ATTITUDE])
    drag = constants[:, DRAG, None] * (air_ned_m_s - state[:, VELOCITY])
    acceleration = -lift[:, None] * down + drag + push_ned_m_s2
    acceleration[:, 2] += GRAVITY_M_S2
    acceleration[:, :2] += constants[:, GUST_STD, None] * state[:, GUST]
    velocity = state[:, VELOCITY] + STEP_S * acceleration
    position = state[:, POSITION] + STEP_S * velocity
    contact = position[:, 2] >= 0.0
    position[:, 2] = np.where(contact, 0.0, position[:, 2])
    # Feet grip: on the ground nothing slides, and the start of a climb is vertical.
    held = contact & on_ground
    motors_dead |= contact & ~on_ground & (down[:, 2] < CRASH_TILT_COS)
    state[:, POSITION] = np.where(held[:, None], state[:, POSITION], position)
    state[:, VELOCITY] = np.where(contact[:, None], 0.0, velocity)
    state[:, ACCELERATION] = np.where(contact[:, None], 0.0, acceleration)
    on_ground[:] = contact


def _turn(q: Array, tilt_rate: Array, yaw_rate: Array) -> Array:
    """Attitudes (n, 4) after one step of body rates."""
    half = 0.5 * STEP_S
    spin = np.stack([np.ones_like(yaw_rate), half * tilt_rate[:, 0], half * tilt_rate[:, 1], half * yaw_rate], axis=-1)
    turned = frames.multiply(q, spin)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _tilt_of(q: Array, yaw: Array) -> Array:
    """What is left of attitudes (n, 4) without their heading, as rotation vectors (n, 2) [rad]."""
    cos_half, sin_half = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    w = cos_half * q[:, 0] + sin_half * q[:, 3]
    x = cos_half * q[:, 1] + sin_half * q[:, 2]
    y = cos_half * q[:, 2] - sin_half * q[:, 1]
    sine = np.hypot(x, y)
    scale = np.where(sine > 1e-9, 2.0 * np.arctan2(sine, w) / np.maximum(sine, 1e-9), 2.0)
    return np.stack([scale * x, scale * y], axis=-1)
