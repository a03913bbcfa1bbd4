"""The emulator's physics, contacts and errors of the estimate a second time, vectorised in numpy
over all vehicles.

Every function takes the arguments of its twin in ``sitl`` and changes the same records.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.physics.jit import Records
from sitl.physics.step import (
    CRASH_TILT_COS,
    GRAVITY_M_S2,
    LARGEST_TUMBLE_RAD_S,
    STEP_S,
    THRUST_NOISE_CORRELATION_S,
    Ground,
)
from sitl.px4.estimator_errors import BLEND_S, DRIFT_DAMPING_S, TILT_ERROR_GROWTH_S

Bools = NDArray[np.bool_]


def heading(q: Array) -> Array:
    """Twist of a quaternion about world z (...,) [rad]: the heading without the tilt."""
    return 2.0 * np.arctan2(q[..., 3], q[..., 0])


def body_down(q: Array) -> Array:
    """Third column of the rotation matrix: where body z (down) points in the world, (..., 3)."""
    w = q[..., 0]
    x = q[..., 1]
    y = q[..., 2]
    z = q[..., 3]
    return np.stack(
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1
    )


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
    """See :func:`sitl.physics.step.step`."""
    rows = np.arange(motion.shape[0])
    depth = commanded.shape[0]

    now = commanded[newest]
    by_tilt = commanded[(newest - response["tilt_delay"]) % depth, rows]
    by_heading = commanded[(newest - response["yaw_delay"]) % depth, rows]
    rates = commanded[(newest - response["rate_delay"]) % depth, rows]["rate"]
    by_thrust = commanded[(newest - response["thrust_delay"]) % depth, rows]

    lift = _lift(
        motion, response, by_thrust["thrust"], now["motors_on"] & ~motion["motors_dead"], draws
    )

    tilt, tilt_rate = _tilt(motion, response, by_tilt["attitude"])
    yaw, yaw_rate, torque, integral = _heading(motion, response, by_heading["attitude"])

    tumbles = (motion["tumble"] != 0.0).any(axis=1)
    motion["rate_steps"] = np.where(now["is_rate"], motion["rate_steps"] + 1, 0)
    by_rate = (now["is_rate"] & (motion["rate_steps"] > response["switch_steps"])) | tumbles

    blend = response["rate_blend"][:, None]
    free_rate = motion["tilt_rate"] + blend * (rates[:, :2] - motion["tilt_rate"])
    limit = LARGEST_TUMBLE_RAD_S
    falling_rate = np.clip(
        motion["tilt_rate"] + STEP_S * lift[:, None] * motion["tumble"], -limit, limit
    )
    free_rate = np.where(tumbles[:, None], falling_rate, free_rate)

    free_yaw_rate = motion["yaw_rate"] + blend[:, 0] * (rates[:, 2] - motion["yaw_rate"])
    free_yaw_rate = np.where(tumbles, motion["yaw_rate"], free_yaw_rate)

    q = _turn(motion["attitude"], free_rate, free_yaw_rate)
    free_yaw = heading(q)

    tilt = np.where(by_rate[:, None], _tilt_of(q, free_yaw), tilt)
    tilt_rate = np.where(by_rate[:, None], free_rate, tilt_rate)
    yaw = np.where(by_rate, free_yaw, yaw)
    yaw_rate = np.where(by_rate, free_yaw_rate, yaw_rate)

    flies = ~motion["on_ground"]
    motion["tilt"] = tilt * flies[:, None]
    motion["tilt_rate"] = tilt_rate * flies[:, None]
    motion["yaw"] = np.where(flies, frames.wrap(yaw), motion["yaw"])
    motion["yaw_rate"] = yaw_rate * flies
    motion["yaw_torque"], motion["yaw_integral"] = (
        np.where(by_rate | ~flies, 0.0, v) for v in (torque, integral)
    )

    motion["attitude"] = frames.from_yaw_and_tilt(motion["yaw"], motion["tilt"])
    _move(motion, response, lift, air, push, ground)


def _tilt(motion: Records, response: Records, commanded: Array) -> tuple[Array, Array]:
    down = body_down(commanded)
    cos_yaw = np.cos(motion["yaw"])
    sin_yaw = np.sin(motion["yaw"])
    ahead = cos_yaw * down[:, 0] + sin_yaw * down[:, 1]
    right = -sin_yaw * down[:, 0] + cos_yaw * down[:, 1]
    from_heading = np.stack([ahead, right, down[:, 2]], axis=-1)

    motion["tilt_offset"] *= response["offset_keep"][:, None]
    setpoint = response["gain"][:, None] * frames.tilt_from_down(from_heading)
    setpoint = setpoint + response["bias"] + motion["tilt_offset"]

    tilt = motion["tilt"]
    rate = motion["tilt_rate"]
    limit = response["max_tilt_rate"][:, None]
    error = tilt - setpoint

    tt, tr, rt, rr = (
        response[name] for name in ("tilt_by_tilt", "tilt_by_rate", "rate_by_tilt", "rate_by_rate")
    )

    moved = np.clip(setpoint + tt * error + tr * rate - tilt, -STEP_S * limit, STEP_S * limit)
    return tilt + moved, np.clip(rt * error + rr * rate, -limit, limit)


def _heading(
    motion: Records, response: Records, commanded: Array
) -> tuple[Array, Array, Array, Array]:
    yaw = motion["yaw"]
    limit = response["max_yaw_rate"]

    rate_setpoint = np.clip(
        response["yaw_p"] * frames.wrap(heading(commanded) - yaw), -limit, limit
    )

    rate_error = rate_setpoint - motion["yaw_rate"]
    torque = response["yaw_rate_p"] * rate_error + motion["yaw_integral"]

    largest = response["max_yaw_torque"]
    grows = np.abs(torque) < largest
    integral = motion["yaw_integral"] + np.where(
        grows, STEP_S * response["yaw_rate_i"] * rate_error, 0.0
    )

    limited = np.clip(torque, -largest, largest)
    filtered = motion["yaw_torque"] + response["yaw_blend"] * (limited - motion["yaw_torque"])
    rate = motion["yaw_rate"] + STEP_S * (filtered - response["yaw_drag"] * motion["yaw_rate"])
    return yaw + STEP_S * rate, rate, filtered, integral


def _lift(
    motion: Records, response: Records, thrust_frac: Array, turning: Bools, draws: Array
) -> Array:
    lagged = motion["thrust"] + response["motor_blend"] * (thrust_frac - motion["thrust"])
    thrust = np.where(turning, lagged, 0.0)
    motion["thrust"] = thrust

    blend = STEP_S / THRUST_NOISE_CORRELATION_S
    motion["thrust_noise"] = (1.0 - blend) * motion["thrust_noise"] + math.sqrt(
        2.0 * blend
    ) * draws[:, 0]

    curve = response["curve"]
    share = motion["lift_scale"] * ((1.0 - curve) * thrust + curve * thrust * thrust)
    share = np.minimum(share, motion["lift_cap"])

    lift = (
        share
        * response["full_lift"]
        * (1.0 + response["thrust_noise_std"] * motion["thrust_noise"])
    )

    motion["lift_share"] = lift / GRAVITY_M_S2
    return np.asarray(lift)


def _move(
    motion: Records, response: Records, lift: Array, air: Array, push: Array, ground: Ground
) -> None:
    down = body_down(motion["attitude"])
    acceleration = (
        -lift[:, None] * down + response["drag"][:, None] * (air - motion["velocity"]) + push
    )

    acceleration[:, 2] += GRAVITY_M_S2
    velocity = motion["velocity"] + STEP_S * acceleration
    position = motion["position"] + STEP_S * velocity

    ground_down = ground_below(motion["position"], ground)
    contact = position[:, 2] >= ground_down
    position[:, 2] = np.where(contact, ground_down, position[:, 2])

    held = contact & motion["on_ground"]
    motion["motors_dead"] |= contact & ~motion["on_ground"] & (down[:, 2] < CRASH_TILT_COS)

    motion["position"] = np.where(held[:, None], motion["position"], position)
    motion["velocity"] = np.where(contact[:, None], 0.0, velocity)
    motion["acceleration"] = np.where(contact[:, None], 0.0, acceleration)
    motion["on_ground"] = contact


def ground_below(position: Array, ground: Ground) -> Array:
    """See :func:`sitl.physics.step.ground_below`; here for all positions (n, 3)."""
    down = np.full(position.shape[0], ground.down)
    if ground.spots.shape[0] == 0:
        return down

    spots = ground.spots[ground.spots[:, 2].argsort()]  # the highest of equally near ones first
    offset = position[:, None] - spots[None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    carries = (distance <= ground.radius) & (offset[..., 2] <= 0.0)
    nearest = np.where(carries, distance, np.inf).argmin(axis=1)
    return np.where(carries.any(axis=1), spots[nearest, 2], down)


def _turn(q: Array, tilt_rate: Array, yaw_rate: Array) -> Array:
    """Attitudes (n, 4) after one step of body rates."""
    half = 0.5 * STEP_S
    spin = np.stack(
        [np.ones_like(yaw_rate), half * tilt_rate[:, 0], half * tilt_rate[:, 1], half * yaw_rate],
        axis=-1,
    )
    turned = frames.multiply(q, spin)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _tilt_of(q: Array, yaw: Array) -> Array:
    """Rotation vectors (n, 2) [rad] of attitudes (n, 4) without their heading."""
    cos_half = np.cos(0.5 * yaw)
    sin_half = np.sin(0.5 * yaw)

    w = cos_half * q[:, 0] + sin_half * q[:, 3]
    x = cos_half * q[:, 1] + sin_half * q[:, 2]
    y = cos_half * q[:, 2] - sin_half * q[:, 1]

    sine = np.hypot(x, y)
    scale = np.where(sine > 1e-9, 2.0 * np.arctan2(sine, w) / np.maximum(sine, 1e-9), 2.0)
    return np.stack([scale * x, scale * y], axis=-1)


def meet(
    motion: Records,
    touched: Bools,
    diameter_m: float,
    wash_m_s2: float,
    wash_spread: float,
    push: Array,
    pairs: NDArray[np.int64],
) -> int:
    """See :func:`sitl.physics.contacts.find_collisions_and_downwash`."""
    half_height_m = 0.5 * diameter_m
    on_ground = motion["on_ground"]

    offset = motion["position"][:, None] - motion["position"][None]
    square = offset[..., 0] ** 2 + offset[..., 1] ** 2
    is_free = ~(on_ground[:, None] & on_ground[None])

    meets = (square < diameter_m**2) & (np.abs(offset[..., 2]) < half_height_m) & is_free & ~touched
    meets = np.triu(meets, k=1)

    touched |= meets
    met = np.argwhere(meets)
    pairs[: met.shape[0]] = met[: pairs.shape[0]]

    gap = np.maximum(offset[..., 2], 0.0)  # of the row below the column
    radius = 0.5 * diameter_m + wash_spread * gap
    fade = np.minimum(1.0, gap / half_height_m) * (diameter_m / (diameter_m + gap)) ** 2

    reaches = is_free & (square <= 9.0 * radius**2)
    strength = wash_m_s2 * motion["lift_share"][None] * fade * np.exp(-square / radius**2)

    push[:] = 0.0
    push[:, 2] = np.where(reaches, strength, 0.0).sum(axis=1)
    return int(met.shape[0])


def advance(
    errors: Records, draws: Array, dt_s: float, position: Array, velocity: Array, yaw_keep: float
) -> None:
    """See :func:`sitl.px4.estimator_errors.advance`."""
    e = errors
    keep = errors["keep"][:, None]
    unit = keep * e["unit_velocity"] + np.sqrt(1.0 - keep * keep) * draws[:, :3]
    e["unit_velocity"] = unit
    e["unit_position"] += dt_s * (e["ratio"] * unit - e["pull"] * e["unit_position"])
    blend = dt_s / BLEND_S
    for name in ("std_position", "std_velocity", "bias"):
        e[name] += blend * (e[f"{name}_goal"] - e[name])
    flying = e["is_flying"][:, None]
    e["drift_velocity"] += dt_s * e["drift_acceleration"] * flying
    e["drift_velocity"] *= (1.0 - dt_s / np.array(DRIFT_DAMPING_S) * flying) * e["is_drifting"][
        :, None
    ]
    grows = flying & (np.abs(e["tilt_error"]) < np.abs(e["tilt_error_most"]))
    grown = e["tilt_error"] * (1.0 + dt_s / TILT_ERROR_GROWTH_S * grows)
    faded = e["tilt_error"] * (1.0 - dt_s / BLEND_S)
    e["tilt_error"] = np.where(e["is_drifting"][:, None], grown, faded)
    e["offset"] += dt_s * e["drift_velocity"]
    e["base"] = position + e["offset"]
    e["position"] = e["base"] + e["bias"] + e["std_position"] * e["unit_position"]
    e["velocity"] = velocity + e["drift_velocity"] + e["std_velocity"] * unit
    lag = e["is_flying"] * (1.0 - yaw_keep)
    e["yaw_smooth"] += lag * (math.sqrt(2.0) * e["yaw_unit"] - e["yaw_smooth"])
    e["yaw_unit"] = (1.0 - lag) * e["yaw_unit"] + np.sqrt(1.0 - (1.0 - lag) ** 2) * draws[:, 3]
    e["yaw_share"] += blend * (e["yaw_share_goal"] - e["yaw_share"])
    compass = e["yaw_mean"] + e["yaw_std"] * e["yaw_smooth"]
    e["yaw_error"] = e["yaw_share"] * compass + (1.0 - e["yaw_share"]) * e["vision_yaw"]
