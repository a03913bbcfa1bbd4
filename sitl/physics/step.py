"""One 4-ms step of all vehicles: the records that describe a vehicle, and its equations in plain
floats.

numba compiles these functions where it is installed (:mod:`sitl.physics.jit`). Frames: NED world,
FRD body, ground at z = 0.

Roll and pitch: dead time, then the exact transition of a second-order system in the tilt vector,
limited in rate. Heading: PX4's own cascade, fitted to its measured steps: a rate limited to
MC_YAWRATE_MAX is commanded in proportion to the error; a rate loop with integral commands a torque,
which is limited, filtered, and opposed by the air. Body rates: after a dead time for the switch of
controllers the rates follow with a short lag.
"""

from __future__ import annotations

import math

import numpy as np

from sitl.physics.frames import Array
from sitl.physics.jit import Record, Records, compiled

GRAVITY_M_S2 = 9.80665
STEP_S = 0.004  # 250 Hz: the loop of PX4's own simulator, and the resolution of every dead time
THRUST_NOISE_CORRELATION_S = 0.1
GUST_CORRELATION_S = 1.0
# a vehicle that meets the ground tilted by more than 60 deg does not fly again
CRASH_TILT_COS = 0.5
LARGEST_TUMBLE_RAD_S = 15.0

MOTION = np.dtype(
    [
        ("position", "f8", 3),  # NED [m]
        ("velocity", "f8", 3),
        ("acceleration", "f8", 3),
        ("tilt", "f8", 2),  # rotation vector about body x and y [rad]
        ("tilt_rate", "f8", 2),
        ("yaw", "f8"),
        ("yaw_rate", "f8"),
        ("yaw_torque", "f8"),  # filtered, over the inertia [rad/s^2]
        ("yaw_integral", "f8"),
        ("thrust", "f8"),  # normalised, after the motors' lag
        ("attitude", "f8", 4),  # quaternion NED <- FRD, wxyz
        ("thrust_noise", "f8"),
        ("gust", "f8", 2),
        # error of the attitude that its loop has not yet integrated away [rad]
        ("tilt_offset", "f8", 2),
        ("lift_share", "f8"),  # lift in units of the weight
        ("lift_scale", "f8"),  # share of the lift that the motors still have
        ("lift_cap", "f8"),  # largest lift that they still have
        # turning by a dead motor about body x and y, per lift [rad/s^2 per m/s^2]
        ("tumble", "f8", 2),
        ("rate_steps", "i8"),  # steps since body rates are commanded
        ("on_ground", "?"),
        ("motors_dead", "?"),
    ],
    align=True,
)

RESPONSE = np.dtype(  # constants of one vehicle, from its profile
    [
        # transition of tilt and its rate over one step, about body x and y
        ("tilt_by_tilt", "f8", 2),
        ("tilt_by_rate", "f8", 2),
        ("rate_by_tilt", "f8", 2),
        ("rate_by_rate", "f8", 2),
        ("gain", "f8"),
        ("bias", "f8", 2),
        ("full_lift", "f8"),  # acceleration at full thrust [m/s^2]
        ("curve", "f8"),
        ("drag", "f8"),
        ("motor_blend", "f8"),
        ("thrust_noise_std", "f8"),
        ("gust_std", "f8"),
        ("max_tilt_rate", "f8"),
        ("max_yaw_rate", "f8"),
        ("yaw_p", "f8"),
        ("yaw_rate_p", "f8"),
        ("yaw_rate_i", "f8"),
        ("yaw_blend", "f8"),
        ("max_yaw_torque", "f8"),
        ("yaw_drag", "f8"),
        ("rate_blend", "f8"),
        ("offset_keep", "f8"),
        ("tilt_delay", "i8"),  # dead times in steps
        ("yaw_delay", "i8"),
        ("rate_delay", "i8"),
        ("thrust_delay", "i8"),
        ("switch_steps", "i8"),
    ],
    align=True,
)

COMMAND = np.dtype(
    [
        ("attitude", "f8", 4),
        ("rate", "f8", 3),
        ("thrust", "f8"),
        ("is_rate", "?"),
        ("motors_on", "?"),
    ],
    align=True,
)

_TWO_PI = 2.0 * math.pi
_NOISE_BLEND = STEP_S / THRUST_NOISE_CORRELATION_S
_NOISE_SPREAD = math.sqrt(2.0 * _NOISE_BLEND)
_GUST_BLEND = STEP_S / GUST_CORRELATION_S
_GUST_SPREAD = math.sqrt(2.0 * _GUST_BLEND)
_Quaternion = tuple[float, float, float, float]


@compiled
def _wrap(angle_rad: float) -> float:
    return math.pi - (math.pi - angle_rad) % _TWO_PI


@compiled
def _within(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))


