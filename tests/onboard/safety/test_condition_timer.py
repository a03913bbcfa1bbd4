"""The memory of a condition: how long it has held, and in how many checks in a row."""

from __future__ import annotations

import pytest

from onboard.safety.condition_timer import ConditionTimer

MS = 1_000_000


def test_a_condition_is_counted_from_the_first_check_at_which_it_holds() -> None:
    held = ConditionTimer()
    assert (held.checks, held.since_ns) == (0, 0)
    assert held.seconds(7_000 * MS) == 0.0

    held.see(1_000 * MS)
    assert held.checks == 1
    assert held.seconds(1_000 * MS) == 0.0

    held.see(1_020 * MS)
    held.see(1_040 * MS)
    assert held.checks == 3
    assert held.since_ns == 1_000 * MS
    assert held.seconds(1_250 * MS) == pytest.approx(0.25)


def test_a_check_without_it_begins_the_count_anew() -> None:
    held = ConditionTimer()
    held.see(1_000 * MS)
    held.end()
    assert held.checks == 0
    assert held.seconds(2_000 * MS) == 0.0

    held.see(3_000 * MS)
    assert (held.checks, held.since_ns) == (1, 3_000 * MS)
    assert held.seconds(3_500 * MS) == pytest.approx(0.5)
