"""The physics and the estimator's errors as loops that numba compiles; without numba the numpy form is used.

Each loop says what its vectorised twin in `physics.py`, `world.py` or `errors.py` says, column by column; tests hold
them together. Compiled code is kept beside this file, so that only the first start on a machine compiles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

from sitl.physics.frames import Array
from sitl.physics.step import (
    CRASH_TILT_COS,
    CURVE,
    DRAG,
    FULL_LIFT,
    GAIN,
    GRAVITY_M_S2,
    GUST_CORRELATION_S,
    GUST_STD,
    LARGEST_TUMBLE_RAD_S,
    LIFT,
    LIFT_CAP,
    LIFT_SCALE,
    MAX_TILT_RATE,
    MAX_YAW_RATE,
    MAX_YAW_TORQUE,
    MOTOR_BLEND,
    OFFSET_KEEP,
    RATE_BLEND,
    RATE_STEPS,
    STEP_S,
    SWITCH_STEPS,
    T00,
    T01,
    T10,
    T11,
    THRUST,
    THRUST_DELAY,
    THRUST_NOISE,
    THRUST_NOISE_CORRELATION_S,
    THRUST_NOISE_STD,
    TILT_DELAY,
    YAW,
    YAW_BLEND,
    YAW_DELAY,
    YAW_DRAG,
    YAW_INTEGRAL,
    YAW_P,
    YAW_RATE,
    YAW_RATE_I,
    YAW_RATE_P,
    YAW_TORQUE,
    Bools,
    Ints,
)
from sitl.px4.estimator_errors import (
    BASE,
    BIAS,
    BIAS_GOAL,
    BLEND_S,
    DRIFT_A,
    DRIFT_V,
    DRIFTS,
    FLIES,
    KEEP,
    OFFSET,
    POSITION,
    PULL,
    RATIO,
    STD_P,
    STD_P_GOAL,
    STD_V,
    STD_V_GOAL,
    UNIT_P,
    UNIT_V,
    VELOCITY,
    VISION_YAW,
    YAW_ERROR,
    YAW_MEAN,
    YAW_SHARE,
    YAW_SHARE_GOAL,
    YAW_SMOOTH,
    YAW_STD,
    YAW_UNIT,
)

Loop = TypeVar("Loop", bound=Callable[..., Any])

try:
    from numba import njit

    HAS_NUMBA = True

    def compiled(function: Loop) -> Loop:
        """Compile at the first call, keep the result on disk."""
        return cast(Loop, njit(cache=True)(function))

except ImportError:
    HAS_NUMBA = False

    def compiled(function: Loop) -> Loop:
        """Without numba: as it is."""
        return function


_TWO_PI = 2.0 * math.pi
_ROOT_TWO = math.sqrt(2.0)
_NOISE_BLEND = STEP_S / THRUST_NOISE_CORRELATION_S
_NOISE_SPREAD = math.sqrt(2.0 * _NOISE_BLEND)
_GUST_BLEND = STEP_S / GUST_CORRELATION_S
_GUST_SPREAD = math.sqrt(2.0 * _GUST_BLEND)


@compiled
def _wrap(angle_rad: float) -> float:
    return math.pi - (math.pi - angle_rad) % _TWO_PI


@compiled
def _within(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))


@compiled
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
    """See :func:`sitl.physics.step.step`."""
    depth = attitudes.shape[0]
    for i in range(state.shape[0]):
        s, c, h = state[i], constants[i], health[i]
        yaw, roll, pitch, p, q, r = s[YAW], s[9], s[10], s[11], s[12], s[YAW_RATE]

        # Roll and pitch.
        a = attitudes[(slot - counts[i, TILT_DELAY]) % depth, i]
        down_n = 2.0 * (a[1] * a[3] + a[0] * a[2])
        down_e = 2.0 * (a[2] * a[3] - a[0] * a[1])
        down_d = 1.0 - 2.0 * (a[1] * a[1] + a[2] * a[2])
        cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
        ahead, right = cos_yaw * down_n + sin_yaw * down_e, -sin_yaw * down_n + cos_yaw * down_e
        horizontal = math.sqrt(ahead * ahead + right * right)
        scale = math.atan2(horizontal, down_d) / horizontal if horizontal > 1e-9 else 1.0
        s[25] *= c[OFFSET_KEEP]
        s[26] *= c[OFFSET_KEEP]
        goal_x = c[GAIN] * (-right * scale) + c[5] + s[25]
        goal_y = c[GAIN] * (ahead * scale) + c[6] + s[26]
        error_x, error_y, limit = roll - goal_x, pitch - goal_y, c[MAX_TILT_RATE]
        new_roll = roll + _within(goal_x + c[T00] * error_x + c[T01] * p - roll, STEP_S * limit)
        new_pitch = pitch + _within(goal_y + c[T00] * error_y + c[T01] * q - pitch, STEP_S * limit)
        new_p = _within(c[T10] * error_x + c[T11] * p, limit)
        new_q = _within(c[T10] * error_y + c[T11] * q, limit)

        # Heading.
        a = attitudes[(slot - counts[i, YAW_DELAY]) % depth, i]
        miss = _wrap(2.0 * math.atan2(a[3], a[0]) - yaw)
        rate_error = _within(c[YAW_P] * miss, c[MAX_YAW_RATE]) - r
        torque = c[YAW_RATE_P] * rate_error + s[YAW_INTEGRAL]
        integral = s[YAW_INTEGRAL]
        if abs(torque) < c[MAX_YAW_TORQUE]:
            integral += STEP_S * c[YAW_RATE_I] * rate_error
        filtered = s[YAW_TORQUE] + c[YAW_BLEND] * (_within(torque, c[MAX_YAW_TORQUE]) - s[YAW_TORQUE])
        new_r = r + STEP_S * (filtered - c[YAW_DRAG] * r)
        new_yaw = yaw + STEP_S * new_r

        # Lift.
        turning = motors_on[i] and not motors_dead[i]
        heard = thrusts[(slot - counts[i, THRUST_DELAY]) % depth, i]
        thrust = s[THRUST] + c[MOTOR_BLEND] * (heard - s[THRUST]) if turning else 0.0
        s[THRUST] = thrust
        s[THRUST_NOISE] = (1.0 - _NOISE_BLEND) * s[THRUST_NOISE] + _NOISE_SPREAD * draws[i, 0]
        share = min(h[LIFT_SCALE] * ((1.0 - c[CURVE]) * thrust + c[CURVE] * thrust * thrust), h[LIFT_CAP])
        lift = share * c[FULL_LIFT] * (1.0 + c[THRUST_NOISE_STD] * s[THRUST_NOISE])
        s[LIFT] = lift / GRAVITY_M_S2

        # Body rates, asked for or suffered.
        tumbles = h[2] != 0.0 or h[3] != 0.0
        counts[i, RATE_STEPS] = counts[i, RATE_STEPS] + 1 if is_rate[i] else 0
        if tumbles or counts[i, RATE_STEPS] > counts[i, SWITCH_STEPS]:
            if tumbles:
                new_p = _within(p + STEP_S * lift * h[2], LARGEST_TUMBLE_RAD_S)
                new_q = _within(q + STEP_S * lift * h[3], LARGEST_TUMBLE_RAD_S)
                new_r = r
            else:
                wanted = rates[(slot - counts[i, TILT_DELAY]) % depth, i]
                new_p = p + c[RATE_BLEND] * (wanted[0] - p)
                new_q = q + c[RATE_BLEND] * (wanted[1] - q)
                new_r = r + c[RATE_BLEND] * (wanted[2] - r)
            hp, hq, hr = 0.5 * STEP_S * new_p, 0.5 * STEP_S * new_q, 0.5 * STEP_S * new_r
            bw, bx, by, bz = s[18], s[19], s[20], s[21]
            w = bw - bx * hp - by * hq - bz * hr
            x = bw * hp + bx + by * hr - bz * hq
            y = bw * hq - bx * hr + by + bz * hp
            z = bw * hr + bx * hq - by * hp + bz
            norm = math.sqrt(w * w + x * x + y * y + z * z)
            w, x, y, z = w / norm, x / norm, y / norm, z / norm
            new_yaw = 2.0 * math.atan2(z, w)
            ch, sh = math.cos(0.5 * new_yaw), math.sin(0.5 * new_yaw)
            tw, tx, ty = ch * w + sh * z, ch * x + sh * y, ch * y - sh * x
            sine = math.sqrt(tx * tx + ty * ty)
            scale = 2.0 * math.atan2(sine, tw) / sine if sine > 1e-9 else 2.0
            new_roll, new_pitch = scale * tx, scale * ty
            filtered = integral = 0.0

        if on_ground[i]:
            new_roll = new_pitch = new_p = new_q = new_r = filtered = integral = 0.0
        else:
            yaw = _wrap(new_yaw)
        s[9], s[10], s[11], s[12] = new_roll, new_pitch, new_p, new_q
        s[YAW], s[YAW_RATE], s[YAW_TORQUE], s[YAW_INTEGRAL] = yaw, new_r, filtered, integral
        angle = math.sqrt(new_roll * new_roll + new_pitch * new_pitch)
        scale = math.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
        w, x, y = math.cos(0.5 * angle), scale * new_roll, scale * new_pitch
        cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
        w, x, y, z = cy * w, cy * x - sy * y, cy * y + sy * x, sy * w
        s[18], s[19], s[20], s[21] = w, x, y, z

        # Motion.
        s[23] = (1.0 - _GUST_BLEND) * s[23] + _GUST_SPREAD * draws[i, 1]
        s[24] = (1.0 - _GUST_BLEND) * s[24] + _GUST_SPREAD * draws[i, 2]
        down_d = 1.0 - 2.0 * (x * x + y * y)
        an = -lift * 2.0 * (x * z + w * y) + c[DRAG] * (air_ned_m_s[i, 0] - s[3]) + push_ned_m_s2[i, 0]
        ae = -lift * 2.0 * (y * z - w * x) + c[DRAG] * (air_ned_m_s[i, 1] - s[4]) + push_ned_m_s2[i, 1]
        ad = -lift * down_d + c[DRAG] * (air_ned_m_s[i, 2] - s[5]) + push_ned_m_s2[i, 2] + GRAVITY_M_S2
        an += c[GUST_STD] * s[23]
        ae += c[GUST_STD] * s[24]
        vn, ve, vd = s[3] + STEP_S * an, s[4] + STEP_S * ae, s[5] + STEP_S * ad
        height = s[2] + STEP_S * vd
        if height >= 0.0:
            if not on_ground[i]:
                s[0] += STEP_S * vn
                s[1] += STEP_S * ve
                s[2] = 0.0
                if down_d < CRASH_TILT_COS:
                    motors_dead[i] = True
            s[3] = s[4] = s[5] = s[6] = s[7] = s[8] = 0.0
            on_ground[i] = True
        else:
            s[0] += STEP_S * vn
            s[1] += STEP_S * ve
            s[2] = height
            s[3], s[4], s[5], s[6], s[7], s[8] = vn, ve, vd, an, ae, ad
            on_ground[i] = False


@compiled
def meet(
    position: Array,
    lift_share: Array,
    on_ground: Bools,
    touched: Bools,
    diameter_m: float,
    half_height_m: float,
    wash_m_s2: float,
    wash_spread: float,
    push: Array,
    found: Ints,
) -> int:
    """See :func:`sitl.physics.contacts.meet`."""
    n = position.shape[0]
    count = 0
    for i in range(n):
        push[i, 0] = push[i, 1] = push[i, 2] = 0.0
    for i in range(n):
        for j in range(i + 1, n):
            if on_ground[i] and on_ground[j]:
                continue
            dn, de = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]
            dd = position[i, 2] - position[j, 2]
            square = dn * dn + de * de
            if square < diameter_m * diameter_m and abs(dd) < half_height_m and not touched[i, j]:
                touched[i, j] = True
                if count < found.shape[0]:
                    found[count, 0], found[count, 1] = i, j
                count += 1
            upper, lower, gap = (i, j, -dd) if dd < 0.0 else (j, i, dd)
            radius = 0.5 * diameter_m + wash_spread * gap
            if gap <= 0.0 or square > 9.0 * radius * radius or lift_share[upper] == 0.0:
                continue
            onset = min(1.0, gap / half_height_m)
            fade = diameter_m / (diameter_m + gap)
            strength = wash_m_s2 * lift_share[upper] * onset * fade * fade * math.exp(-square / (radius * radius))
            push[lower, 2] += strength
    return count


@compiled
def advance(
    blocks: Array, scalars: Array, draws: Array, dt_s: float, position: Array, velocity: Array, yaw_keep: float
) -> None:
    """See :func:`sitl.px4.estimator_errors.advance`."""
    blend = dt_s / BLEND_S
    for i in range(blocks.shape[0]):
        b, s = blocks[i], scalars[i]
        keep = s[KEEP]
        spread = math.sqrt(1.0 - keep * keep)
        for k in range(3):
            unit = keep * b[UNIT_V, k] + spread * draws[i, k]
            b[UNIT_V, k] = unit
            b[UNIT_P, k] += dt_s * (b[RATIO, k] * unit - b[PULL, k] * b[UNIT_P, k])
            b[STD_P, k] += blend * (b[STD_P_GOAL, k] - b[STD_P, k])
            b[STD_V, k] += blend * (b[STD_V_GOAL, k] - b[STD_V, k])
            b[BIAS, k] += blend * (b[BIAS_GOAL, k] - b[BIAS, k])
            b[DRIFT_V, k] = s[DRIFTS] * (b[DRIFT_V, k] + dt_s * b[DRIFT_A, k])
            b[OFFSET, k] += dt_s * b[DRIFT_V, k]
            b[BASE, k] = position[i, k] + b[OFFSET, k]
            b[POSITION, k] = b[BASE, k] + b[BIAS, k] + b[STD_P, k] * b[UNIT_P, k]
            b[VELOCITY, k] = velocity[i, k] + b[DRIFT_V, k] + b[STD_V, k] * unit
        lag = s[FLIES] * (1.0 - yaw_keep)
        s[YAW_SMOOTH] += lag * (_ROOT_TWO * s[YAW_UNIT] - s[YAW_SMOOTH])
        s[YAW_UNIT] = (1.0 - lag) * s[YAW_UNIT] + math.sqrt(1.0 - (1.0 - lag) * (1.0 - lag)) * draws[i, 3]
        s[YAW_SHARE] += blend * (s[YAW_SHARE_GOAL] - s[YAW_SHARE])
        compass = s[YAW_MEAN] + s[YAW_STD] * s[YAW_SMOOTH]
        s[YAW_ERROR] = s[YAW_SHARE] * compass + (1.0 - s[YAW_SHARE]) * s[VISION_YAW]
