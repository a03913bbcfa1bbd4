"""Disturbance observer: what the own commands and the drag do not explain.

A model of the own commands through the attitude lag predicts velocity; what is missing is the disturbance
s_b. Because the model starts from the commands (not from the measured attitude), a static error of the attitude loop
and a tilt bias are part of it. Command ``u - s_b + c V``. The command really sent enters, after all limits, so that
neither saturation nor the avoidance law charges it: that is the baseline's integral action.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onboard.control import kernel_motion
from onboard.types import Array, BoolArray, light


@dataclass(frozen=True, slots=True)
class ObserverParams:
    """Disturbance observer; each a float or (...).

    bandwidth_rad_s: both poles. delay_s, wn_rad_s, zeta: horizontal response to commands. vertical_lag_s: first order.
    drag_1_s. max_disturbance_m_s2: bound per axis. history: ticks of commands kept, longer than the delay.
    """

    bandwidth_rad_s: Array | float = 4.0
    delay_s: float = 0.04
    wn_rad_s: Array | float = 11.0
    zeta: Array | float = 0.6
    vertical_lag_s: Array | float = 0.06
    drag_1_s: Array | float = 0.0
    max_disturbance_m_s2: Array | float = 1.5
    history: int = 8


@light
@dataclass(frozen=True, slots=True)
class ObserverMemory:
    """velocity and disturbance of the observer, response and its rate of the lag model (..., 3).

    commands_enu_m_s2 (..., N, 3): newest first, without gravity.
    """

    velocity_enu_m_s: Array
    disturbance_enu_m_s2: Array
    response_enu_m_s2: Array
    response_rate_enu_m_s3: Array
    commands_enu_m_s2: Array


def initial(velocity_enu_m_s: Array, *, params: ObserverParams) -> ObserverMemory:
    """No disturbance known, moving at (..., 3), commands so far zero."""
    velocity = np.array(velocity_enu_m_s, dtype=np.float64)
    still = np.zeros_like(velocity)
    commands = np.zeros((*velocity.shape[:-1], params.history, 3))
    return ObserverMemory(velocity, still, still, still, commands)


def observe(
    memory: ObserverMemory,
    velocity_enu_m_s: Array,
    command_enu_m_s2: Array,
    *,
    params: ObserverParams,
    dt_s: float,
    is_frozen: BoolArray | bool = False,
) -> ObserverMemory:
    """One tick of x' = a_model - c v + s_b + 2 w (v - x), s_b' = w^2 (v - x).

    Args:
        velocity_enu_m_s: (..., 3) estimated now.
        command_enu_m_s2: (..., 3) acceleration commanded since the last tick, after every limit, without gravity
            (horizontal: what the attitude asks for; vertical: throttle less gravity).
        is_frozen: (...) keeps s_b (on the ground, at lift-off) while the model follows.
    Returns:
        memory; ``disturbance_enu_m_s2`` is s_b: what acts beside the commands and the drag.
    """
    if velocity_enu_m_s.ndim == 1:
        return _observe_one(memory, velocity_enu_m_s, command_enu_m_s2, params, dt_s, bool(is_frozen))
    command = command_enu_m_s2
    if not (np.isfinite(command).all() and np.isfinite(velocity_enu_m_s).all()):
        command = np.where(np.isfinite(command), command, memory.commands_enu_m_s2[..., 0, :])
        velocity_enu_m_s = np.where(np.isfinite(velocity_enu_m_s), velocity_enu_m_s, memory.velocity_enu_m_s)
    commands = np.empty_like(memory.commands_enu_m_s2)
    commands[..., 0, :] = command
    commands[..., 1:, :] = memory.commands_enu_m_s2[..., :-1, :]
    ticks = min(params.delay_s / dt_s, commands.shape[-2] - 1.000001)
    whole = int(ticks)
    delayed = commands[..., whole, :] + (ticks - whole) * (commands[..., whole + 1, :] - commands[..., whole, :])
    # second order by the implicit midpoint rule: stable for every tick length
    wn = np.asarray(params.wn_rad_s, dtype=np.float64)[..., None]
    zeta = np.asarray(params.zeta, dtype=np.float64)[..., None]
    half = 0.5 * dt_s
    push = wn * wn * (delayed - memory.response_enu_m_s2)
    rate = (memory.response_rate_enu_m_s3 + half * push) / (1.0 + 2.0 * half * zeta * wn + half * half * wn * wn)
    response = memory.response_enu_m_s2 + dt_s * rate
    rate = 2.0 * rate - memory.response_rate_enu_m_s3
    blend = 1.0 - np.exp(-dt_s / np.asarray(params.vertical_lag_s, dtype=np.float64))
    response[..., 2] = memory.response_enu_m_s2[..., 2] + blend * (command[..., 2] - memory.response_enu_m_s2[..., 2])
    rate[..., 2] = 0.0
    acting = 0.5 * (response + memory.response_enu_m_s2)
    width = np.asarray(params.bandwidth_rad_s, dtype=np.float64)[..., None]
    drag = np.asarray(params.drag_1_s, dtype=np.float64)[..., None]
    forecast = memory.velocity_enu_m_s + dt_s * (acting - drag * velocity_enu_m_s + memory.disturbance_enu_m_s2)
    miss = velocity_enu_m_s - forecast
    decay = np.exp(-width * dt_s)
    # gains that put both discrete poles on exp(-w T)
    velocity = forecast + (1.0 - decay * decay) * miss
    disturbance = memory.disturbance_enu_m_s2 + ((1.0 - decay) ** 2 / dt_s) * miss
    bound = np.asarray(params.max_disturbance_m_s2, dtype=np.float64)[..., None]
    disturbance = np.minimum(np.maximum(disturbance, -bound), bound)
    if np.any(is_frozen):
        frozen = np.asarray(is_frozen)[..., None]
        disturbance = np.where(frozen, memory.disturbance_enu_m_s2, disturbance)
        velocity = np.where(frozen, velocity_enu_m_s, velocity)
    return ObserverMemory(velocity, disturbance, response, rate, commands)


def _observe_one(
    memory: ObserverMemory, velocity_enu_m_s: Array, command_enu_m_s2: Array, params: ObserverParams, dt_s: float,
    is_frozen: bool,
) -> ObserverMemory:  # fmt: skip
    """:func:`observe` for one vehicle, in floats."""
    seen, disturbance = memory.velocity_enu_m_s.tolist(), memory.disturbance_enu_m_s2.tolist()
    response, rate = memory.response_enu_m_s2.tolist(), memory.response_rate_enu_m_s3.tolist()
    velocity, command = velocity_enu_m_s.tolist(), command_enu_m_s2.tolist()
    if not all(map(math.isfinite, (*velocity, *command))):
        before = memory.commands_enu_m_s2[0].tolist()
        command = [new if math.isfinite(new) else old for new, old in zip(command, before, strict=True)]
        velocity = [new if math.isfinite(new) else old for new, old in zip(velocity, seen, strict=True)]
    commands = np.empty_like(memory.commands_enu_m_s2)
    commands[0] = command
    commands[1:] = memory.commands_enu_m_s2[:-1]
    ticks = min(params.delay_s / dt_s, len(commands) - 1.000001)
    whole = int(ticks)
    newer, older = commands[whole : whole + 2].tolist()
    decay, drag = math.exp(-float(params.bandwidth_rad_s) * dt_s), float(params.drag_1_s)
    gains = (1.0 - decay * decay, (1.0 - decay) * (1.0 - decay) / dt_s, drag, float(params.max_disturbance_m_s2))
    model = (float(params.wn_rad_s), float(params.zeta))
    axes = [
        kernel_motion.responded(
            velocity[k],
            (seen[k], disturbance[k], response[k], rate[k]),
            newer[k] + (ticks - whole) * (older[k] - newer[k]),
            model,
            gains,
            dt_s,
        )
        for k in (0, 1)
    ]
    lifted = response[2] + (1.0 - math.exp(-dt_s / float(params.vertical_lag_s))) * (command[2] - response[2])
    acting = 0.5 * (lifted + response[2])
    axes.append((*kernel_motion.observed(velocity[2], seen[2], disturbance[2], acting, gains, dt_s), lifted, 0.0))
    after = np.array(axes).T
    if is_frozen:
        after[0], after[1] = velocity, disturbance
    return ObserverMemory(after[0], after[1], after[2], after[3], commands)
