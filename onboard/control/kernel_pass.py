"""One pass of the pipeline around the law, row by row of a batch, in floats; compiled only (compiled.py).

``before`` is all that comes ahead of the law's rows, ``after`` all that follows; between them runs ``kernels.covey``.
The formulas are those of pipeline.step and of the stages that it calls, in their order: there is the derivation. They
take sound input only: as soon as one row is not finite, ``before`` says so and the array forms do it, which know what
to make of it. Vectors lie in one array (count, M, 3) and scalars in one (count, M), in the order in which they are
unpacked.
"""

from __future__ import annotations

import math
from typing import Any

from onboard.avoidance.kernels import HUGE, MAX_MESSAGE_AGE_S, held_on
from onboard.control import kernel_motion as motion
from onboard.control.kernel_motion import Vec3

_GRAVITY_M_S2 = 9.80665


def row3(array: Any, m: int) -> Vec3:
    """Vector ``m`` of an (M, 3)."""
    return array[m, 0], array[m, 1], array[m, 2]


def put3(array: Any, m: int, vector: Vec3) -> None:
    """Write vector ``m`` of an (M, 3)."""
    array[m, 0], array[m, 1], array[m, 2] = vector


def size_3(vector: Vec3) -> float:
    """Sum of the magnitudes; not finite when one is not."""
    return abs(vector[0]) + abs(vector[1]) + abs(vector[2])


def into_disc(x: float, y: float, radius: float) -> tuple[float, float]:
    """A horizontal vector shortened to the radius."""
    size = math.sqrt(x * x + y * y)
    share = radius / max(size, 1e-12) if size > radius else 1.0
    return x * share, y * share


def along_leg(leg: Any, m: int, first: float, second: float, elapsed: float, rate: float) -> tuple[Vec3, Vec3, Vec3]:
    """The setpoint at a time of the leg; guidance.setpoint."""
    start, start_velocity, start_acceleration, via, goal = leg
    if elapsed >= first:
        begin, end, duration, elapsed = row3(via, m), row3(goal, m), second, elapsed - first
        speed, push = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    else:
        begin, end, duration = row3(start, m), row3(via, m), first
        speed, push = row3(start_velocity, m), row3(start_acceleration, m)
    duration = duration if duration > 0.0 else 1.0
    return motion.quintic(begin, speed, push, end, duration, min(elapsed / duration, 1.0), rate)


def followed_hover(
    hover: float, effective: float, sent: float, cos_tilt: float, acceleration_z: float, height: float, n: Any, t: float
) -> tuple[float, float]:
    """Hover throttle and the throttle behind the motors' lag; hover_thrust.step. n: numbers, then whether it flies."""
    blend, time_constant, lowest, fastest, low_frac, high_frac, bottom, top, is_flying = n
    effective = effective + blend * (sent - effective)
    is_steady = height > lowest and abs(acceleration_z) < fastest and cos_tilt > 0.5
    if is_flying > 0.0 and is_steady and low_frac < effective < high_frac:
        seen = effective * cos_tilt * _GRAVITY_M_S2 / (_GRAVITY_M_S2 + acceleration_z)
        hover = hover + t / time_constant * (seen - hover)
    return min(max(hover, bottom), top), effective


