"""What an operator knows: alarms on every screen, everything about one vehicle, a flight again."""

from __future__ import annotations

import functools
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widget import Widget

from groundstation.console.app import ConsoleApp
from groundstation.console.pipeline_drawing import euler_deg
from groundstation.console.replay_app import ReplayApp, clock
from groundstation.console.screens.alarms_screen import AlarmList, AlarmsScreen
from groundstation.console.screens.vehicle_screen import VehicleBlocks, VehicleScreen
from groundstation.console.widgets.bars import StatusBar
from groundstation.fleet.state import fold
from groundstation.recording.replay import Replay, open_flight
from groundstation.recording.writer import RecordFiles
from onboard.bus.schema import PreflightReport
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.safety.failsafe_table import Condition
from tests.groundstation.console.fake import telemetry
from tests.groundstation.console.scenes import SteadyClient
from tests.groundstation.console.seeing import screen as screen_text
from tests.groundstation.recorded import FLEET as RECORDED_FLEET
from tests.groundstation.recorded import SECOND, record, tick

SIZES = [(80, 24), (120, 40), (200, 60)]


def lines(screen: Screen[Any], kind: type[Widget]) -> str:
    widget = screen.query_one(kind)
    return "\n".join(widget.render_line(y).text for y in range(widget.size.height))


def alarmed(fleet: FleetConfig) -> SteadyClient:
    client = SteadyClient(fleet)
    client.circle(0.0)
    client.hear(
        "mav1",
        position_enu_m=(0.0, 0.0, 1.0),
        conditions=(Condition.LEFT_OFFBOARD.value,),
        mode="POSCTL",
    )
    client.hear("mav2", position_enu_m=(1.5, 1.5, 1.0), conditions=(Condition.LOOP_LATE.value,))
    return client


# -- alarms ----------------------------------------------------------------------------------------


async def test_an_alarm_is_acknowledged_and_stays_in_the_list_until_it_is_over(
    fleet: FleetConfig,
) -> None:
    client = alarmed(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(100, 30)) as pilot:
        await pilot.press("A")
        await pilot.pause(0.3)
        assert isinstance(app.screen, AlarmsScreen)
        listed = lines(app.screen, AlarmList)
        assert listed.index("mav1: PX4 left OFFBOARD") < listed.index("mav2: its loop is late")
        assert "Ask the RC pilot" in listed

        await pilot.press("j", "a")
        await pilot.pause(0.3)
        assert "1 acknowledged" in str(app.screen.query_one(AlarmList).border_title)
        assert "✓" in lines(app.screen, AlarmList)

        await pilot.press("escape", "a")
        await pilot.pause(0.3)
        assert all(line.is_acknowledged for line in app.alarms.lines)
        assert "mav1: PX4 left OFFBOARD" in lines(app.screen, StatusBar)

        client.skew_ns += 100_000_000
        for name in fleet.enabled_names:
            client.hear(
                name, position_enu_m=(3.0 * fleet.enabled_names.index(name) - 3.0, 0.0, 1.0)
            )
        app.refresh_fleet()

        client.skew_ns += 3_200_000_000
        for name in fleet.enabled_names:
            client.hear(
                name, position_enu_m=(3.0 * fleet.enabled_names.index(name) - 3.0, 0.0, 1.0)
            )

        await pilot.press("A")
        await pilot.pause(0.3)
        assert "over" in lines(app.screen, AlarmList)

        # after a minute the time since then is longer, and still apart from the sentence
        client.skew_ns += 100_000_000_000
        app.refresh_fleet()
        await pilot.pause(0.3)
        listed = lines(app.screen, AlarmList)
        assert re.search(r"· 1 min \d+ s ago +mav1: PX4 left OFFBOARD", listed)


