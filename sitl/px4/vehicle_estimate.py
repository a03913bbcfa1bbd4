"""One vehicle's part of the estimator: settings of its sensors, and the state of its estimate."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from sitl.physics.frames import Array
from sitl.px4.estimator_errors import GPS, VISION_DEFAULT, ErrorLevel, Source

# The horizontal error in ESTIMATOR_STATUS with a source, measured on PX4 v1.18 (SIH).
GPS_ACCURACY_M = 0.3


@dataclass(slots=True)
class SensorSettings:
    """Settings of one vehicle's sensors, by parameters and faults. A reboot keeps them.

    Attributes:
        has_gps: whether the parameters allow satellites.
        gps_blocked: whether a fault prevents the reception of satellites.
        gps_level: error level of the estimate with satellites.
        gps_accuracy_m: horizontal error in ESTIMATOR_STATUS with satellites.
        gps_delay_s: delay of horizontal position and velocity by satellites.
        gps_drift_ned_m_s: drift (3,) of positions by satellites, which velocities do not show; None
            if there is none.
        uses_vision_yaw: whether the parameters take the heading from vision.
        heading_gate_rad: largest difference of an external heading that is fused.
        heading_gain: share of the difference by which one heading corrects the estimate.
        vision_level: error level of the estimate with vision.
        vision_noise_m: EKF2_EVP_NOISE.
    """

    has_gps: bool = True
    gps_blocked: bool = False
    gps_level: ErrorLevel = GPS
    gps_accuracy_m: float = GPS_ACCURACY_M
    gps_delay_s: float = 0.0
    gps_drift_ned_m_s: Array | None = None

    uses_vision_yaw: bool = True
    heading_gate_rad: float = 0.26
    heading_gain: float = 0.1
    vision_level: ErrorLevel = VISION_DEFAULT
    vision_noise_m: float = 0.1


@dataclass(slots=True)
class VehicleEstimate:
    """The sources of one vehicle's estimate, and the times of its events. A reboot begins it anew.

    Attributes:
        start_time_s: time at which the autopilot started.
        vision_time_s: time of the newest external position.
        sideways_time_s: time of the newest external position that was fused horizontally.
        height_time_s: time of the newest external position whose height was fused.
        heading_time_s: time of the newest external heading that was fused; -inf before the first.
        lost_time_s: time at which the last source was lost.
        flight_time_s: last time in the air.
        source: present source.
        level: present error level; None before the first selection.
        is_resting: whether the vehicle rested at the last selection of the source.
        position_ratio: squared horizontal difference of an external position from the estimate, as
            a share of the largest that is fused. It rises at once, and falls with a time constant.
        ratio_time_s: time of that ratio.
        heading_ratio: difference of the newest external heading from the estimate, as a share of
            the largest that is fused; NaN while no external heading is fused.
        vision_frame_ned_m: offset (3,) from the frame of vision to that of satellites; None while
            it is not known.
        late: horizontal positions (2,) and velocities (2,) during the delay of satellites, oldest
            first.
        origin_altitude_m: altitude of the local frame's origin above the sea; None while it is not
            known.
    """

    start_time_s: float = 0.0
    vision_time_s: float = -math.inf
    sideways_time_s: float = -math.inf
    height_time_s: float = -math.inf
    heading_time_s: float = -math.inf
    lost_time_s: float = -math.inf
    flight_time_s: float = -math.inf

    source: Source = Source.NONE
    level: ErrorLevel | None = None
    is_resting: bool = True

    position_ratio: float = 0.0
    ratio_time_s: float = -math.inf
    heading_ratio: float = math.nan
    vision_frame_ned_m: Array | None = None
    late: deque[tuple[Array, Array]] = field(default_factory=deque)
    origin_altitude_m: float | None = None