def before(
    vectors: Any, leg: Any, scalars: Any, commands: Any, history: Any, held: Any, n: Any, out: Any, out_1: Any,
    out_commands: Any, floats: Any,
) -> int:  # fmt: skip
    """All stages ahead of the law's rows; 0 when an input is not sound, and then nothing may be used.

    Args:
        vectors: nine (M, 3). leg: five (M, 3). scalars: fourteen (M,). commands: (M, H, 3) of the observer.
        history: (M, 3 B) of the law, held for ``held`` (M, B). n: nine tuples of numbers (fused.numbers).
        out: (12, M, 3) and out_1 (4, M), in the order written; out_commands (M, H, 3). floats: (M, 14) for the law.
    """
    times, observer, lift, clock, lead, gains, pursuit, bounds, jam = n
    position, velocity, acceleration, goal, seen, disturbance, response, rate, sent = vectors
    first, second, elapsed, hover, effective, throttle, cos_tilt, activity, clock_rate, relaxed, held_s, age, std_p, \
        std_v = scalars  # fmt: skip
    t, is_frozen = times
    delay, wn, zeta, gain_v, gain_d, drag, most, vertical_blend = observer
    slack_m, stop_m, clock_blend = clock
    is_predicted, lag, vertical_lag = lead
    k_1, k_2, coupling, widest, largest, highest = gains
    pursuit_speed, top_speed = pursuit
    shift_bound, lift_bound, max_thrust, tan_tilt = bounds
    has_jam, crowd_floor = jam
    slots = commands.shape[1]
    ticks = min(delay / t, slots - 1.000001)
    whole = int(ticks)
    model, watched = (wn, zeta), (gain_v, gain_d, drag, most)
    for m in range(position.shape[0]):
        p, v, a, u, target = row3(position, m), row3(velocity, m), row3(acceleration, m), row3(sent, m), row3(goal, m)
        total = size_3(p) + size_3(v) + abs(a[2]) + size_3(u) + size_3(target) + abs(throttle[m]) + abs(age[m])
        if not total < HUGE:
            return 0
        # disturbance.observe
        for k in range(slots - 1):
            for c in range(3):
                out_commands[m, k + 1, c] = commands[m, k, c]
        put3(out_commands[m], 0, u)
        newer, older = row3(out_commands[m], whole), row3(out_commands[m], whole + 1)
        share = ticks - whole
        for c in range(2):
            command = newer[c] + share * (older[c] - newer[c])
            state = (seen[m, c], disturbance[m, c], response[m, c], rate[m, c])
            out[0, m, c], out[1, m, c], out[2, m, c], out[3, m, c] = motion.responded(
                v[c], state, command, model, watched, t
            )
        lifted = response[m, 2] + vertical_blend * (u[2] - response[m, 2])
        acting = 0.5 * (lifted + response[m, 2])
        out[0, m, 2], out[1, m, 2] = motion.observed(v[2], seen[m, 2], disturbance[m, 2], acting, watched, t)
        out[2, m, 2], out[3, m, 2] = lifted, 0.0
        if is_frozen > 0.0:
            put3(out[0], m, v)
            put3(out[1], m, row3(disturbance, m))
        out_1[0, m], out_1[1, m] = followed_hover(hover[m], effective[m], throttle[m], cos_tilt[m], a[2], p[2], lift, t)
        # oist.predict
        if is_predicted > 0.0:
            old = min(max(age[m], 0.0), MAX_MESSAGE_AGE_S)
            p, v = motion.predicted(history[m], held[m], p, v, old + lag, old + vertical_lag, lag - vertical_lag)
        # pipeline.clock_rate, then guidance.step
        ahead, _, _ = along_leg(leg, m, first[m], second[m], elapsed[m], 1.0)
        w_x, w_y = target[0] - ahead[0], target[1] - ahead[1]
        lag_m = ((ahead[0] - p[0]) * w_x + (ahead[1] - p[1]) * w_y) / max(math.sqrt(w_x * w_x + w_y * w_y), 1e-6)
        share = min(max((lag_m - slack_m) / (stop_m - slack_m), 0.0), 1.0)
        wanted_rate = 1.0 - min(max(2.0 * activity[m], 0.0), 1.0) * share
        pace = clock_rate[m] + clock_blend * (wanted_rate - clock_rate[m])
        out_1[2, m] = pace
        pace = min(max(pace, 0.0), 1.0)
        out_1[3, m] = min(elapsed[m] + pace * t, first[m] + second[m])
        s_p, s_v, s_a = along_leg(leg, m, first[m], second[m], out_1[3, m], pace)
        put3(out[4], m, s_p)
        put3(out[5], m, s_v)
        put3(out[6], m, s_a)
        # pipeline._slowed, pipeline._pursuit and backstepping.step
        share = max(0.1, 1.0 - 1.5 * relaxed[m]) if has_jam > 0.0 else 1.0
        speed = math.sqrt(s_v[0] * s_v[0] + s_v[1] * s_v[1] + s_v[2] * s_v[2])
        reach = min(max((pursuit_speed - speed) / k_1, 0.15), widest) * share
        reach = min(reach, 0.1) if is_frozen > 0.0 else reach
        b_x, b_y, b_z = motion.baseline(
            (s_p[0] - p[0], s_p[1] - p[1], s_p[2] - p[2]),
            (s_v[0] * share - v[0], s_v[1] * share - v[1], s_v[2] * share - v[2]),
            (s_a[0] * share, s_a[1] * share, s_a[2] * share),
            (k_1, k_2, coupling), reach, (1.0 if is_frozen > 0.0 else largest, highest),
        )  # fmt: skip
        b_z = b_z + _GRAVITY_M_S2
        # pipeline._limited, pipeline.intent
        x, y = drag * v[0] - out[1, m, 0], drag * v[1] - out[1, m, 1]
        z = drag * v[2] - out[1, m, 2]
        scale = min(1.0, shift_bound / max(math.sqrt(x * x + y * y), 1e-9))
        x, y, z = x * scale, y * scale, min(max(z, -lift_bound), lift_bound)
        i_x, i_y = target[0] - p[0], target[1] - p[1]
        scale = top_speed / max(math.sqrt(i_x * i_x + i_y * i_y), top_speed)
        i_x, i_y = i_x * scale, i_y * scale
        total = size_3(p) + size_3(v) + abs(b_x) + abs(b_y) + abs(b_z) + abs(x) + abs(y) + abs(z) + abs(pace)
        if not total + size_3(s_p) < HUGE:
            return 0
        put3(out[7], m, p)
        put3(out[8], m, v)
        put3(out[9], m, (b_x, b_y, b_z))
        put3(out[10], m, (x, y, z))
        put3(out[11], m, (i_x, i_y, 0.0))
        # oist.saturate
        up = min(max(b_z, 0.0), max_thrust)
        radius = min(up * tan_tilt, math.sqrt(max_thrust * max_thrust - up * up))
        f = floats[m]
        f[0], f[1] = into_disc(b_x + x, b_y + y, radius)
        f[2], f[3], f[4], f[5], f[6], f[7], f[8] = x, y, radius, p[0], p[1], v[0], v[1]
        f[9], f[10], f[11], f[12], f[13] = i_x, i_y, std_p[m], std_v[m], crowd_floor if held_s[m] < 0.0 else 0.0
    return 1