async def test_the_bell_rings_once_for_each_new_alarm_and_only_when_wanted(
    fleet: FleetConfig,
) -> None:
    for wanted in (True, False):
        client = alarmed(fleet)
        rung: list[int] = []
        app = ConsoleApp(fleet, client, has_bell=wanted)
        app.bell = functools.partial(rung.append, 1)  # type: ignore[method-assign]
        async with app.run_test(size=(100, 30)) as pilot:
            for _ in range(10):
                app.refresh_fleet()
            await pilot.pause(0.2)
            assert len(rung) == (1 if wanted else 0)


async def test_an_alarm_that_comes_above_the_cursor_is_not_acknowledged_in_its_place(
    fleet: FleetConfig,
) -> None:
    client = SteadyClient(fleet)
    spots = {"mav0": (-3.0, 0.0, 1.0), "mav1": (0.0, 0.0, 1.0), "mav2": (3.0, 0.0, 1.0)}
    for name, spot in spots.items():
        client.hear(name, position_enu_m=spot)
    client.hear("mav2", position_enu_m=spots["mav2"], conditions=(Condition.LOOP_LATE.value,))
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(100, 30)) as pilot:
        await pilot.press("A")
        client.hear("mav1", position_enu_m=spots["mav1"], state="failed", reason="broken")
        app.refresh_fleet()
        await pilot.press("a")

        acknowledged = [line.alarm.subject for line in app.alarms.lines if line.is_acknowledged]
        assert acknowledged == ["mav2"]

        app.refresh_fleet()
        await pilot.press("k", "a")
        assert all(line.is_acknowledged for line in app.alarms.lines)


async def test_the_cursor_stays_among_the_alarms_and_escape_leads_back(fleet: FleetConfig) -> None:
    client = alarmed(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.3)
        await pilot.press("A", *["j"] * 8, *["k"] * 9, "a", "escape")
        assert len(app.screen_stack) == 1


