"""Parameters of a vehicle from a short flight: hover thrust, tilt error, drag and lag. Pure.

There are two fits:

* Attitude (``attitude_fit``): the commanded tilt after a dead time and a second-order response,
  times a static gain, plus a constant error, is compared with the measured attitude.
* Motion (``motion_fit``): the acceleration from that response and the thrust, integrated twice, is
  compared with measured positions, in windows of two seconds with free initial position and
  velocity. This fit is linear in hover thrust, drag, tilt error, and in the time by which the
  motion precedes the time stamps of the attitude.

An attitude is stamped some time after it was measured, and this age must not count in the lag L
from a command to the acceleration that it causes. The second fit estimates this age, with the log's
own value as one more measurement. The age is then subtracted from the dead time.

Residuals are correlated (gusts, thrust noise, model error). Therefore standard deviations come from
a jackknife over windows, and intervals from Student's factor for the number of windows. A standard
deviation is never below a floor for effects that the model leaves out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from groundstation.identification import attitude_fit, motion_fit
from groundstation.identification.attitude_fit import fit_attitude, unexplained_times_s
from groundstation.identification.logged_stretch import (
    MEMORY_S,
    Log,
    TooLittleFlown,
    tilt_vector_rad,
)
from groundstation.identification.motion_fit import (
    POSITION_NOISE_M,
    WINDOW_S,
    fit_horizontal,
    fit_vertical,
)
from onboard.arrays import Array, BoolArray
from onboard.constants import GRAVITY_M_S2

MIN_DURATION_S = 8.0
MIN_TILT_RMS_DEG = 0.5
# least standard deviations, for effects that the model leaves out: battery sag, the thrust curve,
# steady wind (which looks like tilt), the length of a tick; hover as a share of the hover thrust,
# lag in s, drag in 1/s
_FLOOR = {"hover": 0.001, "lag": 0.003, "drag": 0.02, "tilt_deg": 0.1, "gain": 0.003}


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its standard deviation and 95 % interval."""

    value: float
    std: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Identified:
    """The identified parameters of a vehicle, and the quality of the fits."""

    hover_thrust_frac: Estimate
    lag_s: Estimate  # L = delay_s + 2 zeta / wn, known better than its three parts
    delay_s: Estimate
    wn_rad_s: Estimate
    zeta: Estimate
    drag_1_s: Estimate
    static_gain: Estimate
    tilt_error_x_deg: Estimate  # tilt of the thrust towards east when level is commanded
    tilt_error_y_deg: Estimate  # the same towards north
    duration_s: float  # of the stretch that the fits explain
    attitude_rms_deg: float
    position_rms_m: float


def identify(log: Log) -> Identified:
    """Identify the vehicle that flew a log.

    Args:
        log: one stretch in the air.

    Returns:
        Its parameters.

    Raises:
        TooLittleFlown: the log is too short, or the vehicle hardly moves in it.
    """
    begin_s, end_s = _span(log)

    # fit again without the times at which the attitude did not follow the commands
    attitude = fit_attitude(log, begin_s, end_s)
    bad_s = unexplained_times_s(log, attitude, begin_s, end_s)
    if bad_s.size:
        log = _without(log, bad_s)
        attitude = fit_attitude(log, begin_s, end_s)

    scale, scale_std = fit_vertical(log, attitude, begin_s, end_s)
    if not scale > GRAVITY_M_S2:
        raise TooLittleFlown(
            "Throttle and height do not belong together in this log: full throttle would not lift "
            "the vehicle. Check that commands and positions are of one vehicle and of one time."
        )
    motion = fit_horizontal(log, attitude, scale, begin_s, end_s)

    hover = GRAVITY_M_S2 / scale
    hover_std = math.hypot(hover * scale_std / scale, _FLOOR["hover"] * hover)

    # The motion's shift is minus the age of the attitude's stamps, which the dead time contains.
    delay_s = attitude.theta[attitude_fit.DELAY_S] + motion.theta[motion_fit.SHIFT_S]
    wn = attitude.theta[attitude_fit.WN_RAD_S]
    zeta = attitude.theta[attitude_fit.ZETA]
    lag_std = math.hypot(motion.std[motion_fit.SHIFT_S], _FLOOR["lag"])
    delay_std = math.hypot(attitude.std[attitude_fit.DELAY_S], lag_std)
    wn_std = attitude.std[attitude_fit.WN_RAD_S]
    zeta_std = attitude.std[attitude_fit.ZETA]
    drag_std = math.hypot(motion.std[motion_fit.DRAG_1_S], _FLOOR["drag"])
    gain_std = math.hypot(attitude.std[attitude_fit.STATIC_GAIN], _FLOOR["gain"])

    # constant error of the measured attitude, plus the tilt of the thrust against that attitude
    deg_per_rad = math.degrees(1.0)
    errors = attitude_fit.ERRORS_RAD
    pushes = motion_fit.PUSHES_M_S2
    tilt = attitude.theta[errors] + motion.theta[pushes] / GRAVITY_M_S2
    tilt_std = np.hypot(attitude.std[errors], motion.std[pushes] / GRAVITY_M_S2)
    tilt_std = np.hypot(tilt_std, _FLOOR["tilt_deg"] / deg_per_rad)

    factor = _student(motion.clusters)  # half of the 95 % interval, in standard deviations

    def estimate(value: float, std: float, unit: float = 1.0) -> Estimate:
        value = float(value) * unit
        std = float(std) * unit
        return Estimate(value=value, std=std, low=value - factor * std, high=value + factor * std)

    return Identified(
        hover_thrust_frac=estimate(hover, hover_std),
        lag_s=estimate(delay_s + 2.0 * zeta / wn, lag_std),
        delay_s=estimate(delay_s, delay_std),
        wn_rad_s=estimate(wn, wn_std),
        zeta=estimate(zeta, zeta_std),
        drag_1_s=estimate(motion.theta[motion_fit.DRAG_1_S], drag_std),
        static_gain=estimate(attitude.theta[attitude_fit.STATIC_GAIN], gain_std),
        tilt_error_x_deg=estimate(tilt[0], tilt_std[0], deg_per_rad),
        tilt_error_y_deg=estimate(tilt[1], tilt_std[1], deg_per_rad),
        duration_s=end_s - begin_s,
        attitude_rms_deg=attitude.rms * deg_per_rad,
        position_rms_m=motion.rms * POSITION_NOISE_M,
    )


