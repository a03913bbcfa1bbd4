"""Bounds of the law's performance, in closed form or by small linear algebra. Pure functions.

The checks of this package call these functions with a fleet's values, and add the sentences.

The margin between the safety distance d_inf and the design distance is ``0.05 m + 5 sigma_d``.
Sigma_d is the standard deviation of a pair's distance. The constants come from simulated flights,
not from a theorem. A fit over 23 settings with 84 flights each gave 4.5 sigma_d, and crowds with
vision need 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onboard.avoidance.params import MARGIN_FLOOR_M, MARGIN_SIGMAS
from onboard.constants import GRAVITY_M_S2, MAX_PLANNED_THRUST_FRAC
from onboard.estimation.accuracies import Accuracy
from onboard.types import TICK_S

USUAL_AGE_S = 0.16  # states up to this age require no further margin
AGE_MARGIN_M_S = 1.0  # further margin for each second of age beyond USUAL_AGE_S

_SUBSTEPS = 4  # number of Euler steps of the vehicle's response in one tick

# simulation of two vehicles that brake
_BRAKING_STEP_S = 0.002
_BRAKING_STEPS = 2000  # largest number of steps
_STOPPED_M_S = 0.01  # below this closing speed, the vehicles have stopped


def distance_spread_m(accuracy: Accuracy, kappa_1_1_s: float, kappa_2_1_s: float) -> float:
    """Return the standard deviation sigma_d [m] of a pair's distance, from the estimates' errors.

    Each error passes the second-order filter of the law's row. Phi(tau) is the filter's gain for an
    error with the correlation time tau. See docs/check.md.

    Args:
        accuracy: accuracy of both vehicles' estimates.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
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
    """Return the margin [m] that the law requires between safety distance and design distance.

    Args:
        accuracy: accuracy of both vehicles' estimates.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    """
    return MARGIN_FLOOR_M + MARGIN_SIGMAS * distance_spread_m(accuracy, kappa_1_1_s, kappa_2_1_s)


def required_obstacle_margin_m(accuracy: Accuracy, kappa_1_1_s: float, kappa_2_1_s: float) -> float:
    """Return the margin [m] that an estimate requires between a vehicle's hull and an obstacle.

    It is :func:`required_margin_m` with the errors of one estimate, because obstacles stand still.

    Args:
        accuracy: accuracy of the vehicle's estimate.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    """
    spread_m = distance_spread_m(accuracy, kappa_1_1_s, kappa_2_1_s) / math.sqrt(2.0)
    return MARGIN_FLOOR_M + MARGIN_SIGMAS * spread_m


def row_range_m(
    closing_speed_m_s: float, distance_m: float, kappa_1_1_s: float, kappa_2_1_s: float
) -> float:
    """Return the distance at which a row begins to brake two vehicles that close head-on.

    Args:
        closing_speed_m_s: sum of both speeds.
        distance_m: design distance d.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    Returns:
        Distance between centres [m]. The vehicles must know each other at this distance.
    """
    v = closing_speed_m_s
    s = kappa_1_1_s + kappa_2_1_s
    q = kappa_1_1_s * kappa_2_1_s

    # the larger root r of q/2 r^2 - s v r + v^2 - q/2 d^2 = 0, beyond which no braking is required
    discriminant = s * s * v * v - q * (2.0 * v * v - q * distance_m**2)
    return (s * v + math.sqrt(max(0.0, discriminant))) / q


def braking_m_s2(
    closing_speed_m_s: float, distance_m: float, kappa_1_1_s: float, kappa_2_1_s: float
) -> float:
    """Return the largest deceleration [m/s^2] of each of two vehicles that meet head-on.

    The approach is simulated from the distance at which the row begins to brake, until the vehicles
    stop. Each vehicle does half of the braking.

    Args:
        closing_speed_m_s: sum of both speeds.
        distance_m: design distance d.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
    """
    s = kappa_1_1_s + kappa_2_1_s
    q = kappa_1_1_s * kappa_2_1_s

    gap_m = row_range_m(closing_speed_m_s, distance_m, kappa_1_1_s, kappa_2_1_s)
    gap_rate_m_s = -closing_speed_m_s

    dt_s = _BRAKING_STEP_S
    largest_m_s2 = 0.0
    for _ in range(_BRAKING_STEPS):
        # The row requires gap * acceleration >= bound. So (gap^2 - d^2) / 2 decays with the rates
        # kappa_1 and kappa_2.
        bound = (
            -gap_rate_m_s * gap_rate_m_s
            - s * gap_m * gap_rate_m_s
            - 0.5 * q * (gap_m * gap_m - distance_m**2)
        )
        required_m_s2 = max(0.0, bound / gap_m)
        largest_m_s2 = max(largest_m_s2, required_m_s2)

        gap_rate_m_s += dt_s * required_m_s2
        gap_m += dt_s * gap_rate_m_s
        if gap_rate_m_s > -_STOPPED_M_S:
            break

    return 0.5 * largest_m_s2