# -- one vehicle -----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES[::2])
async def test_everything_about_one_vehicle_is_on_its_page_at_every_size(
    fleet: FleetConfig, size: tuple[int, int]
) -> None:
    client = alarmed(fleet)
    client.say("mav0 had a thought", vehicle="mav0")
    client.hear(
        "mav0",
        position_enu_m=(0.0, 0.0, 1.0),
        conditions=(Condition.GROUND_LOST.value,),
        action="landing",
        reason="the ground is silent",
    )
    client.tick_stream.values.extend(tick(step * SECOND // 50) for step in range(600))
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=size) as pilot:
        await pilot.press("enter")
        await pilot.pause(0.3)
        assert isinstance(app.screen, VehicleScreen)
        assert client.tick_stream.followed == "mav0"
        page = app.screen.query_one(VehicleBlocks)
        assert "mav0" in str(page.border_title)

        text = lines(app.screen, VehicleBlocks)
        for _ in range(5):
            await pilot.press("pagedown")
            await pilot.pause(0.2)
            text += lines(app.screen, VehicleBlocks)
        for words in (
            "does not hear the ground",
            "landing",
            "the ground is silent",
            "avoided",
            "1.00 for mav1",
            "baseline",
            "measured",
            "mav2",
            "had a thought",
        ):
            assert words in text, words

        await pilot.press("escape")
        await until(pilot, lambda: client.tick_stream.followed is None)


async def test_the_page_says_why_a_vehicle_cannot_fly_and_what_to_do(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    client.hear("mav0", is_airborne=False, is_armed=False, not_ready=("no mocap",))
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("enter")
        await pilot.pause(0.3)
        assert "no mocap" in lines(app.screen, VehicleBlocks)

        report = PreflightReport(
            vehicle="mav0",
            boot_id=1,
            sequence=1,
            stamp_ns=1,
            checks=(
                ("position", False, "no pose since 3 s", "Look whether mocap sees the body."),
                ("battery", True, "87 %", ""),
                ("clock", True, "off by 40 ms", "Run chrony."),
            ),
        )
        client.state = fold(client.state, report, client.now_ns())
        app.refresh_fleet()
        await pilot.pause(0.2)
        text = lines(app.screen, VehicleBlocks)
        for words in (
            "NO-GO: 1 of 3",
            "position: no pose since 3 s",
            "Look whether mocap sees",
            "Run chrony",
            "battery",
        ):
            assert words in text


async def test_the_page_says_for_whom_a_vehicle_stands_in(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    client.hear("mav0", stands_in_for="mav2")
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("enter")
        await pilot.pause(0.02)
        assert "stands in for mav2" in lines(app.screen, VehicleBlocks)


async def test_the_page_shows_the_whole_command_that_is_to_be_copied(fleet: FleetConfig) -> None:
    folder = "/home/somebody/fleets/" + "a_folder_with_a_long_name/" * 4
    command = f"covey px4 signing --set --fleet {folder}fleet.toml --vehicles mav0"
    client = SteadyClient(fleet)
    client.hear("mav0", is_airborne=False, is_armed=False)
    report = PreflightReport(
        vehicle="mav0",
        boot_id=1,
        sequence=1,
        stamp_ns=1,
        checks=(("signing", False, "PX4 does not sign.", f"Give it the key: {command}."),),
    )
    client.state = fold(client.state, report, client.now_ns())
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 40)) as pilot:
        await pilot.press("enter")
        await pilot.pause(0.3)
        text = "".join(line.strip(" │") for line in screen_text(app))
        assert command.replace(" ", "") in text.replace(" ", "")


async def test_the_page_goes_to_the_next_vehicle_and_keys_mean_the_one_that_is_shown(
    fleet: FleetConfig,
) -> None:
    client = SteadyClient(fleet)
    client.circle(0.0)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        # two are marked, the cursor stands on the third
        await pilot.press("space", "space", "enter")
        await pilot.pause(0.3)
        assert "mav2" in str(app.screen.query_one(VehicleBlocks).border_title)
        assert app.orders.selected == ("mav2",)

        await pilot.press("left_square_bracket")
        await pilot.pause(0.3)
        assert "mav1" in str(app.screen.query_one(VehicleBlocks).border_title)

        await pilot.press("f7")
        assert client.ordered == ["land mav1"]

        await pilot.press("f12")
        await pilot.pause(0.3)
        assert "KILL mav1?" in lines(app.screen, StatusBar)
        await pilot.press("f12")
        await until(pilot, lambda: client.ordered[-1] == "kill mav1")

        await pilot.press("ctrl+l")
        assert client.ordered[-1].startswith("land mav0,mav1,mav2")


async def test_a_silent_vehicles_page_claims_nothing_of_the_present(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    client.circle(0.0)
    client.tick_stream.values.extend(tick(step * SECOND // 50) for step in range(600))
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        client.skew_ns = 5_000_000_000
        await pilot.press("enter")
        await pilot.pause(0.3)
        assert "NO TELEM 5" in str(app.screen.query_one(VehicleBlocks).border_title)
        assert "no pipeline values" in lines(app.screen, VehicleBlocks)
        assert "NO TELEM" not in lines(app.screen, StatusBar)
        assert "silent" in lines(app.screen, StatusBar)


@pytest.mark.parametrize("size", [(20, 5), (40, 10), (500, 100)])
async def test_strange_values_and_sizes_give_a_page_and_never_a_traceback(
    fleet: FleetConfig, size: tuple[int, int]
) -> None:
    client = SteadyClient(fleet)
    nan = math.nan
    client.hear(
        "mav0",
        position_enu_m=(nan, 1e300, -1e300),
        yaw_deg=nan,
        battery_frac=nan,
        reason="\x1b[2J" * 99,
        action="\n",
        order_kind="x" * 999,
        velocity_enu_m_s=(1e200, nan, 0.0),
    )
    strange = tick(0)
    for field in ("thrust_baseline_enu_m_s2", "thrust_safe_enu_m_s2"):
        strange = type(strange)(
            **{
                **{name: getattr(strange, name) for name in strange.__struct_fields__},
                field: (nan, math.inf, 1e200),
            }
        )
    client.tick_stream.values.extend([tick(0), strange, tick(1 << 62)])
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=size) as pilot:
        await pilot.press("enter")
        await pilot.pause(0.3)
        assert isinstance(app.screen, VehicleScreen)
        await pilot.resize_terminal(20, 5)
        await pilot.pause(0.2)
        await pilot.resize_terminal(120, 40)
        await pilot.pause(0.2)
        assert "\x1b" not in lines(app.screen, VehicleBlocks)


def test_angles_of_a_quaternion_are_what_they_are() -> None:
    half = math.radians(30.0) / 2.0
    assert euler_deg((math.cos(half), math.sin(half), 0.0, 0.0)) == pytest.approx((30.0, 0.0, 0.0))
    assert euler_deg((math.cos(half), 0.0, math.sin(half), 0.0)) == pytest.approx((0.0, 30.0, 0.0))
    assert euler_deg((2.0 * math.cos(half), 0.0, 0.0, 2.0 * math.sin(half))) == pytest.approx(
        (0.0, 0.0, 30.0)
    )
    assert all(math.isnan(angle) for angle in euler_deg((0.0, 0.0, 0.0, 0.0)))


# -- a flight again --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flights") / "whole")


def replayed(folder: Path) -> Replay:
    fleet, timeline = open_flight(folder)
    return Replay(fleet, timeline)


async def until(pilot: Pilot[int], is_true: Callable[[], bool], limit_s: float = 10.0) -> None:
    """Wait until something has come true; the machine may be busy."""
    for _ in range(int(limit_s / 0.05)):
        if is_true():
            return
        await pilot.pause(0.05)
    assert is_true()


async def test_a_flight_is_played_paused_stepped_and_walked_about_in_by_keys(flight: Path) -> None:
    replay = replayed(flight)
    app = ReplayApp(replay, title="again", at_s=12.0)

    def at(seconds: float) -> bool:
        return replay.seeking is None and abs(replay.position_s - seconds) < 0.011

    async with app.run_test(size=(120, 40)) as pilot:
        await until(pilot, lambda: replay.position_s > 12.2)
        await pilot.press("space")
        stopped_s = replay.position_s
        await pilot.pause(0.2)
        assert replay.position_s == stopped_s
        await pilot.press("full_stop")
        await until(pilot, lambda: at(stopped_s + 0.1))
        await pilot.press("comma")
        await until(pilot, lambda: at(stopped_s))
        await pilot.press("right")
        await until(pilot, lambda: at(stopped_s + 5.0))
        await pilot.press("n")
        await until(pilot, lambda: at(20.0))
        await pilot.press("N")
        await until(pilot, lambda: at(15.0))
        await pilot.press("greater_than_sign")
        assert replay.speed == 2.0
        await pilot.press("end")
        await until(pilot, lambda: replay.is_at_end)
        await pilot.press("home")
        await until(pilot, lambda: at(0.0))
        await until(pilot, lambda: "0:00.0 / 0:39.9" in app.bar.render_line(0).text)


async def test_going_back_takes_back_trails_events_and_alarms(flight: Path) -> None:
    replay = replayed(flight)
    app = ReplayApp(replay, title="again")
    replay.is_playing = False
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("end")
        await until(pilot, lambda: "mav0 at 35 s" in app.panels.events.sentences)
        assert len(app.history.distances) > 170
        await pilot.press("home")
        await until(pilot, lambda: replay.position_s < 0.1)
        await pilot.press("right")
        await until(pilot, lambda: "mav0 at 5 s" in app.panels.events.sentences)
        assert "mav0 at 35 s" not in app.panels.events.sentences
        assert len(app.history.distances) < 30


async def test_nothing_can_be_ordered_in_a_replay_and_letters_are_letters_on_the_order_line(
    flight: Path,
) -> None:
    replay = replayed(flight)
    replay.is_playing = False
    app = ReplayApp(replay, title="again")
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("colon", *"land all", "enter")
        await pilot.pause(0.2)
        assert "recorded flight" in app.panels.events.sentences[-1]
        await pilot.press("escape", "ctrl+l", "f12", "f12")
        await pilot.pause(0.2)
        for key in ("escape", "question_mark", "A"):  # no key is named that would do nothing
            await pilot.press(key)
            await pilot.pause(0.2)
            last = screen_text(app)[-1]
            assert "? help" in last
            assert "LAND ALL" not in last
        await pilot.press("escape")
        assert "recorded flight" in app.panels.events.sentences[-1]
        assert replay.position_s == pytest.approx(0.0, abs=0.01)
        await pilot.press("q")
    assert app.return_value == 0


async def test_the_help_of_a_replay_shows_the_keys_of_the_replay(flight: Path) -> None:
    app = ReplayApp(replayed(flight), title="keys")
    async with app.run_test(size=(80, 40)) as pilot:
        await pilot.press("question_mark")
        await pilot.pause(0.1)
        shown = "\n".join(screen_text(app))
        assert "play, or pause" in shown
        assert "slower, faster" in shown
        assert "KILL" not in shown
        assert "take off" not in shown


async def test_a_vehicle_that_was_not_recorded_is_not_to_be_started_in_a_replay(
    tmp_path: Path,
) -> None:
    shutil.copy(RECORDED_FLEET, tmp_path / "fleet.toml")
    files = RecordFiles(tmp_path, (tmp_path / "flight.mcap").open("wb"), begin_ns=0, begin="a test")
    files.write(Topic.TELEMETRY, "mav0", telemetry("mav0", stamp_ns=SECOND), SECOND)
    files.finish()
    files.close()

    app = ReplayApp(replayed(tmp_path), title="alone")
    async with app.run_test(size=(200, 40)) as pilot:
        await pilot.press("down")
        for key in ("escape", "A", "enter"):  # all screens on which an alarm or a page stands
            await pilot.press(key)
            await pilot.pause(0.2)
            shown = "\n".join(screen_text(app))
            assert "Nothing of it was recorded up to here." in shown, key
            assert "covey agent" not in shown, key
            if key != "escape":
                await pilot.press("escape")


async def test_a_record_that_was_cut_off_says_so_in_the_console(
    flight: Path, tmp_path: Path
) -> None:
    data = (flight / "flight.mcap").read_bytes()
    (tmp_path / "flight.mcap").write_bytes(data[: len(data) // 2])
    shutil.copy(RECORDED_FLEET, tmp_path / "fleet.toml")
    app = ReplayApp(replayed(tmp_path), title="half")
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.3)
        assert any("cut off" in sentence for sentence in app.panels.events.sentences)
        assert "cut off" in app.bar.render_line(0).text


async def test_the_vehicle_page_shows_a_recorded_pipeline_at_once(tmp_path: Path) -> None:
    shutil.copy(RECORDED_FLEET, tmp_path / "fleet.toml")
    files = RecordFiles(tmp_path, (tmp_path / "flight.mcap").open("wb"), begin_ns=0, begin="a test")
    for step in range(250):
        stamp_ns = step * SECOND // 50
        files.write(Topic.TICK, "mav0", tick(stamp_ns), stamp_ns)
        if step % 5 == 0:
            files.write(
                Topic.TELEMETRY,
                "mav0",
                telemetry("mav0", stamp_ns=stamp_ns, sequence=step + 1),
                stamp_ns,
            )
    files.finish()
    files.close()
    replay = replayed(tmp_path)
    replay.is_playing = False
    app = ReplayApp(replay, title="again", at_s=4.0)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.pause(0.3)
        await pilot.press("enter")
        await pilot.pause(0.3)
        assert "1.00 for mav1, saturated" in lines(app.screen, VehicleBlocks)


def test_a_players_clock_reads_as_one() -> None:
    assert [clock(value) for value in (0.0, 59.96, 61.23, 3661.0, -3.0)] == [
        "0:00.0",
        "1:00.0",
        "1:01.2",
        "1:01:01.0",
        "0:00.0",
    ]
