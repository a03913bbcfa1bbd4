"""A build of PX4 to fly, and the table of docs/px4-sitl.md that is written when all passed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.px4.build import Px4Build
from tests.px4.table import ROWS, Table

_TABLE = pytest.StashKey[Table]()


@pytest.fixture(scope="session")
def build() -> Px4Build:
    """The build that PX4_BUILD names; skips without one."""
    folder = os.environ.get("PX4_BUILD", "")
    if not folder:
        pytest.skip("no PX4 to fly: make test-px4 PX4_BUILD=/path/to/PX4/build/px4_sitl_default")
    build = Px4Build(Path(folder).resolve())
    if build.problem:
        pytest.skip(build.problem)
    return build


@pytest.fixture(scope="session")
def table(build: Px4Build, request: pytest.FixtureRequest) -> Table:
    """Rows of the table for this build."""
    return request.config.stash.setdefault(_TABLE, Table(build.name))


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Write the table of a run in which everything passed."""
    table = session.config.stash.get(_TABLE, None)
    if table is None:
        return
    print(f"\n{table.text}")
    if exitstatus == pytest.ExitCode.OK and len(table.rows) == ROWS:
        table.write()
        print("Written to docs/px4-sitl.md.")
    else:
        print("Not written to docs/px4-sitl.md: that takes all rows of one run, and all passed.")
