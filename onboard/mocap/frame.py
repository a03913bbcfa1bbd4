"""Conversion from a motion capture's frame to the fleet's, in plain floats: it runs for every body
of every frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.bus.schema import Vec3, Vec4
from onboard.config.mocap import MocapConfig


@dataclass(frozen=True, slots=True)
class Frame:
    """The mocap's frame in the fleet's: up axis, then a turn about up, then a shift.

    With y up the mocap's z axis points along the fleet's -y, for the room and for the bodies in it
    alike.
    """

    is_y_up: bool = False
    yaw_rad: float = 0.0
    offset_enu_m: Vec3 = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, mocap: MocapConfig) -> Frame:
        """Return the frame that the fleet file describes."""
        return cls(mocap.up == "y", math.radians(mocap.yaw_deg), mocap.offset_m)

    def position_enu_m(self, position_m: Vec3) -> Vec3:
        """Convert a position."""
        x, y, z = position_m
        if self.is_y_up:
            y, z = -z, y
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        east, north, up = self.offset_enu_m
        return c * x - s * y + east, s * x + c * y + north, z + up

    def quaternion_enu_flu_wxyz(self, quaternion_wxyz: Vec4) -> Vec4:
        """Convert a rotation from body to mocap into one from body FLU to fleet ENU; normalised
        unless it is zero.
        """
        w, x, y, z = quaternion_wxyz
        if self.is_y_up:  # the same rotation, its axis seen in the turned frame
            y, z = -z, y
        c, s = math.cos(0.5 * self.yaw_rad), math.sin(0.5 * self.yaw_rad)
        w, x, y, z = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        return (w / norm, x / norm, y / norm, z / norm) if norm > 0.0 else (w, x, y, z)
