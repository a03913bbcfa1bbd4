"""Records of flights in other people's tests."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

FLEET = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
TESTS = f"""
def test_twice(lockstep):
    for seed in range(2):
        lockstep({str(FLEET)!r}, seed=seed).run(0.2)
    assert False

def test_passes(lockstep):
    lockstep({str(FLEET)!r}).run(0.2)

def test_has_its_own_folder(lockstep, tmp_path):
    lockstep({str(FLEET)!r}, folder=tmp_path / "own").run(0.2)
    assert (tmp_path / "own" / "flight.mcap").exists()
"""


def test_flights_of_failed_tests_leave_their_records_where_they_are_asked_for(
    pytester: pytest.Pytester,
) -> None:
    pytester.makepyfile(TESTS)
    flown = pytester.runpytest_subprocess("-p", "sitl.lockstep.testing", "--flights=flights")
    flown.assert_outcomes(passed=2, failed=1)

    folders = sorted(pytester.path.glob("flights/*"))
    assert [folder.name for folder in folders] == ["test_twice", "test_twice-2"]
    for folder in folders:
        assert (folder / "flight.mcap").stat().st_size > 1000
        assert (folder / "fleet.toml").read_text() == FLEET.read_text()
