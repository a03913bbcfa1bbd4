"""The plain tuples of files, messages and orders.

The control code calculates with :class:`onboard.vectors.Vec3` instead. The name of a variable or
field that holds a tuple contains its frame and unit.
"""

from __future__ import annotations

Xyz = tuple[float, float, float]
Wxyz = tuple[float, float, float, float]  # a quaternion, scalar part first
