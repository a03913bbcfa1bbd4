"""A pytest plugin with one fixture: ``lockstep`` makes flights in simulated time for a test.

The flights end with the test. The test fails if a vehicle with full thrust has touched down too
fast. A test in which this is expected sets ``flight.may_land_hard = True`` beforehand.

Example::

    pytest_plugins = ["sitl.lockstep.testing"]

    def test_the_formation_keeps_its_distance(lockstep):
        flight = lockstep("configs/fleets/paper.toml", seed=3)
        assert flight.fly("configs/missions/paper.toml").passed
        assert flight.min_separation_m > 0.8

With ``pytest --flights DIR``, the flights of tests that fail leave a folder below DIR each, as
``covey fly`` does.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from sitl.lockstep.flight import Lockstep


_HAS_FAILED = pytest.StashKey[bool]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of the folder for records."""
    parser.addoption(
        "--flights",
        metavar="DIR",
        help="record the lockstep flights of each test in folders below DIR, and keep those of"
        " tests that fail",
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note whether a test has failed."""
    report = yield
    if report.failed:
        item.stash[_HAS_FAILED] = True
    return report


@pytest.fixture
def lockstep(request: pytest.FixtureRequest) -> Iterator[Callable[..., Lockstep]]:
    """Make a :class:`Lockstep` with its own arguments: fleet, seed, law, bus, mocap, folder."""
    # import here, so that the plugin does not slow tests that do not use the fixture
    from groundstation.flights.flight_settings import create_folder
    from sitl.lockstep.flight import Lockstep

    flights: list[Lockstep] = []
    records: list[Path] = []  # folders that the option has asked for
    records_folder: str | None = request.config.getoption("--flights", default=None)

    def make(*args: Any, **options: Any) -> Lockstep:
        folder: Path | None = options.pop("folder", None)
        if folder is None and records_folder is not None:
            test_name = re.sub(r"[^\w.-]+", "-", request.node.name).strip("-")
            folder = create_folder(Path(records_folder) / test_name)
            records.append(folder)

        flight = Lockstep(*args, folder=folder, **options)
        flights.append(flight)
        if folder in records:
            (folder / "fleet.toml").write_text(flight.config.text, encoding="utf-8")
        return flight

    yield make

    hard: list[str] = []
    for flight in flights:
        if not flight.may_land_hard:
            hard.extend(flight.hard_touchdowns)
        flight.close()

    has_failed = request.node.stash.get(_HAS_FAILED, False) or bool(hard)
    if not has_failed:
        for folder in records:
            shutil.rmtree(folder)
    assert not hard, f"{'. '.join(hard)}."
