"""A camera that contradicts the motion that PX4 measures: seen at five ratios a second."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from onboard.localization.odometry_check import OdometryCheck

_PERIOD_NS = 200_000_000
# of real PX4s v1.18.0-rc1 in simulation: good cameras that drift, and cameras that stand still
_FLYING = (0.05, 0.07, 0.12, 0.16, 0.18, 0.21, 0.22, 0.25, 0.25, 0.27, 0.33, 0.34, 0.35, 0.33, 0.29)
_HOVERING = (0.07, 0.06, 0.09, 0.12, 0.09, 0.06, 0.09, 0.11)
_FROZEN = (0.35, 0.58, 0.68, 0.68, 0.67, 0.60, 0.45, 0.41, 0.64, 0.64)
_AFTER_A_GAP = (0.10, math.nan, math.nan, 0.06, 0.10, 0.29, 0.42, 0.45, 0.24, 0.20)


def _tell(check: OdometryCheck, ratios: Sequence[float], begin_ns: int = 1) -> list[bool]:
    told = []
    for step, ratio in enumerate(ratios):
        check.update(ratio, begin_ns + step * _PERIOD_NS)
        told.append(check.is_contradicted)
    return told


def test_a_camera_that_stands_still_is_noticed_and_not_forgotten() -> None:
    told = _tell(OdometryCheck(), (*_HOVERING, *_FROZEN))
    assert told == [False] * 10 + [True] * 8


def test_the_time_since_which_the_ratios_rise_is_that_of_the_last_one_before() -> None:
    check = OdometryCheck()
    rising = (0.13, 0.25, 0.5, 0.9)  # the first one is as large as good cameras' are
    told = _tell(check, (*_HOVERING, *rising))
    assert told[-1]
    assert check.rising_since_ns == 1 + len(_HOVERING) * _PERIOD_NS


@pytest.mark.parametrize(
    "ratios",
    [
        _FLYING,
        _HOVERING * 5,
        (0.6,) * 20,  # a camera whose noise is larger than PX4 believes
        (*_HOVERING, 2.0, *_HOVERING),  # a jump, which PX4 follows
        _AFTER_A_GAP,
        (math.nan,) * 20,
    ],
)
def test_what_good_cameras_show_is_no_contradiction(ratios: Sequence[float]) -> None:
    assert not any(_tell(OdometryCheck(), ratios))


def test_a_contradiction_is_over_when_the_camera_has_agreed_for_a_second() -> None:
    check = OdometryCheck()
    _tell(check, (*_HOVERING, *_FROZEN))
    back_ns = 100 * _PERIOD_NS
    assert _tell(check, (0.1,) * 4 + (0.2,) + (0.1,) * 6, back_ns) == [True] * 10 + [False]


def test_the_same_report_counts_once() -> None:
    check = OdometryCheck()
    _tell(check, _HOVERING)
    for _ in range(50):
        check.update(2.0, 20 * _PERIOD_NS)
    assert not check.is_contradicted