@compiled
def _commanded_tilt(q: Array, yaw: float) -> tuple[float, float]:
    """Tilt about body x and y of an attitude, seen from the heading that the vehicle really has.

    The direction of the thrust has priority over the heading, as in PX4.
    """
    north = 2.0 * (q[1] * q[3] + q[0] * q[2])
    east = 2.0 * (q[2] * q[3] - q[0] * q[1])
    down = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    ahead, right = cos_yaw * north + sin_yaw * east, -sin_yaw * north + cos_yaw * east
    horizontal = math.sqrt(ahead * ahead + right * right)
    scale = math.atan2(horizontal, down) / horizontal if horizontal > 1e-9 else 1.0
    return -right * scale, ahead * scale


@compiled
def _tilt_axis(r: Record, axis: int, tilt: float, rate: float, goal: float) -> tuple[float, float]:
    """Tilt and its rate about body x (0) or y (1), one step later."""
    error, limit = tilt - goal, r.max_tilt_rate
    moved = _within(
        goal + r.tilt_by_tilt[axis] * error + r.tilt_by_rate[axis] * rate - tilt, STEP_S * limit
    )
    return tilt + moved, _within(r.rate_by_tilt[axis] * error + r.rate_by_rate[axis] * rate, limit)


@compiled
def _heading(m: Record, r: Record, q: Array) -> tuple[float, float, float, float]:
    """Heading, its rate, the filtered torque and the integral, one step later."""
    miss = _wrap(2.0 * math.atan2(q[3], q[0]) - m.yaw)
    rate_error = _within(r.yaw_p * miss, r.max_yaw_rate) - m.yaw_rate
    torque = r.yaw_rate_p * rate_error + m.yaw_integral
    integral = m.yaw_integral
    if abs(torque) < r.max_yaw_torque:
        integral += STEP_S * r.yaw_rate_i * rate_error
    filtered = m.yaw_torque + r.yaw_blend * (_within(torque, r.max_yaw_torque) - m.yaw_torque)
    rate = m.yaw_rate + STEP_S * (filtered - r.yaw_drag * m.yaw_rate)
    return m.yaw + STEP_S * rate, rate, filtered, integral


@compiled
def _lift(m: Record, r: Record, thrust_frac: float, is_turning: bool, draw: float) -> float:
    """Acceleration by the motors [m/s^2]; updates thrust, its noise and the lift."""
    thrust = m.thrust + r.motor_blend * (thrust_frac - m.thrust) if is_turning else 0.0
    m.thrust = thrust
    m.thrust_noise = (1.0 - _NOISE_BLEND) * m.thrust_noise + _NOISE_SPREAD * draw
    share = min(m.lift_scale * ((1.0 - r.curve) * thrust + r.curve * thrust * thrust), m.lift_cap)
    lift = share * r.full_lift * (1.0 + r.thrust_noise_std * m.thrust_noise)
    m.lift_share = lift / GRAVITY_M_S2
    return float(lift)


@compiled
def _turned(
    q: Array, roll_rate: float, pitch_rate: float, yaw_rate: float
) -> tuple[float, float, float]:
    """Tilt about body x and y, and heading, of an attitude after one step of body rates."""
    hp, hq, hr = 0.5 * STEP_S * roll_rate, 0.5 * STEP_S * pitch_rate, 0.5 * STEP_S * yaw_rate
    bw, bx, by, bz = q[0], q[1], q[2], q[3]
    w = bw - bx * hp - by * hq - bz * hr
    x = bw * hp + bx + by * hr - bz * hq
    y = bw * hq - bx * hr + by + bz * hp
    z = bw * hr + bx * hq - by * hp + bz
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    yaw = 2.0 * math.atan2(z, w)
    cos_half, sin_half = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    w, x, y = cos_half * w + sin_half * z, cos_half * x + sin_half * y, cos_half * y - sin_half * x
    sine = math.sqrt(x * x + y * y)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 1e-9 else 2.0
    return scale * x, scale * y, yaw


