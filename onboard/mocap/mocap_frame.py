"""Conversion from the coordinates of a motion capture to those of the fleet.

The conversion uses plain floats, because it runs for every body in every frame of the cameras.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.config.mocap import MocapConfig
from onboard.tuples import Wxyz, Xyz


@dataclass(frozen=True, slots=True)
class MocapFrame:
    """Conversion in three steps: make z the up axis, rotate about up, shift.

    If the mocap's up axis is y, the first step maps (x, y, z) to (x, -z, y), both in the room's
    coordinates and in the bodies' axes.
    """

    is_y_up: bool = False  # False: z is up
    yaw_rad: float = 0.0  # angle of the rotation about up, counterclockwise
    offset_enu_m: Xyz = (0.0, 0.0, 0.0)  # the mocap's origin in the fleet frame

    @classmethod
    def of(cls, mocap: MocapConfig) -> MocapFrame:
        """Return the frame that the fleet file describes."""
        return cls(mocap.up == "y", math.radians(mocap.yaw_deg), mocap.offset_m)

    def position_enu_m(self, position_m: Xyz) -> Xyz:
        """Convert a position."""
        x, y, z = position_m
        if self.is_y_up:
            y, z = -z, y

        cosine = math.cos(self.yaw_rad)
        sine = math.sin(self.yaw_rad)
        east, north, up = self.offset_enu_m
        return (
            cosine * x - sine * y + east,
            sine * x + cosine * y + north,
            z + up,
        )

    def quaternion_enu_flu_wxyz(self, quaternion_wxyz: Wxyz) -> Wxyz:
        """Convert a rotation from body to mocap into a rotation from body FLU to fleet ENU.

        The result is normalised unless it is zero.
        """
        w, x, y, z = quaternion_wxyz
        if self.is_y_up:  # convert the components of the rotation's axis
            y, z = -z, y

        # product of the rotation about up, (c, 0, 0, s), and the body's rotation
        c = math.cos(0.5 * self.yaw_rad)
        s = math.sin(0.5 * self.yaw_rad)
        turned_w = c * w - s * z
        turned_x = c * x - s * y
        turned_y = c * y + s * x
        turned_z = c * z + s * w

        norm = math.sqrt(
            turned_w * turned_w + turned_x * turned_x + turned_y * turned_y + turned_z * turned_z
        )
        if norm <= 0.0:
            return turned_w, turned_x, turned_y, turned_z
        return turned_w / norm, turned_x / norm, turned_y / norm, turned_z / norm