def largest_equal_kappa_1_s(lag_s: float) -> float:
    """Return the largest kappa_1 = kappa_2 without overshoot and prediction: 4 / (27 lag) [1/s].

    Args:
        lag_s: lag from command to acceleration.
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
    """Return the largest growth rate [1/s] of a motion under a distance row that is always active.

    The rate is negative if every motion decays. The model is one axis, sampled at 50 Hz. The law
    predicts the state over the configured lag with the vehicle's past commands, and evaluates the
    row there. The acceleration follows the row's command with a dead time and a second-order
    response. Simulating one tick from each unit state gives the matrix of a tick. Its spectral
    radius is the growth per tick.

    Args:
        response: configured response of the vehicle.
        kappa_1_1_s: gain kappa_1 of the law [1/s].
        kappa_2_1_s: gain kappa_2 of the law [1/s].
        lag_error_s: real lag minus configured lag.
        is_predicted: whether the law predicts over the lag.
    """
    # the real vehicle: the configured response, stretched in time
    stretch = max(0.05, (response.lag_s + lag_error_s) / response.lag_s)
    delay_s = response.delay_s * stretch
    wn = response.wn_rad_s / stretch

    # a response that is quicker than the steps of this model cannot be told from one as quick
    step_s = TICK_S / _SUBSTEPS
    wn = min(wn, 1.0 / (step_s * max(1.0, 2.0 * response.zeta)))

    # the law predicts over the configured lag, not over the real one
    window_s = 0.0
    if is_predicted:
        window_s = response.lag_s
    slots = math.ceil(max(window_s, delay_s) / TICK_S) + 2  # past commands; two are a reserve

    # One row per unit state. Columns: distance, its rate, acceleration, its rate, and then the past
    # commands, the newest first.
    state = np.eye(4 + slots)
    y = state[:, 0]
    v = state[:, 1]
    a = state[:, 2]
    jerk = state[:, 3]
    past = state[:, 4:]

    # the prediction: each past command acts for the part of its tick that lies in the window
    left_s = TICK_S * np.arange(slots)  # time from the end of that tick to the end of the window
    inside_s = np.clip(window_s - left_s, 0.0, TICK_S)
    ahead_v = v + past @ inside_s
    ahead_y = y + window_s * v + past @ (inside_s * (left_s + 0.5 * inside_s))

    # the row at the predicted state
    command = -(kappa_1_1_s + kappa_2_1_s) * ahead_v - kappa_1_1_s * kappa_2_1_s * ahead_y
    past = np.concatenate([command[:, None], past], axis=1)

    # the vehicle responds for one tick
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
    """Return the horizontal acceleration [m/s^2] that is available while the height is kept.

    It is limited by the tilt, or by the throttle that remains after carrying the weight.

    Args:
        max_tilt_deg: largest tilt.
        hover_thrust_frac: throttle at which the vehicle hovers.
    """
    by_tilt_m_s2 = GRAVITY_M_S2 * math.tan(math.radians(max_tilt_deg))

    # full thrust is the hypotenuse, and the weight is its vertical component
    ratio = MAX_PLANNED_THRUST_FRAC / hover_thrust_frac
    by_throttle_m_s2 = GRAVITY_M_S2 * math.sqrt(max(0.0, ratio * ratio - 1.0))

    return min(by_tilt_m_s2, by_throttle_m_s2)


def delay_margin_m(age_s: float) -> float:
    """Return the margin [m] for old states, in addition to the margin for the estimates' errors.

    The margin is 0 up to :data:`USUAL_AGE_S`. It is a fit to simulated flights, not a theorem.

    Args:
        age_s: largest age of a neighbour's newest state.
    """
    return AGE_MARGIN_M_S * max(0.0, age_s - USUAL_AGE_S)


def stopping_distance_m(speed_m_s: float, acceleration_m_s2: float, reaction_s: float) -> float:
    """Return the stopping distance [m]: the reaction at full speed, then the braking.

    Args:
        speed_m_s: initial speed.
        acceleration_m_s2: deceleration of the braking.
        reaction_s: time before the braking begins.
    """
    reaction_m = speed_m_s * reaction_s
    braking_m = speed_m_s**2 / (2.0 * max(acceleration_m_s2, 1e-6))
    return reaction_m + braking_m
