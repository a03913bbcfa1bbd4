"""A vehicle on the ground asks those in the air for the wind."""

from __future__ import annotations

import math
from types import SimpleNamespace

from onboard.neighbours.wind import wind_felt_by

S = 1_000_000_000
NOT_KNOWN = (math.nan, math.nan)


def told(*winds: tuple[float, float], stamp_ns: int = 10 * S):
    return [SimpleNamespace(stamp_ns=stamp_ns, wind_enu_m_s=wind) for wind in winds]


def test_without_anybody_in_the_air_the_wind_is_not_known() -> None:
    assert all(map(math.isnan, wind_felt_by([], 10 * S)))
    assert all(map(math.isnan, wind_felt_by(told(NOT_KNOWN, NOT_KNOWN), 10 * S)))


def test_who_stands_does_not_count_and_one_that_is_wrong_does_not_decide() -> None:
    assert wind_felt_by(told(NOT_KNOWN, (3.0, -1.0)), 10 * S) == (3.0, -1.0)
    assert wind_felt_by(told((3.0, -1.0), (3.2, 40.0), (2.9, -1.2)), 10 * S) == (3.0, -1.0)


def test_a_wind_that_nobody_has_told_for_long_is_not_used() -> None:
    assert wind_felt_by(told((3.0, -1.0)), 14 * S) == (3.0, -1.0)
    assert math.isnan(wind_felt_by(told((3.0, -1.0)), 16 * S)[0])
