"""Which tests run beside each other: files stay whole, and whatever needs real time runs one after the other.

Real processes that fly in real time and the tests that compute share two cores: one worker flies, the other computes.
"""

from __future__ import annotations

from pathlib import Path

import pytest

_HERE = Path(__file__).parent
# folders and files whose tests wait for real processes, real time or a terminal
_REAL_TIME = (
    "bench/silence",
    "clients",
    "flight",
    "groundstation/commands/test_px4.py",
    "groundstation/console/test_terminal.py",
    "groundstation/processes/test_supervisor.py",
    "onboard/bus",
    "onboard/mocap/test_relay.py",
    "onboard/process",
    "onboard/px4",
    "sitl/test_mavsdk_client.py",
    "sitl/test_server.py",
)


@pytest.hookimpl(tryfirst=True)  # before the groups are read
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each test the group that it is run with."""
    for item in items:
        place = item.path.relative_to(_HERE).as_posix()
        is_real_time = any(place == name or place.startswith(f"{name}/") for name in _REAL_TIME)
        item.add_marker(pytest.mark.xdist_group("real time" if is_real_time else place))