def _without(log: Log, bad_s: Array) -> Log:
    """Return the log without the samples around bad times.

    Samples are left out from 0.1 s before a bad time: attitudes until 0.4 s after it, and positions
    until a whole window after it, since the model integrates over the window. If more than half of
    the samples would be left out, the log stays as it is.
    """

    def is_good(time_s: Array, after_s: float) -> BoolArray:
        """Return for each time (n,) whether no bad time lies from after_s before to 0.1 s after."""
        index = np.searchsorted(bad_s, time_s + 0.1)
        last_bad_s = np.where(index > 0, bad_s[np.maximum(index - 1, 0)], -np.inf)
        return np.asarray(time_s - last_bad_s > after_s)

    attitude = is_good(log.attitude_time_s, 0.4)
    position = is_good(log.position_time_s, WINDOW_S)
    if min(attitude.mean(), position.mean()) < 0.5:
        return log
    return replace(
        log,
        attitude_time_s=log.attitude_time_s[attitude],
        attitude_quaternion_wxyz=log.attitude_quaternion_wxyz[attitude],
        position_time_s=log.position_time_s[position],
        position_enu_m=log.position_enu_m[position],
    )


def _span(log: Log) -> tuple[float, float]:
    """Return the first and the last time that can be used.

    Raises:
        TooLittleFlown: the log is too short, or the vehicle hardly moves in it.
    """
    times = (log.command_time_s, log.attitude_time_s, log.position_time_s)
    if min(time.size for time in times) < 100:
        raise TooLittleFlown(
            "There are fewer than 100 samples of commands, attitude or position in the air. Fly "
            "longer."
        )

    begin_s = max(time[0] for time in times) + MEMORY_S
    end_s = min(time[-1] for time in times)
    if end_s - begin_s < MIN_DURATION_S:
        raise TooLittleFlown(
            f"Only {max(0.0, end_s - begin_s):.1f} s in the air are of use, without landing and the"
            f" first {MEMORY_S:g} s; {MIN_DURATION_S:g} s are needed. Fly on."
        )

    tilt_deg = np.degrees(tilt_vector_rad(log.command_quaternion_wxyz))
    moved_deg = float(np.sqrt(np.var(tilt_deg, axis=0).sum()))
    if not moved_deg >= MIN_TILT_RMS_DEG:
        raise TooLittleFlown(
            f"The commanded tilt varied by {moved_deg:.2f} deg only, {MIN_TILT_RMS_DEG:g} deg are "
            "needed to see lag and drag. Fly some quick moves, or let covey identify fly them."
        )
    return float(begin_s), float(end_s)


def _student(clusters: int) -> float:
    """Approximate the 0.975 quantile of Student's t by its series in 1 / freedom, to 1 %.

    Args:
        clusters: clusters of the fit of the horizontal motion: one per window and axis, at least
            six, and one for the log's own value of the attitude's age.
    """
    freedom = clusters - 1 - 4  # the cluster of the age does not count; four fitted parameters
    return 1.96 + 2.37 / freedom + 2.82 / freedom**2 + 2.56 / freedom**3 + 1.6 / freedom**4
