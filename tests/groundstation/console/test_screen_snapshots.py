"""The screens that know, as they were looked at: alarms, one vehicle, a flight again. See
test_snapshots.
"""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import msgspec
import pytest
from textual.pilot import Pilot

from groundstation.console.app import ConsoleApp
from groundstation.console.replay_app import ReplayApp
from groundstation.fleet import state as fleet_state
from groundstation.recording.replay import Replay, open_flight
from onboard.bus.schema import PreflightReport
from onboard.config.fleet import FleetConfig
from onboard.safety.failsafe_table import Condition
from tests.groundstation.console.scenes import SteadyClient
from tests.groundstation.console.test_snapshots import SIZES, Before, Compare
from tests.groundstation.console.test_snapshots import pytestmark as pytestmark
from tests.groundstation.console.test_snapshots import steady as steady
from tests.groundstation.recorded import SECOND, record, tick


def watched(fleet: FleetConfig) -> tuple[SteadyClient, ConsoleApp]:
    """mav0 in trouble, mav1 well and held back by the law, mav2 on the ground and not ready."""
    client = SteadyClient(fleet)
    client.circle(3.0)
    client.hear(
        "mav0",
        position_enu_m=(-1.2, 0.4, 1.0),
        action="landing",
        state="landing",
        reason="bus lost for long",
        conditions=(Condition.BUS_LOST_LONG.value, Condition.BATTERY_WARNING.value),
        battery_frac=0.24,
        order_kind="land",
    )
    client.hear(
        "mav2",
        position_enu_m=(1.5, -1.5, 0.0),
        is_airborne=False,
        is_armed=False,
        state="waiting",
        mode="HOLD",
        not_ready=("no pose",),
    )
    report = PreflightReport(
        vehicle="mav2",
        boot_id=1,
        sequence=1,
        stamp_ns=1,
        checks=(
            (
                "position",
                False,
                "The last pose is 3.1 s old.",
                "Look whether motion capture sees the body.",
            ),
            ("battery", True, "87 %", ""),
            ("link", True, "PX4 answers", ""),
            ("fence", True, "inside", ""),
            ("clock", True, "Its clock is 40 ms off.", "Run chrony on its computer."),
        ),
    )
    client.state = fleet_state.fold(client.state, report, client.now_ns())
    client.say("takeoff: 1.00 m reached.", "info", "mav1", "done")
    client.say("Formation left: hold.", "warning", "mav1")
    for step in range(800):
        held = max(0.0, math.sin(step / 60.0))
        client.tick_stream.values.append(
            msgspec.structs.replace(
                tick(step * SECOND // 50),
                thrust_baseline_enu_m_s2=(1.2 * math.sin(step / 60.0), 2.4 * held, 9.81),
                thrust_safe_enu_m_s2=(1.2 * math.sin(step / 60.0), 0.4 * held, 9.81),
                intervention_m_s2=2.0 * held,
                active_neighbour="mav0",
                neighbour_distances_m={"mav0": 1.02, "mav2": 2.5},
                neighbour_ages_s={"mav0": 0.02, "mav2": 0.03},
                setpoint_quaternion_enu_flu_wxyz=(
                    1.0,
                    0.06 * math.sin(step / 25.0),
                    0.04 * held,
                    0.0,
                ),
                attitude_quaternion_enu_flu_wxyz=(
                    1.0,
                    0.06 * math.sin(step / 25.0 - 0.4),
                    0.03 * held,
                    0.0,
                ),
            )
        )
    return client, ConsoleApp(fleet, client, title="first flight")


def press(app: ConsoleApp, *keys: str) -> Before:
    async def before(pilot: Pilot[int]) -> None:
        app.refresh_fleet()
        await pilot.press(*keys)
        app.refresh_fleet()
        await pilot.pause()

    return before


def test_alarms_with_one_acknowledged(snap_compare: Compare, fleet: FleetConfig) -> None:
    _, app = watched(fleet)
    assert snap_compare(app, terminal_size=SIZES[0], run_before=press(app, "A", "j", "a"))


@pytest.mark.parametrize("size", SIZES)
def test_a_vehicle_that_the_law_holds_back(
    snap_compare: Compare, fleet: FleetConfig, size: tuple[int, int]
) -> None:
    _, app = watched(fleet)
    assert snap_compare(app, terminal_size=size, run_before=press(app, "j", "enter"))


def test_a_vehicle_that_is_not_ready(snap_compare: Compare, fleet: FleetConfig) -> None:
    _, app = watched(fleet)
    assert snap_compare(app, terminal_size=SIZES[1], run_before=press(app, "j", "j", "enter"))


def test_a_vehicle_on_a_light_ground_in_ascii(
    snap_compare: Compare, fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COVEY_THEME", "light")
    monkeypatch.setenv("COVEY_ASCII", "1")
    _, app = watched(fleet)
    assert snap_compare(app, terminal_size=(120, 40), run_before=press(app, "enter"))


def test_a_flight_again(snap_compare: Compare, tmp_path: Path) -> None:
    fleet, timeline = open_flight(record(tmp_path / "flight", 30.0))
    replay = Replay(fleet, timeline)
    replay.is_playing = False
    app = ReplayApp(replay, title="replay of flight")
    # before anything is drawn: what the plan shows grows with what it has seen
    asyncio.run(replay.seek(21.0))
    assert snap_compare(app, terminal_size=SIZES[1], run_before=press(app))
