"""The watch in flight: a vehicle slower than its file, and one that is as its file says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from onboard.constants import GRAVITY_M_S2
from onboard.safety import model_mismatch
from onboard.safety.model_mismatch import ResponseMemory
from onboard.vectors import ZERO_3, Vec3

DT_S = 0.02


def flown(
    late_s: float,
    *,
    gain: float = 1.0,
    lean_deg: float = 0.0,
    seconds: float = 25.0,
    dt_s: float = DT_S,
) -> ResponseMemory:
    """Memory after a flight in which the attitude comes ``late_s`` after the commands' model."""
    rng = np.random.default_rng(3)
    memory = model_mismatch.initial()
    for k in range(round(seconds / dt_s)):
        t = k * dt_s
        late = k * dt_s - late_s - 0.012
        angle = np.array([1.1, 2.3])
        model = 1.2 * np.sin(angle * t)
        rate = 1.2 * angle * np.cos(angle * t)
        tilt = gain * 1.2 * np.sin(angle * late) / GRAVITY_M_S2 + math.radians(lean_deg)
        tilt = tilt + math.radians(0.2) * rng.standard_normal(2)
        up = np.array([tilt[0], tilt[1], 1.0]) / math.sqrt(1.0 + float(tilt @ tilt))
        half = 0.5 * math.acos(up[2])
        axis = np.array([-up[1], up[0]]) / max(math.hypot(up[0], up[1]), 1e-12)
        x, y = math.sin(half) * axis
        memory = model_mismatch.update(
            memory,
            Vec3(model[0], model[1], 0.0),
            Vec3(rate[0], rate[1], 0.0),
            (math.cos(half), x, y, 0.0),
            dt_s,
        )
    return memory


@pytest.mark.parametrize("late_s", [-0.05, 0.0, 0.06, 0.1])
@pytest.mark.parametrize(("gain", "lean_deg"), [(1.0, 0.0), (0.9, 1.5)])
@pytest.mark.parametrize("dt_s", [DT_S, 5 * DT_S])
def test_the_lateness_of_a_vehicle_is_measured_whatever_its_gain_and_bias(
    late_s: float, gain: float, lean_deg: float, dt_s: float
) -> None:
    found, std = model_mismatch.lag_difference(
        flown(late_s, gain=gain, lean_deg=lean_deg, dt_s=dt_s)
    )
    assert found == pytest.approx(late_s, abs=0.012)
    assert std < 0.008


def test_a_vehicle_as_its_file_says_gives_no_sentence_and_a_slow_one_says_what_to_do() -> None:
    assert model_mismatch.differences(flown(0.02), 0.15, 0.5, 0.49) == {}
    told = model_mismatch.differences(flown(0.09), 0.15, 0.5, 0.49)
    assert list(told) == ["lag-differs"]
    assert "later" in told["lag-differs"]
    assert "covey identify" in told["lag-differs"]
    assert "0.62" in model_mismatch.differences(flown(0.0), 0.15, 0.62, 0.5)["hover-differs"]


def test_nothing_is_said_before_there_was_anything_to_see() -> None:
    assert model_mismatch.lag_difference(model_mismatch.initial()) == (0.0, math.inf)
    assert model_mismatch.differences(flown(0.2, seconds=4.0), 0.15, 0.7, 0.5) == {}
    still = model_mismatch.initial()
    for _ in range(1000):
        still = model_mismatch.update(still, ZERO_3, ZERO_3, (1.0, 0.0, 0.0, 0.0), DT_S)
    assert model_mismatch.lag_difference(still)[1] == math.inf


def test_bad_input_changes_nothing() -> None:
    memory = flown(0.0)
    level = (1.0, 0.0, 0.0, 0.0)
    upside_down = (0.0, 1.0, 0.0, 0.0)
    nan = Vec3(math.nan, math.nan, math.nan)
    assert model_mismatch.update(memory, nan, ZERO_3, level, DT_S) is memory
    assert model_mismatch.update(memory, ZERO_3, ZERO_3, upside_down, DT_S) is memory
    assert model_mismatch.update(memory, ZERO_3, ZERO_3, (math.nan,) * 4, DT_S) is memory
