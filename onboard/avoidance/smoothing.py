"""Keeps the fast part of the own estimate's noise out of the own prediction.

The gains of the law would pass this noise on to the command. So the prediction of the last tick,
moved on to now, is corrected towards the prediction from the newest estimate: line P1 of README.md,
DEVIATION D17. Only the horizontal motion is smoothed.

The estimate of a mocap is accurate, and smoothed for some hundredths of a second. An estimate from
vision or satellites is rough. It is smoothed for longer, so the last prediction has to be moved on
as the vehicle really accelerates, and the position has to correct the velocity.
"""

from __future__ import annotations

import math

from onboard.avoidance.half_planes import into_disc
from onboard.avoidance.prediction import Motion, PastCommand, known_std, predict_own
from onboard.types import State
from onboard.vectors import ZERO_3, Vec2, Vec3, is_finite

# Time constant of an accurate estimate's smoothing, for each m/s of the velocity's standard
# deviation.
_SMOOTHING_S2_M = 0.6
_LONGEST_SMOOTHING_S = 0.15
# An estimate is rough from this standard deviation of the position on.
_ROUGH_STD_M = 0.03
# Gains of the filter for a rough estimate: time constants of position and velocity, and how fast
# the velocity follows a difference of the positions. Without the last one, an error of the velocity
# that lasts for a second is believed for as long.
_POSITION_TIME_S = 0.2
_VELOCITY_TIME_S = 0.7
_VELOCITY_BY_POSITION_1_S2 = 4.0

_LARGEST_STDS = 2.0  # largest difference between smoothed and newest motion [std]
_AT_REST = Motion(ZERO_3, ZERO_3)


def smoothed(
    predicted: Motion,
    last: Motion,
    commands: list[PastCommand],
    state: State,
    window_s: float,
    dt_s: float,
) -> Motion:
    """Return the own prediction without the fast part of the estimate's noise.

    The result differs from the new prediction by few standard deviations at most, so it follows a
    jump of the estimate at once. An exact estimate is not smoothed.

    Args:
        predicted: prediction from the newest estimate.
        last: prediction of the last tick; not finite: none yet.
        commands: past commands, newest first.
        state: newest estimate, with its acceleration and its standard deviations.
        window_s: time over which the motion is predicted, lag plus age of the estimate [s].
        dt_s: time since the last tick.
    """
    if not is_finite(last.position_enu_m) or not is_finite(last.velocity_enu_m_s):
        return predicted
    if dt_s <= 0.0 or known_std(state.velocity_std_m_s) <= 0.0:
        return predicted

    newest = [PastCommand(commands[0].acceleration_enu_m_s2, dt_s)]
    expected = predict_own(newest, last, dt_s, dt_s)
    if known_std(state.position_std_m) < _ROUGH_STD_M:
        return _accurate(predicted, expected, state, dt_s)

    as_flown = _as_flown(expected, commands, state, window_s, dt_s)
    return _rough(predicted, as_flown, state, window_s, dt_s)


def _accurate(predicted: Motion, expected: Motion, state: State, dt_s: float) -> Motion:
    """Return the smoothed prediction of an accurate estimate.

    The time constant is proportional to the velocity's standard deviation.
    """
    velocity_std_m_s = known_std(state.velocity_std_m_s)
    time_s = min(_SMOOTHING_S2_M * velocity_std_m_s, _LONGEST_SMOOTHING_S)
    kept = math.exp(-dt_s / time_s)
    limit_m = _LARGEST_STDS * known_std(state.position_std_m)
    limit_m_s = _LARGEST_STDS * velocity_std_m_s
    return Motion(
        moved_towards(predicted.position_enu_m, expected.position_enu_m, kept, limit_m),
        moved_towards(predicted.velocity_enu_m_s, expected.velocity_enu_m_s, kept, limit_m_s),
    )


def _rough(
    predicted: Motion, expected: Motion, state: State, window_s: float, dt_s: float
) -> Motion:
    """Return the prediction of a rough estimate, from a filter with constant gains."""
    # without the way over the window, so that an error of the velocity is not one of the position
    p = _at_begin(predicted, window_s)
    p_expected = _at_begin(expected, window_s)
    v = predicted.velocity_enu_m_s
    v_expected = expected.velocity_enu_m_s

    limit_m = _LARGEST_STDS * known_std(state.position_std_m)
    limit_m_s = _LARGEST_STDS * known_std(state.velocity_std_m_s)
    position = moved_towards(p, p_expected, math.exp(-dt_s / _POSITION_TIME_S), limit_m)
    velocity = moved_towards(v, v_expected, math.exp(-dt_s / _VELOCITY_TIME_S), limit_m_s)

    # a vehicle that is farther than expected has been faster
    farther = into_disc(Vec2(p.x - p_expected.x, p.y - p_expected.y), limit_m)
    gain_1_s = _VELOCITY_BY_POSITION_1_S2 * dt_s
    v_x = velocity.x + gain_1_s * farther.x
    v_y = velocity.y + gain_1_s * farther.y
    return Motion(
        Vec3(position.x + window_s * v_x, position.y + window_s * v_y, predicted.position_enu_m.z),
        Vec3(v_x, v_y, v.z),
    )


def _at_begin(motion: Motion, window_s: float) -> Vec3:
    """Return the position of a motion less the way that its velocity makes over the window."""
    p = motion.position_enu_m
    v = motion.velocity_enu_m_s
    return Vec3(p.x - window_s * v.x, p.y - window_s * v.y, p.z)


def _as_flown(
    expected: Motion, commands: list[PastCommand], state: State, window_s: float, dt_s: float
) -> Motion:
    """Return the expected prediction, corrected by how the vehicle has really accelerated.

    The prediction of the last tick assumed the command of that time. Without this correction, an
    error of the configured lag, or a gust, would add up for as long as the estimate is smoothed.

    Args:
        expected: prediction of the last tick, moved on by the newest command.
        commands: past commands, newest first.
        state: newest estimate, with the acceleration that the vehicle now has.
        window_s: time over which the motion is predicted [s].
        dt_s: time since the last tick.
    """
    flown = state.acceleration_enu_m_s2
    if not is_finite(flown):
        return expected

    # the change of velocity that the last prediction assumed for the tick that has been flown
    longer = predict_own(commands, _AT_REST, window_s + dt_s, 0.0).velocity_enu_m_s
    shorter = predict_own(commands, _AT_REST, window_s, 0.0).velocity_enu_m_s
    change_x = dt_s * flown.x - (longer.x - shorter.x)
    change_y = dt_s * flown.y - (longer.y - shorter.y)

    p = expected.position_enu_m
    v = expected.velocity_enu_m_s
    weight_s = window_s + 0.5 * dt_s
    return Motion(
        Vec3(p.x + weight_s * change_x, p.y + weight_s * change_y, p.z),
        Vec3(v.x + change_x, v.y + change_y, v.z),
    )


def moved_towards(value: Vec3, expected: Vec3, share: float, longest: float) -> Vec3:
    """Return a vector moved horizontally by a share of its difference from an expected vector.

    Args:
        value, expected: the vectors.
        share: from 0 to 1.
        longest: a longer difference is shortened to this length first.
    """
    change = into_disc(Vec2(expected.x - value.x, expected.y - value.y), longest)
    return Vec3(value.x + share * change.x, value.y + share * change.y, value.z)
