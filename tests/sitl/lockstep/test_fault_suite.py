"""Whatever breaks at whichever moment: nobody collides, everybody comes down, and the record says
why.

`make test-realtime` flies a cross-section, some of what can break, each at a moment of its own;
`make test-long` flies all of it at every half second, with three and with six vehicles.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from onboard.safety.failsafe_table import Condition
from sitl.lockstep.campaign.broken_flight import injection_of
from sitl.lockstep.campaign.injections import INJECTIONS
from tests.sitl.lockstep.suite import Case, Outcome, cases, fly, summary


def _fly_in_two_processes(todo: Iterable[Case]) -> list[Outcome]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(fly, todo))


def _judge(outcomes: list[Outcome], folder: Path) -> None:
    table = summary(outcomes)
    (folder / "fault-suite.md").write_text(table, encoding="utf-8")
    print(table)
    assert not [f"{one.case.name}: {'; '.join(one.wrong)}" for one in outcomes if one.wrong]


def cross_section() -> list[Case]:
    """Return some of the cases, spread over what breaks and when, and each fault of a camera."""
    by_mocap = cases(every=850, counts=(3,), stagger=173)[4::33]
    of_cameras = [one.name for one in INJECTIONS if one.needs == "camera"]
    by_cameras = [
        Case(name, tick=97 * number % 850, place=number % 3, mission="by cameras")
        for number, name in enumerate(of_cameras)
    ]
    return by_mocap + by_cameras


@pytest.mark.timeout(600)
def test_a_cross_section_of_all_that_can_break_ends_with_everybody_down_and_apart(
    tmp_path: Path,
) -> None:
    outcomes = [fly(case) for case in cross_section()]  # other files have the other core
    _judge(outcomes, tmp_path)


def test_a_vehicle_between_both_positions_of_another_one_keeps_off_both() -> None:
    # the mocap has mav2 1.3 m from where it is and says, and the goal of mav1 is in between
    flown = fly(Case("mocap jumps for good", tick=292, place=2))
    assert not flown.wrong
    assert flown.min_separation_m > 0.80


@pytest.mark.long
@pytest.mark.timeout(5400)
def test_all_that_can_break_at_every_half_second_ends_with_everybody_down_and_apart(
    tmp_path: Path,
) -> None:
    outcomes = _fly_in_two_processes(cases(every=25, counts=(3, 6)))
    _judge(outcomes, tmp_path)
    noticed = {name for outcome in outcomes for name in outcome.seen}
    assert len(noticed) > 0.6 * len(Condition)


@pytest.mark.parametrize(
    ("fault", "excused"),
    [
        ("odometry frozen", ["mav0"]),
        ("odometry of all frozen", ["mav0", "mav1"]),
        ("odometry jumps for good", []),
    ],
)
def test_only_vehicles_whose_heights_are_false_may_touch_down_hard(
    fault: str, excused: list[str]
) -> None:
    injection = injection_of(fault)
    names = ("mav0", "mav1")
    assert [name for name in names if injection.excuses_touchdown(name, "mav0")] == excused


def test_every_injection_has_a_name_of_its_own() -> None:
    names = [injection.name for injection in INJECTIONS]
    assert len(names) == len(set(names))