@compiled
def _rotate(
    m: Record, r: Record, by_attitude: Array, by_heading: Array, rate: Array, lift: float
) -> None:
    """Advance tilt, heading and their rates, by attitude or by body rates, commanded or suffered."""
    goal_x, goal_y = _commanded_tilt(by_attitude, m.yaw)
    m.tilt_offset[0] *= r.offset_keep
    m.tilt_offset[1] *= r.offset_keep
    roll, p = _tilt_axis(
        r, 0, m.tilt[0], m.tilt_rate[0], r.gain * goal_x + r.bias[0] + m.tilt_offset[0]
    )
    pitch, q = _tilt_axis(
        r, 1, m.tilt[1], m.tilt_rate[1], r.gain * goal_y + r.bias[1] + m.tilt_offset[1]
    )
    yaw, yaw_rate, torque, integral = _heading(m, r, by_heading)
    is_tumbling = m.tumble[0] != 0.0 or m.tumble[1] != 0.0
    if is_tumbling or m.rate_steps > r.switch_steps:
        p, q, yaw_rate = m.tilt_rate[0], m.tilt_rate[1], m.yaw_rate
        if is_tumbling:
            p = _within(p + STEP_S * lift * m.tumble[0], LARGEST_TUMBLE_RAD_S)
            q = _within(q + STEP_S * lift * m.tumble[1], LARGEST_TUMBLE_RAD_S)
        else:
            p, q = p + r.rate_blend * (rate[0] - p), q + r.rate_blend * (rate[1] - q)
            yaw_rate = yaw_rate + r.rate_blend * (rate[2] - yaw_rate)
        roll, pitch, yaw = _turned(m.attitude, p, q, yaw_rate)
        torque = integral = 0.0
    if m.on_ground:  # a vehicle on its feet does not turn, whatever is commanded
        roll = pitch = p = q = yaw_rate = torque = integral = 0.0
    else:
        m.yaw = _wrap(yaw)
    m.tilt[0], m.tilt[1], m.tilt_rate[0], m.tilt_rate[1] = roll, pitch, p, q
    m.yaw_rate, m.yaw_torque, m.yaw_integral = yaw_rate, torque, integral


@compiled
def _attitude(roll: float, pitch: float, yaw: float) -> _Quaternion:
    """Attitude NED <- FRD that turns by a heading, then tilts about a horizontal body axis."""
    angle = math.sqrt(roll * roll + pitch * pitch)
    scale = math.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    w, x, y = math.cos(0.5 * angle), scale * roll, scale * pitch
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return cy * w, cy * x - sy * y, cy * y + sy * x, sy * w


@compiled
def _move(m: Record, r: Record, lift: float, air: Array, push: Array, draws: Array) -> None:
    """Advance attitude, position and velocity; meet the ground."""
    w, x, y, z = _attitude(m.tilt[0], m.tilt[1], m.yaw)
    m.attitude[0], m.attitude[1], m.attitude[2], m.attitude[3] = w, x, y, z
    m.gust[0] = (1.0 - _GUST_BLEND) * m.gust[0] + _GUST_SPREAD * draws[1]
    m.gust[1] = (1.0 - _GUST_BLEND) * m.gust[1] + _GUST_SPREAD * draws[2]
    v = m.velocity
    down_d = 1.0 - 2.0 * (x * x + y * y)
    an = -lift * 2.0 * (x * z + w * y) + r.drag * (air[0] - v[0]) + push[0]
    ae = -lift * 2.0 * (y * z - w * x) + r.drag * (air[1] - v[1]) + push[1]
    ad = -lift * down_d + r.drag * (air[2] - v[2]) + push[2] + GRAVITY_M_S2
    an += r.gust_std * m.gust[0]
    ae += r.gust_std * m.gust[1]
    vn, ve, vd = v[0] + STEP_S * an, v[1] + STEP_S * ae, v[2] + STEP_S * ad
    height = m.position[2] + STEP_S * vd
    touches = height >= 0.0
    # feet grip: on the ground nothing slides, and a climb begins vertically
    if not (touches and m.on_ground):
        m.position[0] += STEP_S * vn
        m.position[1] += STEP_S * ve
        m.position[2] = 0.0 if touches else height
        if touches and down_d < CRASH_TILT_COS:
            m.motors_dead = True
    if touches:
        vn = ve = vd = an = ae = ad = 0.0
    m.velocity[0], m.velocity[1], m.velocity[2] = vn, ve, vd
    m.acceleration[0], m.acceleration[1], m.acceleration[2] = an, ae, ad
    m.on_ground = touches


@compiled
def step(
    motion: Records,
    response: Records,
    commanded: Records,
    newest: int,
    air: Array,
    push: Array,
    draws: Array,
) -> None:
    """Advance all vehicles in place by `STEP_S`.

    Args:
        motion, response: (n,) records MOTION and RESPONSE.
        commanded: ring (depth, n) of records COMMAND. newest: index in the ring of the present
            commands.
        air: (n, 3) velocity of the air, NED [m/s]. push: (n, 3) any other acceleration, NED
            [m/s^2].
        draws: (n, 3) standard normal numbers: thrust, two gusts.
    """
    depth = commanded.shape[0]
    for i in range(motion.shape[0]):
        m, r, now = motion[i], response[i], commanded[newest, i]
        by_tilt = commanded[(newest - r.tilt_delay) % depth, i]
        by_heading = commanded[(newest - r.yaw_delay) % depth, i]
        by_rate = commanded[(newest - r.rate_delay) % depth, i]
        by_thrust = commanded[(newest - r.thrust_delay) % depth, i]
        lift = _lift(m, r, by_thrust.thrust, now.motors_on and not m.motors_dead, draws[i, 0])
        m.rate_steps = m.rate_steps + 1 if now.is_rate else 0
        _rotate(m, r, by_tilt.attitude, by_heading.attitude, by_rate.rate, lift)
        _move(m, r, lift, air[i], push[i], draws[i])
