"""The mocap's frame in the fleet's, against rotations written as matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.config.mocap import MocapConfig
from onboard.mocap.mocap_frame import MocapFrame

_angles = st.floats(-math.pi, math.pi)
_numbers = st.floats(-50.0, 50.0)


def _matrix(q: tuple[float, float, float, float]) -> np.ndarray:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _axes(frame: MocapFrame) -> np.ndarray:
    up = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]) if frame.is_y_up else np.eye(3)
    c = math.cos(frame.yaw_rad)
    s = math.sin(frame.yaw_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ up


@given(st.booleans(), _angles, st.tuples(*[_numbers] * 6), st.tuples(*[_angles] * 3))
def test_positions_and_attitudes_turn_together_as_the_matrices_say(
    is_y_up, yaw, numbers, tilt
) -> None:
    frame = MocapFrame(is_y_up, yaw, numbers[:3])
    axes = _axes(frame)
    p = np.array(numbers[3:])
    assert np.allclose(frame.position_enu_m(tuple(p)), axes @ p + numbers[:3], atol=1e-9)
    v = np.array([1.0, *np.tan(np.array(tilt) / 4.0)])
    q = tuple((v / np.linalg.norm(v)).tolist())
    # the body's own axes are named as the room's: its up is the mocap's up
    body = _axes(MocapFrame(is_y_up))
    assert np.allclose(
        _matrix(frame.quaternion_enu_flu_wxyz(q)), axes @ _matrix(q) @ body.T, atol=1e-9
    )


def test_a_vehicle_that_stands_level_is_level_in_the_fleet_whatever_axis_points_up() -> None:
    for up in ("z", "y"):
        frame = MocapFrame.of(MocapConfig(source="motioncapture", type="mock", up=up, yaw_deg=90.0))
        w, x, y, z = frame.quaternion_enu_flu_wxyz((1.0, 0.0, 0.0, 0.0))
        assert (x, y) == (0.0, 0.0)
        assert 2.0 * math.atan2(z, w) == pytest.approx(math.pi / 2)


def test_a_quaternion_of_zeros_stays_recognisable_as_none() -> None:
    assert MocapFrame().quaternion_enu_flu_wxyz((0.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0, 0.0)
