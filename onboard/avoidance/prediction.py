"""Predicts our own motion over our lag, and a neighbour's motion over the age of its message.

These are lines P1 and P3 of README.md. A command causes its acceleration after the lag L (dead time
plus 2 zeta / wn). So the commands of the last L seconds already determine the motion of the vehicle
until t + L. The law evaluates its rows at t + L. Each vehicle publishes the prediction of its own
motion, and its neighbours extrapolate it to their own t + L. DEVIATION D3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.half_planes import into_disc
from onboard.constants import GRAVITY_M_S2
from onboard.types import Neighbour
from onboard.vectors import ZERO_3, Vec2, Vec3, horizontal_within, is_finite

SLOTS = 40  # number of past commands that are kept
MAX_MESSAGE_AGE_S = 0.30  # extrapolating a silent neighbour for longer than this gains nothing
# the same limit for a neighbour that cooperates, which publishes its prediction
MAX_PREDICTION_AGE_S = 0.80
# Time for which a neighbour's last command counts. With a longer time, two vehicles that react to
# each other's old commands oscillate.
MAX_COMMAND_AGE_S = 0.08
# time for which the estimated acceleration counts, for a neighbour that does not cooperate
MAX_ACCELERATION_AGE_S = 0.25
LONGEST_LEAD_S = 1.0  # a neighbour's longer lead time is reduced to this
# largest error of the configured lag L; twice this error causes violations in every third flight
LAG_ERROR_S = 0.04
# positions, velocities and accelerations beyond this are clipped, so that squares stay finite
LARGEST = 1e5
LARGEST_STD = 1e3  # a larger standard deviation is reduced to this
_MIN_LEAD_S = 1e-3  # a shorter lead time of a neighbour counts as 0; avoids a division by zero


class PastCommand(NamedTuple):
    """One past command of this vehicle."""

    acceleration_enu_m_s2: Vec3
    duration_s: float  # time for which it was held


class Motion(NamedTuple):
    """Position and velocity at one time."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3


_FAR_AWAY = Vec3(math.inf, math.inf, math.inf)
UNKNOWN_MOTION = Motion(_FAR_AWAY, _FAR_AWAY)


class Received(NamedTuple):
    """Horizontal motion of a neighbour, extrapolated to our own time t + L."""

    is_usable: bool  # False: the message holds no finite motion
    position_m: Vec2
    velocity_m_s: Vec2
    command_m_s2: Vec2  # its commanded acceleration; zero if it does not cooperate
    intent_m_s: Vec2  # its intended velocity, or its present one if it does not cooperate
    has_intent: bool  # False: it cooperates, and its message holds no finite intent


def no_commands() -> list[PastCommand]:
    """Return a history without commands, which predicts a constant velocity.

    The list is never modified in place.
    """
    return [PastCommand(ZERO_3, 0.0)] * SLOTS


def remembered(
    commands: list[PastCommand], acceleration_enu_m_s2: Vec3, duration_s: float
) -> list[PastCommand]:
    """Return the history of commands with one more command in front.

    A component of the command that is not finite counts as zero.

    Args:
        commands: the last SLOTS commands, newest first.
        acceleration_enu_m_s2: commanded acceleration without gravity.
        duration_s: time for which it has been held.
    """
    a = acceleration_enu_m_s2
    if not is_finite(a):
        a = Vec3(_finite_or_zero(a.x), _finite_or_zero(a.y), _finite_or_zero(a.z))
    return [PastCommand(a, duration_s), *commands[:-1]]


def _finite_or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def predict_own(
    commands: list[PastCommand], now: Motion, window_s: float, window_z_s: float
) -> Motion:
    """Return our own motion after ``window_s``, under the commands of the last ``window_s`` (P1).

    ``P = p + W v + sum u_k l_k (r_k + l_k / 2)`` and ``V = v + sum u_k l_k``. Here l_k is the time
    for which command k was held inside the window W, and r_k is the time from its end to now. The
    vertical thrust follows the motors, not the attitude, so it has its own, shorter window. The
    rest of W is flown at constant vertical velocity.

    Args:
        commands: past commands, newest first.
        now: position and velocity [m, m/s] of the newest estimate, ENU.
        window_s: lag plus age of the estimate [s].
        window_z_s: the same for the vertical axis [s], at most ``window_s``.
    Properties: translation- and rotation-equivariant; linear in the commands; predicting in two
    steps over two parts of a window gives the same result.
    """
    (p_x, p_y, p_z), (v_x, v_y, v_z) = now
    p_x = p_x + window_s * v_x
    p_y = p_y + window_s * v_y
    p_z = p_z + window_z_s * v_z

    since_end_s = 0.0  # r_k, zero for the newest command
    for (u_x, u_y, u_z), duration_s in commands:
        if since_end_s >= window_s:
            break

        inside_s = min(window_s - since_end_s, duration_s)  # l_k
        weight_s2 = inside_s * (since_end_s + 0.5 * inside_s)
        v_x = v_x + inside_s * u_x
        v_y = v_y + inside_s * u_y
        p_x = p_x + weight_s2 * u_x
        p_y = p_y + weight_s2 * u_y

        inside_z_s = min(max(window_z_s - since_end_s, 0.0), duration_s)
        weight_z_s2 = inside_z_s * (since_end_s + 0.5 * inside_z_s)
        v_z = v_z + inside_z_s * u_z
        p_z = p_z + weight_z_s2 * u_z

        since_end_s += duration_s

    p_z = p_z + (window_s - window_z_s) * v_z
    return Motion(Vec3(p_x, p_y, p_z), Vec3(v_x, v_y, v_z))


