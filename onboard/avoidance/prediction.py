"""Prediction over the own attitude lag, and of the neighbours over the age of their messages.

Between a command and the acceleration it causes lies the lag L (dead time plus 2 zeta / wn). What the vehicle will do
until t + L is therefore known: it is what was commanded during the last L seconds. The law evaluates its rows there,
and the neighbours publish the same about themselves. Lines P1 to P3 of the design; all by time, not by whole ticks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onboard.avoidance.kernels import MAX_COMMAND_AGE_S
from onboard.avoidance.kernels import MAX_MESSAGE_AGE_S as MAX_MESSAGE_AGE_S
from onboard.control import kernel_motion
from onboard.rollout import compiled
from onboard.types import Array, State, light

SLOTS = 40


@light
@dataclass(frozen=True, slots=True)
class CommandHistory:
    """Own past commands, newest first: acceleration_enu_m_s2 (..., B, 3), held for duration_s (..., B)."""

    acceleration_enu_m_s2: Array
    duration_s: Array


def initial(batch_shape: tuple[int, ...]) -> CommandHistory:
    """A history without commands: prediction is then at constant velocity."""
    return CommandHistory(np.zeros((*batch_shape, SLOTS, 3)), np.zeros((*batch_shape, SLOTS)))


def record(history: CommandHistory, command_enu_m_s2: Array, duration_s: float) -> CommandHistory:
    """History after ``command`` (..., 3) has been held for ``duration_s``; what is not finite counts as zero."""
    command = command_enu_m_s2
    if not np.isfinite(command).all():
        command = np.where(np.isfinite(command), command, 0.0)
    acceleration = np.empty_like(history.acceleration_enu_m_s2)
    acceleration[..., 1:, :] = history.acceleration_enu_m_s2[..., :-1, :]
    acceleration[..., 0, :] = command
    duration = np.empty_like(history.duration_s)
    duration[..., 1:] = history.duration_s[..., :-1]
    duration[..., 0] = duration_s
    return CommandHistory(acceleration, duration)


def predict_own(
    history: CommandHistory, position_enu_m: Array, velocity_enu_m_s: Array, window_s: Array
) -> tuple[Array, Array]:
    """State after ``window_s`` (...) under the commands of the last ``window_s`` seconds.

    Line P1: ``P = p + W v + sum u_k l_k (r_k + l_k / 2)``, ``V = v + sum u_k l_k``; l_k is the part of command k inside
    the window and r_k the time left after it.

    Args:
        position_enu_m, velocity_enu_m_s: (..., 3), valid ``age`` seconds ago.
        window_s: (...) lag plus age of the estimate.
    Properties: translation- and rotation-equivariant; linear in the commands; a window cut in two gives the same.
    """
    duration = history.duration_s
    end_back = np.cumsum(duration, axis=-1)
    left = end_back - duration
    inside = np.minimum(np.maximum(window_s[..., None] - left, 0.0), duration)
    weight = inside * (left + 0.5 * inside)
    commands = history.acceleration_enu_m_s2
    with np.errstate(invalid="ignore", over="ignore"):  # a state that is no number stays none, and the law says so
        moved = position_enu_m + window_s[..., None] * velocity_enu_m_s
    velocity = velocity_enu_m_s + np.einsum("...b,...bc->...c", inside, commands)
    return moved + np.einsum("...b,...bc->...c", weight, commands), velocity


def predict_one(history: CommandHistory, state: State, lag_s: float, vertical_lag_s: float) -> tuple[Array, Array]:
    """Own state over the lag, the vertical axis over its own and then straight on, for one vehicle, in floats."""
    shape = state.position_enu_m.shape
    age = float(state.age_s.reshape(()))
    age = 0.0 if math.isnan(age) else min(max(age, 0.0), MAX_MESSAGE_AGE_S)
    durations = history.duration_s.ravel().tolist()
    count, covered = 0, 0.0
    while count < len(durations) and covered < lag_s + age:
        covered += durations[count]
        count += 1
    position, velocity = kernel_motion.predicted(
        history.acceleration_enu_m_s2[..., :count, :].ravel().tolist(),
        durations[:count],
        state.position_enu_m.ravel().tolist(),
        state.velocity_enu_m_s.ravel().tolist(),
        lag_s + age,
        vertical_lag_s + age,
        lag_s - vertical_lag_s,
    )
    return np.array(position).reshape(shape), np.array(velocity).reshape(shape)


def predict_batch(
    history: CommandHistory, state: State, age_s: Array, lag_s: float, vertical_lag_s: float
) -> tuple[Array, Array]:
    """:func:`predict_one` for a batch, compiled; age_s (...), already bounded."""
    size, slots = age_s.size, history.duration_s.shape[-1]
    out = compiled.predicted_batch(
        compiled.flat(history.acceleration_enu_m_s2, size, 3 * slots),
        compiled.flat(history.duration_s, size, slots),
        compiled.flat(state.position_enu_m, size, 3),
        compiled.flat(state.velocity_enu_m_s, size, 3),
        np.stack([age_s + lag_s, age_s + vertical_lag_s], axis=-1).reshape(size, 2),
        lag_s - vertical_lag_s,
    ).reshape(*age_s.shape, 6)
    return out[..., :3], out[..., 3:]


def predict_neighbour(
    position_enu_m: Array,
    velocity_enu_m_s: Array,
    command_enu_m_s2: Array,
    plain_velocity_enu_m_s: Array,
    age_s: Array,
    lead_time_s: Array,
    own_lead_time_s: float,
) -> tuple[Array, Array]:
    """Neighbour's predicted state (..., K, C) carried to our own ``t + L``, line P3.

    It was predicted to its own ``t_j + L_j``. What is missing from there is flown with its command, as long as that
    says something, then straight on. A neighbour that leads by more than we do is taken back along the way that it
    predicts from its plain velocity.

    Args:
        age_s, lead_time_s: (..., K) of its message, and its L_j. own_lead_time_s: our L.
    """
    age = np.minimum(np.maximum(age_s, 0.0), MAX_MESSAGE_AGE_S)
    ahead = age + (own_lead_time_s - lead_time_s)
    held = np.minimum(np.maximum(ahead, 0.0), MAX_COMMAND_AGE_S)
    back = np.minimum(ahead, 0.0)
    has_lead = lead_time_s > 1e-3
    mean = np.where(has_lead[..., None], velocity_enu_m_s - plain_velocity_enu_m_s, 0.0)
    mean = mean / np.where(has_lead, lead_time_s, 1.0)[..., None]
    position = position_enu_m + ahead[..., None] * velocity_enu_m_s
    position = position + (held * (ahead - 0.5 * held))[..., None] * command_enu_m_s2
    position = position + (0.5 * back * back)[..., None] * mean
    return position, velocity_enu_m_s + held[..., None] * command_enu_m_s2 + back[..., None] * mean
