"""Which tests need real time, and which run beside each other.

A test of the files below waits for real processes, sockets or a terminal: it gets the marker
``realtime``. No two of those that need much of the machine run at once, because they would hold
each other up, and beside them one of those that wait for one vehicle or socket. Of the others, the
tests of one file run in one worker.
"""

from __future__ import annotations

import logging
import signal
from pathlib import Path

import pytest

from onboard.rollout import batch

_HERE = Path(__file__).parent
_REAL_TIME = (
    "bench/silence",
    "bench/test_bench_console.py",
    "flight",
    "groundstation/console/test_terminal.py",
    "groundstation/keys/test_running.py",
    "groundstation/processes/test_supervisor.py",
    "onboard/bus",
    "onboard/mocap/test_mocap_relay.py",
    "onboard/mocap/test_sdk_source.py",
    "onboard/process",
)
_ONE_IN_REAL_TIME = (  # one emulated vehicle or one server each
    "clients",
    "groundstation/network/test_attack.py",
    "groundstation/network/test_doctor_links.py",
    "groundstation/px4/test_px4.py",
    "groundstation/px4/test_px4_signing.py",
    "groundstation/web",
    "onboard/px4",
    "sitl/conformance/test_fuzz.py",
    "sitl/conformance/test_sitl_check.py",
    "sitl/test_mavsdk_client.py",
    "sitl/test_server.py",
)
# Long and in simulated time: they run in the same call, in the worker that those of real time leave
# idle, so that `make test` stays short.
_BESIDE_REAL_TIME = (
    "bench/peers/test_paper_flight.py",
    "groundstation/commands/test_plot.py",
    "groundstation/fleet/test_operator_control.py",
    "groundstation/incident/test_moment_and_account.py",
    "onboard/control/test_passing.py",
    "onboard/rollout/test_closed_loop.py",
    "sitl/lockstep/test_dead_links.py",
    "sitl/lockstep/test_fault_suite.py",
    "sitl/lockstep/test_flight.py",
    "sitl/lockstep/test_ground_cut.py",
    "sitl/lockstep/test_lockstep_odometry.py",
    "sitl/lockstep/test_people.py",
    "sitl/lockstep/test_pilots.py",
    "sitl/lockstep/test_poses_lost.py",
    "sitl/lockstep/test_reflight.py",
    "sitl/lockstep/test_taken_fleets.py",
    "sitl/lockstep/test_touchdown.py",
    "sitl/lockstep/test_wind.py",
    "sitl/monte_carlo/test_monte_carlo.py",
    "sitl/monte_carlo/test_scenes.py",
    "sitl/conformance/test_facts.py",
)
# files that take longest, which begin first, so that no worker has one of them left when all others
# are done
_LONGEST = (
    "sitl/lockstep/test_flight.py",
    "sitl/lockstep/test_fault_suite.py",
    "groundstation/identification/test_identify.py",
    "groundstation/commands/test_identify.py",
    "bench/peers/test_bench.py",
    "sitl/monte_carlo/test_monte_carlo.py",
)
# They read all of the code: in one worker they read it once.
_READERS = ("architecture", "onboard/flight/test_flight_table.py")
_GROUPS = {"real time": _REAL_TIME, "one in real time": _ONE_IN_REAL_TIME}
_MISSING = [
    name
    for name in (*_REAL_TIME, *_ONE_IN_REAL_TIME, *_BESIDE_REAL_TIME, *_LONGEST)
    if not (_HERE / name).exists()
]
assert not _MISSING, f"tests/conftest.py names tests that are not there: {_MISSING}"


def pytest_configure() -> None:
    """Take signals as a terminal's programs do: what nohup or a background job ignores, processes
    would inherit. And let a library's thread that outlasts its test find its stream closed.
    """
    logging.raiseExceptions = False
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.hookimpl(tryfirst=True)  # before the workers start
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the control of batches once for all workers; on a clean clone for half a minute."""
    if getattr(session.config.option, "numprocesses", None) and not hasattr(
        session.config, "workerinput"
    ):
        batch.warm_up(has_own_law=True)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Pass over files without a test that is asked for: each worker would read them all."""
    if not collection_path.name.startswith("test_") or collection_path.suffix != ".py":
        return None

    wanted = config.option.markexpr
    path = collection_path.relative_to(_HERE).as_posix()
    if wanted.startswith("realtime"):
        has_any = _is_in_real_time(path) or "pytest.mark.realtime" in collection_path.read_text()
        return None if has_any else True
    if wanted.endswith("not realtime") and _is_in_real_time(path):
        return True
    return None


def _is_in_real_time(path: str) -> bool:
    """Return whether all tests of a file need real time, or run beside those that do."""
    return path in _BESIDE_REAL_TIME or any(_groups_of(path))


def _groups_of(path: str) -> list[str]:
    """Return the groups of those in real time that a file is in: none or one."""
    return [
        group
        for group, names in _GROUPS.items()
        if any(path == name or path.startswith(f"{name}/") for name in names)
    ]


@pytest.hookimpl(tryfirst=True)  # before the groups are read
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that need real time, and name the group that each test runs in."""
    for item in items:
        path = item.path.relative_to(_HERE).as_posix()
        groups = _groups_of(path)
        if _is_in_real_time(path):
            item.add_marker(pytest.mark.realtime)
        if not groups and path.startswith(_READERS):
            groups = ["architecture"]
        item.add_marker(pytest.mark.xdist_group(groups[0] if groups else path))
    begins = {name: index for index, name in enumerate(_LONGEST)}
    items.sort(key=lambda item: begins.get(item.path.relative_to(_HERE).as_posix(), len(begins)))


@pytest.hookimpl(tryfirst=True)  # before the failed tests are written down
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Take off the group behind a test's name, so that ``--last-failed`` finds the test."""
    node = getattr(report, "node", None)
    if node is not None and node.config.option.dist == "loadgroup":
        report.nodeid = report.nodeid.rsplit("@", 1)[0]