def receive(neighbour: Neighbour, own_lead_s: float) -> Received:
    """Return a neighbour's horizontal motion at our own time t + L (line P3). DEVIATION D3, D11.

    A neighbour that cooperates publishes its predicted motion at the end of its own lag. From there
    the motion is extrapolated with the neighbour's command. If the prediction is for a time after
    our own t + L, the motion is extrapolated backwards instead. This uses the mean acceleration
    between the neighbour's plain velocity and its predicted one.

    For any other neighbour, the plain estimate is extrapolated with its acceleration, which is
    clipped to 1 g.

    A command counts for the time by which our lag exceeds the neighbour's, and for at most
    MAX_COMMAND_AGE_S of the message's age. An estimated acceleration counts for at most
    MAX_ACCELERATION_AGE_S. After that time the neighbour is extrapolated at constant velocity.

    Args:
        neighbour: the neighbour as received.
        own_lead_s: how far in the future our own rows are evaluated.
    """
    age_s = message_age(neighbour)
    plain_m_s = horizontal_within(neighbour.velocity_enu_m_s, LARGEST)

    # p, v: motion in the message; a: its acceleration, which counts for at most longest_s
    if has_prediction(neighbour):
        is_usable = True
        lead_s = lead_time(neighbour.lead_time_s, own_lead_s)
        ahead_s = age_s + (own_lead_s - lead_s)
        p = horizontal_within(neighbour.predicted_position_enu_m, LARGEST)
        v = horizontal_within(neighbour.predicted_velocity_enu_m_s, LARGEST)
        command = horizontal_within(neighbour.commanded_acceleration_enu_m_s2, LARGEST)
        a = command
        longest_s = max(own_lead_s - lead_s, 0.0) + MAX_COMMAND_AGE_S
        if ahead_s < 0.0:
            per_lead_1_s = 1.0 / lead_s if lead_s > _MIN_LEAD_S else 0.0
            a = Vec2(per_lead_1_s * (v.x - plain_m_s.x), per_lead_1_s * (v.y - plain_m_s.y))
    else:
        is_usable = is_finite(neighbour.position_enu_m) and is_finite(neighbour.velocity_enu_m_s)
        ahead_s = age_s + own_lead_s
        p = horizontal_within(neighbour.position_enu_m, LARGEST)
        v = plain_m_s
        command = Vec2(0.0, 0.0)
        a = into_disc(horizontal_within(neighbour.acceleration_enu_m_s2, LARGEST), GRAVITY_M_S2)
        longest_s = MAX_ACCELERATION_AGE_S

    # an acceleration for held_s, then none: held_s^2 / 2 + held_s (ahead_s - held_s)
    held_s = min(ahead_s, longest_s)
    weight_s2 = held_s * (ahead_s - 0.5 * held_s)
    position_m = Vec2(p.x + ahead_s * v.x + weight_s2 * a.x, p.y + ahead_s * v.y + weight_s2 * a.y)
    velocity_m_s = Vec2(v.x + held_s * a.x, v.y + held_s * a.y)

    # a neighbour that does not cooperate is expected to keep its velocity
    intent_m_s = velocity_m_s
    has_intent = True
    if neighbour.is_cooperative:
        intent_m_s = horizontal_within(neighbour.intent_enu_m_s, LARGEST)
        has_intent = is_finite(neighbour.intent_enu_m_s)

    return Received(
        is_usable=is_usable,
        position_m=position_m,
        velocity_m_s=velocity_m_s,
        command_m_s2=command,
        intent_m_s=intent_m_s,
        has_intent=has_intent,
    )


def has_prediction(neighbour: Neighbour) -> bool:
    """Whether a neighbour cooperates and says where it will be.

    Args:
        neighbour: the neighbour as received.
    """
    return (
        neighbour.is_cooperative
        and is_finite(neighbour.predicted_position_enu_m)
        and is_finite(neighbour.predicted_velocity_enu_m_s)
        and is_finite(neighbour.commanded_acceleration_enu_m_s2)
    )


def known_std(std: float) -> float:
    """Return a standard deviation, clipped to LARGEST_STD; 0 if it is not known.

    Args:
        std: standard deviation as published.
    """
    return min(abs(std), LARGEST_STD) if math.isfinite(std) else 0.0


def message_age(neighbour: Neighbour) -> float:
    """Return the age of a message [s]. A largest age limits it, and replaces an unknown age.

    Args:
        neighbour: the neighbour as received. The largest age is greater for a neighbour that
            cooperates.
    """
    age_s = neighbour.age_s
    most_s = MAX_PREDICTION_AGE_S if neighbour.is_cooperative else MAX_MESSAGE_AGE_S

    if 0.0 <= age_s <= most_s:
        return age_s
    if age_s < 0.0 and math.isfinite(age_s):
        return 0.0
    return most_s


def lead_time(lead_s: float, own_lead_s: float) -> float:
    """Return a neighbour's lead time [s] within bounds, or our own lead time if it is not known.

    Args:
        lead_s: lead time of the neighbour, as received.
        own_lead_s: lead time of this vehicle.
    """
    if math.isfinite(lead_s):
        return min(max(lead_s, 0.0), LONGEST_LEAD_S)
    return own_lead_s
