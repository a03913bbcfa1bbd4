"""A verdict in words: the loop periods, and how near a vehicle came to a person."""

from __future__ import annotations

from typing import Any

import pytest

from groundstation.recording.flight_report import LoopTiming
from groundstation.verdict.verdict import NearestPerson, Verdict, describe


def told(begin: str, **changes: Any) -> str:
    """The sentence of a verdict that begins so, without this begin."""
    values: dict[str, Any] = {
        "passed": True,
        "exit_status": 0,
        "summary": "PASSED",
        "mission": "hop",
        "fleet": "paper",
        "law": "covey",
        "checks": [],
        "steps": [],
        "closest": None,
        "is_collision": False,
        "arrivals": [],
        "worst_arrival_m": None,
        "landed": {},
        "loop": {},
        "duration_s": 10.0,
    }
    sentences = describe(Verdict(**{**values, **changes}))
    [sentence] = [line for line in sentences if line.startswith(begin)]
    return sentence.removeprefix(begin)


def loop_words(*periods_ms: float) -> str:
    loops = {
        f"mav{number}": LoopTiming(
            period_p50_ms=20.0, period_p99_ms=period_ms, period_max_ms=40.0, ticks=1000
        )
        for number, period_ms in enumerate(periods_ms)
    }
    return told("Loop period, 99th percentile (nominal 20 ms): ", loop=loops)


def test_the_loops_of_a_few_vehicles_are_told_one_by_one() -> None:
    assert loop_words(20.0, 20.1, 20.0) == "mav0 20.0 ms, mav1 20.1 ms, mav2 20.0 ms."


def test_of_many_vehicles_the_longest_loop_period_is_told() -> None:
    assert loop_words(20.0, 20.1, 23.4, 20.0, 20.0) == "at most 23.4 ms, mav2."


@pytest.mark.parametrize(
    ("distance_m", "words"),
    [
        (0.86, "mav0, 0.86 m from the circle of anna, at 12.3 s."),
        (0.74, "mav0, 0.74 m from the circle of anna, at 12.3 s: LESS THAN 0.80 m."),
        (-0.1, "mav0, 0.10 m inside the circle of anna, at 12.3 s: LESS THAN 0.80 m."),
    ],
)
def test_the_vehicle_that_came_nearest_to_a_person_is_told(distance_m: float, words: str) -> None:
    nearest = NearestPerson(
        vehicle="mav0",
        person="anna",
        distance_m=distance_m,
        time_s=12.34,
        safety_distance_m=0.8,
    )
    assert told("Nearest to a person: ", nearest_person=nearest) == words
