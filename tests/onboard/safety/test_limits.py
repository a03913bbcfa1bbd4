"""The limits that several judgements share, literally: whoever changes one says it twice."""

from __future__ import annotations

import pytest

from onboard.safety import limits


def test_each_limit_is_what_the_docs_promise() -> None:
    assert limits.POSITION_STALE_S == 0.2
    assert limits.POSITION_KNOWN_S == 0.5
    assert limits.POSITION_LOST_S == 0.6
    assert limits.NEIGHBOUR_BLIND_S == 0.25
    assert limits.RECKONING_S == 6.0
    assert limits.RECKONING_AMONG_OTHERS_S == 12.0
    assert limits.AMONG_OTHERS_M == 5.0
    assert limits.AUTOPILOT_SILENT_S == 0.3
    assert limits.LOCAL_POSITION_FRESH_S == 0.25
    assert limits.LARGEST_POSITION_STD_M == 0.5
    assert limits.LARGEST_VELOCITY_STD_M_S == 0.5
    assert pytest.approx(0.7071, abs=1e-4) == limits.LARGEST_PX4_ACCURACY_M
