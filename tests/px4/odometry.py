"""Visual odometry for real PX4s: what a camera on each vehicle tells its PX4.

Each frame of odometry begins on the vehicle's take-off spot, with the fleet's axes. Its positions
have noise, and drift as those of a camera do.
"""

from __future__ import annotations

import math
import socket
import time

import numpy as np
from numpy.typing import NDArray

from onboard.bus.schema import Truth
from onboard.config.fleet import Vehicle
from onboard.frames import ned_frd_from_enu_flu, ned_from_enu, turned_about_up
from onboard.tuples import Wxyz
from sitl.mavlink.codec import Encoder

_COMPONENT = 197  # MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
_LOCAL_NED = 1  # MAV_FRAME
_BODY_FRD = 12
_PERIOD_S = 0.033
_NOISE_M = 0.01
_DRIFT_M = 0.01  # standard deviation of the drift after a second
_POSITION_VARIANCE_M2 = 0.03**2
_ATTITUDE_VARIANCE_RAD2 = 0.02**2


class Odometry:
    """Odometry of one vehicle, sent to the ground link of its PX4.

    Args:
        vehicle: with that camera.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        host, _, port = str(vehicle.direct).removeprefix("udpout://").rpartition(":")
        self._address = (host, int(port))
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._encoder = Encoder(vehicle.system_id, component_id=_COMPONENT)
        self._spot_enu_m = np.array(vehicle.start_enu_m)
        self._rng = np.random.default_rng(vehicle.system_id)
        self._drift_m = np.zeros(3)
        self._sent_s = -math.inf
        self._turn_rad = 0.0
        self._turned_about_m = np.zeros(3)
        self._sent: tuple[NDArray[np.float64], Wxyz] | None = None  # newest position and attitude

    def turn(self, truth: Truth, by_rad: float) -> None:
        """Turn the frame about the present place, as a camera does that begins anew; only once."""
        if self._turn_rad == 0.0:
            self._turn_rad = by_rad
            self._turned_about_m = np.array(truth.position_enu_m) - self._spot_enu_m

    def send(self, truth: Truth, *, is_frozen: bool = False) -> None:
        """Send what the camera measures of a true state, if it is time.

        Args:
            truth: the true state.
            is_frozen: whether the camera has lost its view, and repeats what it has sent last.
        """
        stamp_s = truth.stamp_ns * 1e-9
        if stamp_s - self._sent_s < _PERIOD_S:
            return
        self._sent_s = stamp_s

        self._drift_m += self._rng.normal(0.0, _DRIFT_M * math.sqrt(_PERIOD_S), 3)
        true_enu_m = np.array(truth.position_enu_m) - self._spot_enu_m
        measured_enu_m = self._in_frame(true_enu_m) + self._drift_m
        measured_enu_m += self._rng.normal(0.0, _NOISE_M, 3)
        attitude_wxyz = turned_about_up(truth.quaternion_enu_flu_wxyz, self._turn_rad)
        if is_frozen and self._sent is not None:
            measured_enu_m, attitude_wxyz = self._sent
        self._sent = (measured_enu_m, attitude_wxyz)

        east_m, north_m, up_m = measured_enu_m.tolist()
        x, y, z = ned_from_enu((east_m, north_m, up_m))

        odometry = self._encoder.encode_named(
            "ODOMETRY",
            time_usec=time.monotonic_ns() // 1000,
            frame_id=_LOCAL_NED,
            child_frame_id=_BODY_FRD,
            x=x,
            y=y,
            z=z,
            q=ned_frd_from_enu_flu(attitude_wxyz),
            vx=math.nan,
            vy=math.nan,
            vz=math.nan,
            pose_covariance=_pose_covariance(),
            velocity_covariance=[math.nan] * 21,
        )
        self._socket.sendto(odometry, self._address)

    def _in_frame(self, true_enu_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a place in the frame that is turned about another one."""
        cosine = math.cos(self._turn_rad)
        sine = math.sin(self._turn_rad)
        east_m, north_m, up_m = true_enu_m - self._turned_about_m
        turned_m = (cosine * east_m - sine * north_m, sine * east_m + cosine * north_m, up_m)
        return self._turned_about_m + np.array(turned_m)


def _pose_covariance() -> list[float]:
    """Return the upper triangle of the covariance, row by row."""
    matrix = np.diag([_POSITION_VARIANCE_M2] * 3 + [_ATTITUDE_VARIANCE_RAD2] * 3)
    return [float(value) for value in matrix[np.triu_indices(6)]]
