"""The plain tuples of files, messages and orders.

The control code calculates with :class:`onboard.vectors.Vec3` instead. The frame and the unit of a
tuple stand in the name of whatever holds it.
"""

from __future__ import annotations

Xyz = tuple[float, float, float]
Wxyz = tuple[float, float, float, float]  # a quaternion, scalar part first