def after(
    result: Any, floats: Any, given: Any, hover: Any, scalars: Any, history: Any, held: Any, n: Any, out: Any,
    out_4: Any, out_1: Any, out_history: Any, out_held: Any,
) -> None:  # fmt: skip
    """All that follows the law: what is sent, and the memories of it.

    Args:
        result: (M, 6) of ``kernels.covey``. floats: what it was given. given: (12, M, 3) from ``before``. hover: (M,).
        scalars: activity, relaxed_share and held_s, (M,) each. history, held: as for ``before``. n: three tuples.
        out: (3, M, 3) thrust, acceleration, what is sent. out_4: (M, 4). out_1: (6, M). out_history, out_held.
    """
    times, limits, weights = n
    t, yaw = times
    tan_tilt, low_frac, high_frac = limits
    activity_blend, relaxed_weight, relaxed_status = weights
    activity, relaxed, held_s = scalars
    slots = held.shape[1]
    for m in range(result.shape[0]):
        f, z = floats[m], given[9, m, 2]
        x, y = result[m, 0] - f[2], result[m, 1] - f[3]
        put3(out[0], m, (x, y, z))
        put3(out[1], m, (x, y, z - _GRAVITY_M_S2))
        c_x, c_y = result[m, 0] - f[0], result[m, 1] - f[1]
        moved = math.sqrt(c_x * c_x + c_y * c_y)
        is_relaxed = 1.0 if result[m, 2] == relaxed_status else 0.0
        out_1[0, m] = relaxed[m] + relaxed_weight * (is_relaxed - relaxed[m])
        is_active = result[m, 5] >= 0.0
        out_1[1, m] = held_on(held_s[m], f[7], f[8], f[9], f[10], is_active, t)
        for k in range(slots - 1):
            out_held[m, k + 1] = held[m, k]
        for k in range(3 * slots - 3):
            out_history[m, k + 3] = history[m, k]
        out_history[m, 0], out_history[m, 1], out_history[m, 2] = x, y, z - _GRAVITY_M_S2
        out_held[m, 0] = t
        wanted = (x + given[10, m, 0], y + given[10, m, 1], z + given[10, m, 2])
        sent = motion.limited(wanted, hover[m], tan_tilt, low_frac, high_frac)
        put3(out[2], m, (sent[0], sent[1], sent[2] - _GRAVITY_M_S2))
        again = motion.limited(sent, hover[m], tan_tilt, low_frac, high_frac)
        out_4[m, 0], out_4[m, 1], out_4[m, 2], out_4[m, 3], out_1[2, m] = motion.attitude(again, yaw, hover[m])
        size = math.sqrt(sent[0] * sent[0] + sent[1] * sent[1] + sent[2] * sent[2])
        out_1[3, m] = sent[2] / max(size, 1e-9)
        out_1[4, m] = activity[m] + activity_blend * ((1.0 if moved > 0.05 else 0.0) - activity[m])
        out_1[5, m] = moved
