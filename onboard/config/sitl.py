"""``[types.X.sitl]``: values of a vehicle that only the emulator uses, and their bounds."""

from __future__ import annotations

import msgspec


class SitlProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Values that the control does not know. The defaults are those of PX4's SIH quadrotor.

    sitl/README.md explains them.
    """

    static_gain: float = 1.0  # of the attitude: reached tilt divided by commanded tilt
    tilt_bias_deg: float = 0.0  # largest constant error of the tilt, drawn anew for each flight
    yaw_wn_rad_s: float = 3.0  # natural frequency of the heading
    thrust_delay_s: float = 0.012  # dead time of the thrust
    motor_lag_s: float = 0.05  # time constant of the motors
    thrust_noise_frac: float = 0.0  # of the weight
    inertia_kg_m2: tuple[float, float, float] = (0.025, 0.025, 0.03)  # about the three body axes
    arm_m: float = 0.2  # from the centre to a motor
    thrust_curve_frac: float = 0.0  # 0: thrust grows with the throttle; 1: with its square
    attitude_integral_s: float = 0.5  # time constant of the attitude's integral term; 0: none
    gust_std_m_s2: float = 0.0  # of gusts that push this vehicle
    max_tilt_rate_deg_s: float = 220.0  # of the attitude control
    max_yaw_rate_deg_s: float = 200.0  # of the attitude control


BOUNDS: dict[str, tuple[float, float]] = {
    "static_gain": (0.1, 2.0),
    "tilt_bias_deg": (0.0, 15.0),
    "yaw_wn_rad_s": (0.3, 30.0),
    "thrust_delay_s": (0.0, 0.5),
    "motor_lag_s": (0.0, 1.0),
    "thrust_noise_frac": (0.0, 0.5),
    "inertia_kg_m2": (1e-6, 10.0),
    "arm_m": (0.01, 2.0),
    "thrust_curve_frac": (0.0, 1.0),
    "attitude_integral_s": (0.0, 60.0),
    "gust_std_m_s2": (0.0, 10.0),
    "max_tilt_rate_deg_s": (10.0, 2000.0),
    "max_yaw_rate_deg_s": (10.0, 2000.0),
}
