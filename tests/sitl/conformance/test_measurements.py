"""Numbers of the facts, computed from received messages."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from sitl.conformance.measurements import descent_speed_m_s


def _positions(*samples: tuple[float, float]) -> list[Any]:
    """Positions from heights above the ground [m] and speeds downwards [m/s]."""
    return [
        SimpleNamespace(message=SimpleNamespace(z=-0.3 - height_m, vz=sinks_m_s))
        for height_m, sinks_m_s in samples
    ]


def test_the_speed_of_a_descent_leaves_out_the_time_on_the_ground() -> None:
    descent = [(2.0, 1.5), (1.2, 0.8), (0.9, 0.6), (0.3, 0.1)]
    standing = [(0.7, 0.02), (0.8, -0.1)] * 20  # its height drifts
    packets = _positions(*descent, *standing)
    assert descent_speed_m_s(packets, -0.3, top_m=1.3) == pytest.approx(0.7)
    assert math.isnan(descent_speed_m_s(_positions(*standing), -0.3, top_m=1.3))
