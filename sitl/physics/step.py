"""One step of 4 ms of all vehicles: the records of a vehicle, and its equations of motion.

numba compiles these functions where it is installed (`jit.py`). Frames: NED world, FRD body. The
ground is level, with a platform around each take-off spot.

PX4's inner loops are not computed. Their measured responses are computed instead:

* Roll and pitch: a dead time, then the exact transition of a second-order system in the tilt
  vector, limited in rate.
* Heading: PX4's cascade, fitted to measured steps. The outer loop commands a rate in proportion to
  the error, limited to MC_YAWRATE_MAX. The rate loop has an integral part and commands a torque.
  The torque is limited and filtered, and the air opposes it.
* Body rates: the rates follow with a short lag, after a dead time for the switch of controllers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sitl.physics.frames import Array
from sitl.physics.jit import Record, Records, compiled

GRAVITY_M_S2 = 9.80665
STEP_S = 0.004  # 250 Hz: the loop of PX4's own simulator, and the resolution of every dead time
THRUST_NOISE_CORRELATION_S = 0.1
# The motors of a vehicle that meets the ground tilted by more than 60 deg stay off.
CRASH_TILT_COS = 0.5
LARGEST_TUMBLE_RAD_S = 15.0
# A contact after a lower peak height than this ends a hop during lift-off, not a flight.
HOP_M = 0.05

MOTION = np.dtype(
    [
        ("position", "f8", 3),  # NED [m]
        ("velocity", "f8", 3),  # NED [m/s]
        ("acceleration", "f8", 3),  # NED [m/s^2]
        ("tilt", "f8", 2),  # rotation vector about body x and y [rad]
        ("tilt_rate", "f8", 2),  # [rad/s]
        ("yaw", "f8"),  # [rad]
        ("yaw_rate", "f8"),  # [rad/s]
        ("yaw_torque", "f8"),  # filtered torque, over the inertia [rad/s^2]
        ("yaw_integral", "f8"),  # integral part of the torque of the rate loop [rad/s^2]
        ("thrust", "f8"),  # normalised, after the motors' lag
        ("attitude", "f8", 4),  # quaternion NED <- FRD, wxyz
        ("thrust_noise", "f8"),  # error of the thrust, as a process of unit variance
        # Error of the tilt that the attitude loop has not yet integrated away [rad].
        ("tilt_offset", "f8", 2),
        ("lift_share", "f8"),  # lift in units of the weight
        ("lift_scale", "f8"),  # share of the lift that the motors still give
        ("lift_cap", "f8"),  # largest lift that the motors still give, over full lift
        # Angular acceleration about body x and y by a dead motor, per lift [rad/s^2 per m/s^2].
        ("tumble", "f8", 2),
        ("rate_steps", "i8"),  # steps since body rates were first commanded
        ("highest", "f8"),  # largest height above the ground since the last contact with it [m]
        ("touchdowns", "i8"),  # number of flights that have ended on the ground
        ("touchdown_speed", "f8"),  # speed downwards at the newest touchdown [m/s]
        ("touchdown_powered", "?"),  # whether the motors had all their thrust at that touchdown
        ("is_powered", "?"),  # whether the motors turn and have all their thrust
        ("on_ground", "?"),
        ("motors_dead", "?"),
    ],
    align=True,
)

RESPONSE = np.dtype(  # constants of one vehicle: its response, from its profile
    [
        # Factors from tilt and tilt rate to those one step later, about body x and y.
        ("tilt_by_tilt", "f8", 2),
        ("tilt_by_rate", "f8", 2),
        ("rate_by_tilt", "f8", 2),
        ("rate_by_rate", "f8", 2),
        ("gain", "f8"),  # ratio of the tilt reached to the tilt commanded
        ("bias", "f8", 2),  # constant error of the tilt [rad]
        ("full_lift", "f8"),  # acceleration at full thrust [m/s^2]
        ("curve", "f8"),  # 0 for a lift linear in the thrust command, 1 for a quadratic one
        ("drag", "f8"),  # linear drag, over the mass [1/s]
        ("motor_blend", "f8"),  # part of the way to the commanded thrust in one step
        ("thrust_noise_std", "f8"),  # standard deviation of the relative error of the thrust
        ("max_tilt_rate", "f8"),  # [rad/s]
        ("max_yaw_rate", "f8"),  # [rad/s]
        ("yaw_p", "f8"),  # rate commanded per error of the heading [1/s]
        ("yaw_rate_p", "f8"),  # proportional gain of the rate loop [1/s]
        ("yaw_rate_i", "f8"),  # integral gain of the rate loop [1/s^2]
        ("yaw_blend", "f8"),  # part of the way to the commanded torque in one step
        ("max_yaw_torque", "f8"),  # largest torque over the inertia [rad/s^2]
        ("yaw_drag", "f8"),  # torque of the air per rate, over the inertia [1/s]
        ("rate_blend", "f8"),  # part of the way to commanded body rates in one step
        ("offset_keep", "f8"),  # part of a tilt offset that is left after one step
        # Dead times in steps.
        ("tilt_delay", "i8"),
        ("yaw_delay", "i8"),
        ("rate_delay", "i8"),
        ("thrust_delay", "i8"),
        ("switch_steps", "i8"),  # dead time of the switch from attitudes to body rates
    ],
    align=True,
)

COMMAND = np.dtype(
    [
        ("attitude", "f8", 4),  # quaternion NED <- FRD, wxyz
        ("rate", "f8", 3),  # body rates [rad/s]
        ("thrust", "f8"),  # normalised
        ("is_rate", "?"),  # whether the rates are flown instead of the attitude
        ("motors_on", "?"),
    ],
    align=True,
)


class Ground(NamedTuple):
    """Level ground with a round platform around each take-off spot.

    A platform carries what comes from above. Below it one flies as below a table.
    """

    down: float  # down coordinate of the ground between the platforms, NED [m]
    spots: Array  # centres of the platforms (k, 3), NED [m]
    radius: float  # of each platform [m]


_TWO_PI = 2.0 * math.pi
_NOISE_BLEND = STEP_S / THRUST_NOISE_CORRELATION_S
_NOISE_SPREAD = math.sqrt(2.0 * _NOISE_BLEND)
# Below this sine or angle of a tilt the two are taken as equal, and their quotient is not computed.
_MIN_TILT = 1e-9
_Quaternion = tuple[float, float, float, float]


@compiled
def _wrap(angle_rad: float) -> float:
    return math.pi - (math.pi - angle_rad) % _TWO_PI


@compiled
def _within(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))


@compiled
def _commanded_tilt(q: Array, yaw: float) -> tuple[float, float]:
    """Return the tilt about body x and y of an attitude, seen from the vehicle's true heading.

    The direction of the thrust has priority over the heading, as in PX4.
    """
    # Body z in the world.
    north = 2.0 * (q[1] * q[3] + q[0] * q[2])
    east = 2.0 * (q[2] * q[3] - q[0] * q[1])
    down = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])

    # Body z in the horizontal axes of the vehicle.
    cos_yaw = math.cos(yaw)
    sin_yaw = math.sin(yaw)
    ahead = cos_yaw * north + sin_yaw * east
    right = -sin_yaw * north + cos_yaw * east

    # Angle of the tilt over its sine.
    horizontal = math.sqrt(ahead * ahead + right * right)
    scale = 1.0
    if horizontal > _MIN_TILT:
        scale = math.atan2(horizontal, down) / horizontal
    return -right * scale, ahead * scale


@compiled
def _tilt_axis(r: Record, axis: int, tilt: float, rate: float, goal: float) -> tuple[float, float]:
    """Return the tilt and its rate about body x (0) or y (1), one step later."""
    error = tilt - goal
    next_tilt = goal + r.tilt_by_tilt[axis] * error + r.tilt_by_rate[axis] * rate
    next_rate = r.rate_by_tilt[axis] * error + r.rate_by_rate[axis] * rate

    moved = _within(next_tilt - tilt, STEP_S * r.max_tilt_rate)
    return tilt + moved, _within(next_rate, r.max_tilt_rate)


@compiled
def _heading(m: Record, r: Record, q: Array) -> tuple[float, float, float, float]:
    """Return the heading, its rate, the filtered torque and the integral, one step later."""
    # The error of the heading commands a rate.
    error = _wrap(2.0 * math.atan2(q[3], q[0]) - m.yaw)
    rate_error = _within(r.yaw_p * error, r.max_yaw_rate) - m.yaw_rate

    # The error of the rate commands a torque. Nothing is integrated while the torque is limited.
    torque = r.yaw_rate_p * rate_error + m.yaw_integral
    integral = m.yaw_integral
    if abs(torque) < r.max_yaw_torque:
        integral += STEP_S * r.yaw_rate_i * rate_error

    # The torque is filtered, and the air opposes it.
    filtered = m.yaw_torque + r.yaw_blend * (_within(torque, r.max_yaw_torque) - m.yaw_torque)
    rate = m.yaw_rate + STEP_S * (filtered - r.yaw_drag * m.yaw_rate)
    return m.yaw + STEP_S * rate, rate, filtered, integral


@compiled
def _lift(m: Record, r: Record, thrust_frac: float, is_turning: bool, draw: float) -> float:
    """Return the acceleration from the motors [m/s^2]; update thrust, its noise and the lift."""
    thrust = 0.0
    if is_turning:
        thrust = m.thrust + r.motor_blend * (thrust_frac - m.thrust)
    m.thrust = thrust
    m.thrust_noise = (1.0 - _NOISE_BLEND) * m.thrust_noise + _NOISE_SPREAD * draw

    healthy_share = (1.0 - r.curve) * thrust + r.curve * thrust * thrust
    available_share = min(m.lift_scale * healthy_share, m.lift_cap)
    lift = available_share * r.full_lift * (1.0 + r.thrust_noise_std * m.thrust_noise)
    m.lift_share = lift / GRAVITY_M_S2
    return float(lift)


@compiled
def _turned(
    q: Array, roll_rate: float, pitch_rate: float, yaw_rate: float
) -> tuple[float, float, float]:
    """Return tilt about body x and y, and heading, of an attitude after one step of body rates."""
    # Product of the attitude and the small turn (1, hp, hq, hr).
    hp = 0.5 * STEP_S * roll_rate
    hq = 0.5 * STEP_S * pitch_rate
    hr = 0.5 * STEP_S * yaw_rate
    bw, bx, by, bz = q[0], q[1], q[2], q[3]
    w = bw - bx * hp - by * hq - bz * hr
    x = bw * hp + bx + by * hr - bz * hq
    y = bw * hq - bx * hr + by + bz * hp
    z = bw * hr + bx * hq - by * hp + bz

    norm = math.sqrt(w * w + x * x + y * y + z * z)
    w /= norm
    x /= norm
    y /= norm
    z /= norm

    # The tilt is the attitude without its heading.
    yaw = 2.0 * math.atan2(z, w)
    cos_half = math.cos(0.5 * yaw)
    sin_half = math.sin(0.5 * yaw)
    tilt_w = cos_half * w + sin_half * z
    tilt_x = cos_half * x + sin_half * y
    tilt_y = cos_half * y - sin_half * x

    # Angle of the tilt over the sine of half that angle.
    sine = math.sqrt(tilt_x * tilt_x + tilt_y * tilt_y)
    scale = 2.0
    if sine > _MIN_TILT:
        scale = 2.0 * math.atan2(sine, tilt_w) / sine
    return scale * tilt_x, scale * tilt_y, yaw


@compiled
def _rotate(
    m: Record, r: Record, by_attitude: Array, by_heading: Array, rate: Array, lift: float
) -> None:
    """Advance tilt, heading and their rates towards a commanded attitude or body rates."""
    # The response to a commanded attitude.
    commanded_x, commanded_y = _commanded_tilt(by_attitude, m.yaw)
    m.tilt_offset[0] *= r.offset_keep
    m.tilt_offset[1] *= r.offset_keep
    goal_x = r.gain * commanded_x + r.bias[0] + m.tilt_offset[0]
    goal_y = r.gain * commanded_y + r.bias[1] + m.tilt_offset[1]
    roll, roll_rate = _tilt_axis(r, 0, m.tilt[0], m.tilt_rate[0], goal_x)
    pitch, pitch_rate = _tilt_axis(r, 1, m.tilt[1], m.tilt_rate[1], goal_y)
    yaw, yaw_rate, torque, integral = _heading(m, r, by_heading)

    # The response to body rates replaces it where a dead motor turns the vehicle, or where rates
    # are commanded.
    is_tumbling = m.tumble[0] != 0.0 or m.tumble[1] != 0.0
    if is_tumbling or m.rate_steps > r.switch_steps:
        roll_rate = m.tilt_rate[0]
        pitch_rate = m.tilt_rate[1]
        yaw_rate = m.yaw_rate
        if is_tumbling:
            roll_rate = _within(roll_rate + STEP_S * lift * m.tumble[0], LARGEST_TUMBLE_RAD_S)
            pitch_rate = _within(pitch_rate + STEP_S * lift * m.tumble[1], LARGEST_TUMBLE_RAD_S)
        else:
            roll_rate += r.rate_blend * (rate[0] - roll_rate)
            pitch_rate += r.rate_blend * (rate[1] - pitch_rate)
            yaw_rate += r.rate_blend * (rate[2] - yaw_rate)
        roll, pitch, yaw = _turned(m.attitude, roll_rate, pitch_rate, yaw_rate)
        torque = 0.0
        integral = 0.0

    # A vehicle on the ground does not turn.
    if m.on_ground:
        m.tilt[:] = 0.0
        m.tilt_rate[:] = 0.0
        m.yaw_rate = 0.0
        m.yaw_torque = 0.0
        m.yaw_integral = 0.0
        return

    m.tilt[0] = roll
    m.tilt[1] = pitch
    m.tilt_rate[0] = roll_rate
    m.tilt_rate[1] = pitch_rate
    m.yaw = _wrap(yaw)
    m.yaw_rate = yaw_rate
    m.yaw_torque = torque
    m.yaw_integral = integral


@compiled
def _attitude(roll: float, pitch: float, yaw: float) -> _Quaternion:
    """Return the attitude that turns by a heading, then tilts about a horizontal body axis."""
    # Quaternion of the tilt.
    angle = math.sqrt(roll * roll + pitch * pitch)
    scale = 0.5
    if angle > _MIN_TILT:
        scale = math.sin(0.5 * angle) / angle
    w = math.cos(0.5 * angle)
    x = scale * roll
    y = scale * pitch

    # Product of the heading and the tilt.
    cy = math.cos(0.5 * yaw)
    sy = math.sin(0.5 * yaw)
    return cy * w, cy * x - sy * y, cy * y + sy * x, sy * w


@compiled
def ground_below(position: Array, ground: Ground) -> float:
    """Return the down coordinate of the ground below a position (3,), NED [m].

    Where platforms overlap, that of the nearest spot counts; of spots above each other the highest.
    """
    below = ground.down
    nearest = ground.radius * ground.radius
    for k in range(ground.spots.shape[0]):
        # A vehicle that stands on a platform is exactly as high, so no tolerance is needed.
        down = ground.spots[k, 2]
        if position[2] > down:
            continue

        north = position[0] - ground.spots[k, 0]
        east = position[1] - ground.spots[k, 1]
        square = north * north + east * east
        if square < nearest or (square == nearest and down < below):
            below = down
            nearest = square
    return float(below)


@compiled
def _meet_ground(m: Record, speed_down: float) -> None:
    """Record the touchdown that ends a flight, with its speed downwards [m/s]."""
    if m.highest > HOP_M:
        m.touchdowns += 1
        m.touchdown_speed = speed_down
        m.touchdown_powered = m.is_powered
    m.highest = 0.0


@compiled
def _move(m: Record, r: Record, lift: float, air: Array, push: Array, ground: Ground) -> None:
    """Advance attitude, position and velocity, and handle a contact with the ground."""
    w, x, y, z = _attitude(m.tilt[0], m.tilt[1], m.yaw)
    m.attitude[0] = w
    m.attitude[1] = x
    m.attitude[2] = y
    m.attitude[3] = z

    # Accelerations in NED by the lift (against body z), the drag, the push and gravity.
    v = m.velocity
    tilt_cos = 1.0 - 2.0 * (x * x + y * y)
    an = -lift * 2.0 * (x * z + w * y) + r.drag * (air[0] - v[0]) + push[0]
    ae = -lift * 2.0 * (y * z - w * x) + r.drag * (air[1] - v[1]) + push[1]
    ad = -lift * tilt_cos + r.drag * (air[2] - v[2]) + push[2] + GRAVITY_M_S2

    vn = v[0] + STEP_S * an
    ve = v[1] + STEP_S * ae
    vd = v[2] + STEP_S * ad
    down = m.position[2] + STEP_S * vd
    ground_down = ground_below(m.position, ground)
    touches = down >= ground_down

    m.highest = max(m.highest, ground_down - m.position[2])
    if touches and not m.on_ground:
        _meet_ground(m, vd)

    # A vehicle on the ground does not slide, and a climb begins vertically.
    rests = touches and m.on_ground
    if not rests:
        m.position[0] += STEP_S * vn
        m.position[1] += STEP_S * ve
        m.position[2] = ground_down if touches else down
        if touches and tilt_cos < CRASH_TILT_COS:
            m.motors_dead = True

    m.on_ground = touches
    if touches:
        m.velocity[:] = 0.0
        m.acceleration[:] = 0.0
        return

    m.velocity[0] = vn
    m.velocity[1] = ve
    m.velocity[2] = vd
    m.acceleration[0] = an
    m.acceleration[1] = ae
    m.acceleration[2] = ad


@compiled
def step(
    motion: Records,
    response: Records,
    commanded: Records,
    newest: int,
    air: Array,
    push: Array,
    draws: Array,
    ground: Ground,
) -> None:
    """Advance all vehicles in place by `STEP_S`.

    Args:
        motion: records MOTION (n,), updated.
        response: records RESPONSE (n,).
        commanded: ring (depth, n) of records COMMAND.
        newest: index in the ring of the present commands.
        air: velocity of the air (n, 3), NED [m/s].
        push: all other acceleration (n, 3), NED [m/s^2].
        draws: standard normal numbers (n, 3). The first of a vehicle is for its thrust. The other
            two are not used, and are drawn so that the flights of a seed do not change.
        ground: the ground below all of them.
    """
    depth = commanded.shape[0]
    for i in range(motion.shape[0]):
        m = motion[i]
        r = response[i]

        # Commands to switch motors and body rates on or off act at once. All other commands act
        # after a dead time.
        present = commanded[newest, i]
        by_tilt = commanded[(newest - r.tilt_delay) % depth, i]
        by_heading = commanded[(newest - r.yaw_delay) % depth, i]
        by_rate = commanded[(newest - r.rate_delay) % depth, i]
        by_thrust = commanded[(newest - r.thrust_delay) % depth, i]

        is_turning = present.motors_on and not m.motors_dead
        lift = _lift(m, r, by_thrust.thrust, is_turning, draws[i, 0])
        m.is_powered = is_turning and m.lift_scale >= 1.0

        if present.is_rate:
            m.rate_steps += 1
        else:
            m.rate_steps = 0
        _rotate(m, r, by_tilt.attitude, by_heading.attitude, by_rate.rate, lift)
        _move(m, r, lift, air[i], push[i], ground)
