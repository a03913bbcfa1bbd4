"""The lag of a body's stamps, found from its tilt beside PX4's: on made-up tilts, and on the
emulator's own.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.mocap.relay.latency import fit, gravity


def smooth(rng: np.random.Generator, size_deg: float):
    """A random tilt (roll, pitch) over time, of about a second's waves."""
    rates = rng.uniform(1.0, 6.0, (2, 6))
    phases = rng.uniform(0.0, 2.0 * math.pi, (2, 6))
    sizes = rng.normal(size=(2, 6)) * math.radians(size_deg) / math.sqrt(3.0)
    return lambda t: (sizes[:, :, None] * np.sin(rates[:, :, None] * t + phases[:, :, None])).sum(
        axis=1
    )


def quaternions(tilts_rad: np.ndarray, yaw_rad: float) -> list[tuple[float, float, float, float]]:
    found = []
    for roll, pitch in tilts_rad.T:
        r, p, y = (angle / 2.0 for angle in (roll, pitch, yaw_rad))
        (cr, cp, cy) = map(math.cos, (r, p, y))
        (sr, sp, sy) = map(math.sin, (r, p, y))
        w = cr * cp * cy + sr * sp * sy
        x = sr * cp * cy - cr * sp * sy
        found.append((w, x, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy))
    return found


def _curves(
    seed: int, lag_s: float, *, size_deg: float = 4.0, noise_deg: float = 0.15, yaw_rad: float = 0.0
):
    """A body at 50 Hz whose stamps lag by ``lag_s``, and PX4 at 50 Hz, jittering, both of one
    motion.
    """
    rng = np.random.default_rng(seed)
    tilt = smooth(rng, size_deg)
    body_s = np.arange(0.0, 12.0, 0.02)
    px4_s = np.sort(np.arange(0.0, 12.0, 0.02) + rng.uniform(0.0, 0.004, 600))
    body = tilt(body_s - lag_s) + rng.normal(size=(2, body_s.size)) * math.radians(noise_deg)
    px4 = tilt(px4_s) + math.radians(1.0)  # markers that are not level with the autopilot
    return body_s, gravity(quaternions(body, yaw_rad)), px4_s, gravity(quaternions(px4, 0.0))


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1000), st.floats(-0.05, 0.2), st.floats(-math.pi, math.pi))
def test_the_lag_is_found_to_a_few_milliseconds_whatever_the_heading(
    seed: int, lag_s: float, yaw_rad: float
) -> None:
    found = fit(*_curves(seed, lag_s, yaw_rad=yaw_rad))
    assert found is not None
    assert found.is_same
    assert found.lag_s == pytest.approx(lag_s, abs=0.006)


def test_the_body_of_another_vehicle_does_not_fit() -> None:
    for seed in range(10):
        body_s, body, _, _ = _curves(seed, 0.02)
        _, _, px4_s, px4 = _curves(seed + 100, 0.0)
        found = fit(body_s, body, px4_s, px4)
        assert found is not None
        assert not found.is_same


def test_what_hardly_tilts_says_nothing() -> None:
    assert fit(*_curves(1, 0.02, size_deg=0.1)) is None
    body_s, body, px4_s, px4 = _curves(1, 0.02)
    assert fit(body_s[:80], body[:80], px4_s, px4) is None
    assert fit(body_s[:0], body[:0], px4_s, px4) is None


def test_a_level_body_has_gravity_along_its_own_z_and_a_tilted_one_has_not() -> None:
    assert np.allclose(
        gravity([(1.0, 0.0, 0.0, 0.0), (math.cos(1.0), 0.0, 0.0, math.sin(1.0))]), 0.0
    )
    half = math.radians(5.0)
    # rolled by ten degrees
    ((forward, left),) = gravity([(math.cos(half), math.sin(half), 0.0, 0.0)])
    assert forward == pytest.approx(0.0)
    assert left == pytest.approx(math.sin(2.0 * half))
