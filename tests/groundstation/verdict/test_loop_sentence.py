"""The loop periods in a verdict's words."""

from __future__ import annotations

from groundstation.recording.flight_report import LoopTiming
from groundstation.verdict.verdict import Verdict, describe


def told(*periods_ms: float) -> str:
    """The sentence about the loops of so many vehicles."""
    loops = {
        f"mav{number}": LoopTiming(
            period_p50_ms=20.0, period_p99_ms=period_ms, period_max_ms=40.0, ticks=1000
        )
        for number, period_ms in enumerate(periods_ms)
    }
    verdict = Verdict(
        passed=True,
        exit_status=0,
        summary="PASSED",
        mission="hop",
        fleet="paper",
        law="covey",
        checks=[],
        steps=[],
        closest=None,
        is_collision=False,
        arrivals=[],
        worst_arrival_m=None,
        landed={},
        loop=loops,
        duration_s=10.0,
    )
    [sentence] = [line for line in describe(verdict) if line.startswith("Loop period")]
    return sentence.removeprefix("Loop period, 99th percentile (nominal 20 ms): ")


def test_a_few_vehicles_are_told_one_by_one() -> None:
    assert told(20.0, 20.1, 20.0) == "mav0 20.0 ms, mav1 20.1 ms, mav2 20.0 ms."


def test_of_many_vehicles_the_longest_period_is_told() -> None:
    assert told(20.0, 20.1, 23.4, 20.0, 20.0) == "at most 23.4 ms, mav2."
