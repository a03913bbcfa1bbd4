"""Bounds of the law's performance, in closed form or by small linear algebra. Pure functions.

The checks of this room fill in a fleet's values and add the sentences. The constants of the margin
are a fit over simulated flights (23 settings, 84 flights each), not a theorem: a design distance of
``d_inf + 0.05 m + 4.5 sigma_d``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onboard.estimation.accuracies import Accuracy
from onboard.types import GRAVITY_M_S2, TICK_S

# states that are older than the first require the second for each further second of age
USUAL_AGE_S = 0.16
AGE_MARGIN_M_S = 0.5

# largest throttle that is ever sent
MAX_THRUST_FRAC = 0.97

# the fit of the margin: floor + sigmas * sigma_d
_MARGIN_FLOOR_M = 0.05
_MARGIN_SIGMAS = 4.5

# Euler steps of the vehicle's response in one tick
_SUBSTEPS = 4


def distance_spread_m(accuracy: Accuracy, kappa_1_1_s: float, kappa_2_1_s: float) -> float:
    """Return the standard deviation of a pair's distance that the errors of both estimates cause.

    Each error passes the second-order filter of the law's row; Phi(tau) is its gain for an error of
    correlation time tau. See docs/check.md.

    Args:
        accuracy: of both vehicles' estimates.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    Returns:
        sigma_d [m].
    """
    # the row's characteristic polynomial is s^2 + a_1 s + a_0
    a_1 = kappa_1_1_s + kappa_2_1_s
    a_0 = kappa_1_1_s * kappa_2_1_s

    def _phi(time_s: float) -> float:
        return (a_1 + 1.0 / time_s) / (a_0 * a_1 * (1.0 / time_s**2 + a_1 / time_s + a_0))

    variance_m2 = (
        (a_1 * accuracy.velocity_std_m_s) ** 2 * _phi(accuracy.velocity_time_s)
        + (a_0 * accuracy.position_std_m) ** 2 * _phi(accuracy.position_time_s)
        + accuracy.acceleration_std_m_s2**2 * _phi(accuracy.acceleration_time_s)
    )

    # the errors of the two vehicles are independent
    return math.sqrt(2.0 * variance_m2)


def required_margin_m(accuracy: Accuracy, kappa_1_1_s: float, kappa_2_1_s: float) -> float:
    """Return the margin that the law requires between safety distance and design distance.

    Args:
        accuracy: of both vehicles' estimates.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    Returns:
        margin [m], from the fit over simulated flights.
    """
    return _MARGIN_FLOOR_M + _MARGIN_SIGMAS * distance_spread_m(accuracy, kappa_1_1_s, kappa_2_1_s)


def row_range_m(
    closing_speed_m_s: float, distance_m: float, kappa_1_1_s: float, kappa_2_1_s: float
) -> float:
    """Return the distance at which a row begins to brake two vehicles that close head-on.

    Args:
        closing_speed_m_s: of both together.
        distance_m: design distance d.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    Returns:
        distance between centres [m]; each must know of the other by then.
    """
    v = closing_speed_m_s
    s = kappa_1_1_s + kappa_2_1_s
    q = kappa_1_1_s * kappa_2_1_s

    discriminant = s * s * v * v - q * (2.0 * v * v - q * distance_m**2)
    return (s * v + math.sqrt(max(0.0, discriminant))) / q


def braking_m_s2(
    closing_speed_m_s: float, distance_m: float, kappa_1_1_s: float, kappa_2_1_s: float
) -> float:
    """Return the largest acceleration of two vehicles that meet head-on and share the braking.

    The two are simulated from the distance at which the row begins to brake until they rest.

    Args:
        closing_speed_m_s: of both together.
        distance_m: design distance d.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    Returns:
        acceleration [m/s^2] of one vehicle.
    """
    s = kappa_1_1_s + kappa_2_1_s
    q = kappa_1_1_s * kappa_2_1_s

    gap_m = row_range_m(closing_speed_m_s, distance_m, kappa_1_1_s, kappa_2_1_s)
    gap_rate_m_s = -closing_speed_m_s

    dt_s = 0.002
    largest_m_s2 = 0.0
    for _ in range(2000):
        missing = (
            -gap_rate_m_s * gap_rate_m_s
            - s * gap_m * gap_rate_m_s
            - 0.5 * q * (gap_m * gap_m - distance_m**2)
        )
        required_m_s2 = max(0.0, missing / gap_m)
        largest_m_s2 = max(largest_m_s2, required_m_s2)

        gap_rate_m_s += dt_s * required_m_s2
        gap_m += dt_s * gap_rate_m_s
        if gap_rate_m_s > -0.01:
            break

    return 0.5 * largest_m_s2


def largest_equal_kappa_1_s(lag_s: float) -> float:
    """Return the largest kappa_1 = kappa_2 that does not overshoot behind an unpredicted lag.

    Args:
        lag_s: from command to acceleration.
    Returns:
        4 / (27 lag) [1/s].
    """
    return 4.0 / (27.0 * max(lag_s, 1e-6))


@dataclass(frozen=True, slots=True)
class Response:
    """Response from a command to the acceleration: dead time, then second order."""

    delay_s: float  # dead time
    wn_rad_s: float  # natural frequency of the second order
    zeta: float  # its damping ratio

    @property
    def lag_s(self) -> float:
        """Lag L to first order [s]: dead time + 2 zeta / wn."""
        return self.delay_s + 2.0 * self.zeta / self.wn_rad_s


def loop_growth_1_s(
    response: Response,
    kappa_1_1_s: float,
    kappa_2_1_s: float,
    *,
    lag_error_s: float = 0.0,
    is_predicted: bool = True,
) -> float:
    """Return the growth rate of the slowest-dying motion of a distance row that is always active.

    Model: one axis, sampled at 50 Hz; the row is evaluated at the state predicted over L with the
    own past commands, and the acceleration follows through dead time and second order. The matrix
    of one tick is found by flying each unit state for one tick; its largest eigenvalue is the
    growth in that tick.

    Args:
        response: of the vehicle, as configured.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
        lag_error_s: by so much the vehicle is slower than configured; negative: faster.
        is_predicted: whether the law predicts over the lag.
    Returns:
        growth rate [1/s]; negative if every motion dies out.
    """
    # the real vehicle: the configured response, stretched in time
    stretch = max(0.05, (response.lag_s + lag_error_s) / response.lag_s)
    delay_s = response.delay_s * stretch
    wn = response.wn_rad_s / stretch

    # the law predicts over the configured lag, not over the real one
    window_s = 0.0
    if is_predicted:
        window_s = response.lag_s
    slots = math.ceil(max(window_s, delay_s) / TICK_S) + 2

    # one row per unit state: distance, rate, acceleration, its rate, commands newest first
    state = np.eye(4 + slots)
    y = state[:, 0]
    v = state[:, 1]
    a = state[:, 2]
    jerk = state[:, 3]
    past = state[:, 4:]

    # the prediction: each past command acts for the part of its tick that lies in the window
    left_s = TICK_S * np.arange(slots)
    inside_s = np.clip(window_s - left_s, 0.0, TICK_S)
    ahead_v = v + past @ inside_s
    ahead_y = y + window_s * v + past @ (inside_s * (left_s + 0.5 * inside_s))

    # the row at the predicted state
    command = -(kappa_1_1_s + kappa_2_1_s) * ahead_v - kappa_1_1_s * kappa_2_1_s * ahead_y
    past = np.concatenate([command[:, None], past], axis=1)

    # the vehicle follows for one tick
    step_s = TICK_S / _SUBSTEPS
    for index in range(_SUBSTEPS):
        slot = max(0, math.ceil((delay_s - index * step_s) / TICK_S - 1e-9))
        delayed = past[:, slot]
        jerk = jerk + step_s * (wn * wn * (delayed - a) - 2.0 * response.zeta * wn * jerk)
        a = a + step_s * jerk
        y = y + step_s * v + 0.5 * step_s * step_s * a
        v = v + step_s * a

    after = np.concatenate([np.stack([y, v, a, jerk], axis=1), past[:, :slots]], axis=1)
    growth_of_a_tick = float(np.abs(np.linalg.eigvals(after)).max())
    return math.log(max(growth_of_a_tick, 1e-9)) / TICK_S


def available_acceleration_m_s2(max_tilt_deg: float, hover_thrust_frac: float) -> float:
    """Return the horizontal acceleration that is available while the height is kept.

    Args:
        max_tilt_deg: largest tilt.
        hover_thrust_frac: throttle at which the vehicle hovers.
    Returns:
        acceleration [m/s^2], limited by tilt or by the throttle left beside the weight.
    """
    by_tilt_m_s2 = GRAVITY_M_S2 * math.tan(math.radians(max_tilt_deg))

    # the full thrust is the hypotenuse, the weight its vertical part
    ratio = MAX_THRUST_FRAC / hover_thrust_frac
    by_throttle_m_s2 = GRAVITY_M_S2 * math.sqrt(max(0.0, ratio * ratio - 1.0))

    return min(by_tilt_m_s2, by_throttle_m_s2)


def delay_margin_m(age_s: float) -> float:
    """Return the margin that old states require beside the one for the errors of the estimates.

    A fit over simulated flights (swap16x and swap8 with 100 to 300 ms of delay and 30 % lost), not
    a theorem.

    Args:
        age_s: that a neighbour's newest state reaches.
    Returns:
        margin [m]; 0 up to :data:`USUAL_AGE_S`.
    """
    return AGE_MARGIN_M_S * max(0.0, age_s - USUAL_AGE_S)


def stopping_distance_m(speed_m_s: float, acceleration_m_s2: float, reaction_s: float) -> float:
    """Return the distance flown until rest: reaction at full speed, then braking.

    Args:
        speed_m_s: at first.
        acceleration_m_s2: of braking.
        reaction_s: time before it brakes.
    Returns:
        distance [m].
    """
    reaction_m = speed_m_s * reaction_s
    braking_m = speed_m_s**2 / (2.0 * max(acceleration_m_s2, 1e-6))
    return reaction_m + braking_m
