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
    noise_deg: float = 0.2,
    noise_lasts: int = 1,
    seed: int = 3,
) -> ResponseMemory:
    """Memory after a flight in which the attitude comes ``late_s`` after the commands' model.

    Each noise of the attitude stays for so many samples.
    """
    rng = np.random.default_rng(seed)
    memory = model_mismatch.initial()
    for k in range(round(seconds / dt_s)):
        t = k * dt_s
        late = k * dt_s - late_s - 0.012
        angle = np.array([1.1, 2.3])
        model = 1.2 * np.sin(angle * t)
        rate = 1.2 * angle * np.cos(angle * t)
        tilt = gain * 1.2 * np.sin(angle * late) / GRAVITY_M_S2 + math.radians(lean_deg)
        if k % noise_lasts == 0:
            noise = math.radians(noise_deg) * rng.standard_normal(2)
        tilt = tilt + noise
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


def test_a_vehicle_that_moves_exactly_as_its_model_is_known_to_a_microsecond() -> None:
    attitude_age_s = 0.012
    exact = flown(-attitude_age_s, lean_deg=1.5, dt_s=0.1, noise_deg=0.0)
    found_s, std_s = model_mismatch.lag_difference(exact)
    assert found_s == pytest.approx(-attitude_age_s, abs=1e-6)
    assert std_s < 1e-6


def test_the_deviation_is_that_of_the_results_and_independent_of_the_rate_of_samples() -> None:
    # the noise stays for the time within which samples count as one
    results = [
        model_mismatch.lag_difference(flown(0.0, dt_s=0.1, noise_lasts=5, seed=seed))
        for seed in range(30)
    ]
    scatter_s = float(np.std([found_s for found_s, _ in results]))
    told_s = float(np.mean([std_s for _, std_s in results]))
    assert scatter_s < told_s < 1.5 * scatter_s

    _, often_std_s = model_mismatch.lag_difference(flown(0.0, dt_s=0.02))
    _, seldom_std_s = model_mismatch.lag_difference(flown(0.0, dt_s=0.1))
    assert often_std_s == pytest.approx(seldom_std_s, rel=0.1)


@pytest.mark.parametrize(
    ("late_s", "noise_deg", "is_told"),
    [
        (0.053, 0.4, True),  # 0.04 s and two deviations of 5.5 ms
        (0.049, 0.4, False),
        (0.09, 0.5, True),  # known to 6.8 ms
        (0.09, 0.7, False),  # to 9.5 ms
    ],
)
def test_a_difference_is_told_when_it_is_sure_to_be_more_than_the_law_tolerates(
    late_s: float, noise_deg: float, is_told: bool
) -> None:
    memory = flown(late_s, dt_s=0.1, noise_deg=noise_deg)
    assert ("lag-differs" in model_mismatch.differences(memory, 0.15, 0.5, 0.5)) is is_told


@pytest.mark.parametrize(("late_s", "words"), [(0.09, "91 ms later"), (-0.09, "90 ms earlier")])
def test_the_sentence_says_by_how_much_and_in_which_direction(late_s: float, words: str) -> None:
    told = model_mismatch.differences(flown(late_s, dt_s=0.1), 0.15, 0.5, 0.5)
    assert words in told["lag-differs"]


def test_half_a_minute_is_remembered_and_a_third_of_it_is_enough() -> None:
    memory = flown(0.0, seconds=9.0, dt_s=0.1)
    assert model_mismatch.lag_difference(memory)[1] == math.inf
    memory = flown(0.0, seconds=10.0, dt_s=0.1)
    assert model_mismatch.lag_difference(memory)[1] < 0.008

    assert flown(0.0, seconds=0.1, dt_s=0.1).time_s == pytest.approx(0.1)
    assert flown(0.0, seconds=300.0, dt_s=0.1).time_s == pytest.approx(30.0, rel=0.01)


def test_a_vehicle_that_hardly_answers_its_commands_has_no_known_lag() -> None:
    assert model_mismatch.lag_difference(flown(0.0, gain=0.25, dt_s=0.1))[1] == math.inf
    assert model_mismatch.lag_difference(flown(0.0, gain=0.35, dt_s=0.1))[1] < 0.01


@pytest.mark.parametrize(("tilt_deg", "counts"), [(60.0, True), (72.0, True), (73.0, False)])
def test_an_attitude_counts_up_to_a_tilt_of_seventy_two_degrees(
    tilt_deg: float, counts: bool
) -> None:
    memory = model_mismatch.initial()
    half_rad = 0.5 * math.radians(tilt_deg)
    leaning = (math.cos(half_rad), math.sin(half_rad), 0.0, 0.0)
    after = model_mismatch.update(memory, ZERO_3, ZERO_3, leaning, DT_S)
    assert (after is not memory) is counts
