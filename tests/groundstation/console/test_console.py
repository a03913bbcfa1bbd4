"""What an operator does and sees, with a client that only pretends."""

from __future__ import annotations

import asyncio
import re

import pytest
from textual.widget import Widget
from textual.widgets import Static

from groundstation.console.app import ConsoleApp
from groundstation.console.screens.dialogs import QuitScreen
from groundstation.console.theme import SEVERITY_SIGNS
from groundstation.console.widgets.bars import StatusBar, TitleBar
from groundstation.console.widgets.event_log import EventEntry, EventLog
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.order_line import OrderLine, completions
from groundstation.console.widgets.plan_view import PlanView
from groundstation.console.widgets.result_lines import ResultLines
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient
from tests.groundstation.console.live import until
from tests.groundstation.console.seeing import SIZES, lines, see


def shown(app: ConsoleApp, kind: type[Widget]) -> str:
    return "\n".join(lines(app, kind))


async def test_before_the_first_answer_the_console_names_the_vehicles_it_waits_for(
    fleet: FleetConfig,
) -> None:
    app = ConsoleApp(fleet, FakeClient(fleet), title="first flight")
    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        assert "waiting for 3 vehicles" in shown(app, TitleBar)
        assert shown(app, FleetTable).count("nothing heard from its agent yet") == 3
        assert "Waiting for mav0" in shown(app, StatusBar)


async def test_a_flying_fleet_is_visible_at_every_size(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        client.circle(0.0)
        for size in SIZES:
            await pilot.resize_terminal(*size)
            client.circle(0.0)
            await see(app, pilot)
            table = shown(app, FleetTable)
            assert table.count("● flying") == 3, size
            assert "90%" in table, size
            plan = shown(app, PlanView)
            assert all(f"{index}" in plan for index in range(3)), size
            assert "1.2m" in plan, size
            assert len(plan.split("\n")[0]) == app.screen.query_one(PlanView).size.width, size


async def test_silence_is_never_shown_as_a_fresh_number(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        client.circle(0.0)
        client.skew_ns = int(3.2e9)
        app.refresh_fleet()
        await pilot.pause()
        assert re.search(r"NO TELEM \d+\.\d s", shown(app, FleetTable))
        assert "flying" not in shown(app, FleetTable)
        assert "silent" in shown(app, StatusBar)


async def test_an_order_shows_each_vehicles_answer_as_it_comes(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("colon", *"takeoff all 1.0", "enter")
        await pilot.pause()
        assert client.ordered == ["takeoff mav0,mav1,mav2 1"]
        client.handles[0].update("mav0", "accepted", "")
        client.handles[0].update("mav1", "refused", "its battery is empty")
        await pilot.pause()
        line = shown(app, ResultLines)
        assert "mav0 ▸ accepted" in line
        assert "mav1 ✖ refused" in line
        assert "mav1: its battery is empty" in app.screen.query_one(EventLog).sentences
        await pilot.press("colon", "up")
        assert app.screen.query_one(OrderLine).value == "takeoff all 1.0"


async def test_garbage_on_the_order_line_is_a_sentence_and_no_order(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        for text in [
            "tkeoff all",
            "move all nan 0 1",
            "[bold]x",
            "kill",
            "takeoff all 1.0 2 3",
            "é" * 150,
        ]:
            app.panels.results.show_sentence("")
            await app.orders.order(text)
            await pilot.pause()
            assert client.ordered == [], text
            assert len(shown(app, ResultLines).strip()) > 20, text


async def test_kill_needs_the_same_key_twice_within_a_second(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("down", "f12")
        assert "KILL mav1?" in shown(app, StatusBar)
        client.skew_ns += int(1.2e9)
        await pilot.press("f12")
        await pilot.press("ctrl+backslash")
        assert client.ordered == []
        await pilot.press("ctrl+backslash")
        assert client.ordered == ["kill mav1"]


async def test_q_leaves_at_once_on_the_ground(fleet: FleetConfig) -> None:
    app = ConsoleApp(fleet, FakeClient(fleet))
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("q")
    assert app.return_value == 0


async def test_q_with_flying_vehicles_asks_then_lands_and_leaves_when_they_are_down(
    fleet: FleetConfig,
) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        client.circle(0.0)
        await pilot.press("q")
        assert isinstance(app.screen, QuitScreen)
        await pilot.press("escape")
        assert client.ordered == []
        await pilot.press("q", "y")
        await pilot.pause(0.3)
        assert client.ordered == ["land mav0,mav1,mav2"]
        assert app.is_running
        for name in fleet.enabled_names:
            client.hear(name, is_airborne=False, is_armed=False, state="landed")
        await pilot.pause(0.3)
    assert app.return_value == 0


async def test_ctrl_c_lands_and_a_second_one_leaves_at_once(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        client.circle(0.0)
        await pilot.press("ctrl+c")
        assert client.ordered == ["land mav0,mav1,mav2"]
        await pilot.press("ctrl+c")
    assert app.return_value == 130


@pytest.mark.parametrize("is_told", [True, False])
async def test_vehicles_that_take_off_are_landed_before_the_console_leaves(
    fleet: FleetConfig, is_told: bool
) -> None:
    """An agent that has accepted the order tells it with its next telemetry only."""
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        for name in fleet.enabled_names:
            client.hear(name, state="ready")
        await pilot.press(":", *"takeoff all 1", "enter")
        await pilot.pause(0.1)
        assert client.ordered == ["takeoff mav0,mav1,mav2 1"]
        for name in fleet.enabled_names:
            if is_told:
                client.hear(name, state="taking off", is_armed=True)
            else:
                client.handles[-1].update(name, "accepted", "")

        await pilot.press("q")
        assert isinstance(app.screen, QuitScreen)
        await pilot.press("escape", "ctrl+c")
        assert client.ordered[-1] == "land mav0,mav1,mav2"
        await pilot.press("ctrl+c")
    assert app.return_value == 130


class Verdict:
    def __init__(self, is_passed: bool) -> None:
        self.passed = is_passed
        self.sentences = (
            ["All slots reached within 0.09 m."] if is_passed else ["mav1 never arrived."]
        )


@pytest.mark.parametrize("is_passed", [True, False])
async def test_the_verdict_stays_until_q_and_gives_the_exit_status(
    fleet: FleetConfig, is_passed: bool
) -> None:
    async def mission() -> Verdict:
        await asyncio.sleep(0.05)
        return Verdict(is_passed)

    app = ConsoleApp(fleet, FakeClient(fleet), mission=mission, progress=lambda: "step 1/6")
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.3)
        box = app.screen.query_one("#verdict", Static)
        assert box.display
        assert Verdict(is_passed).sentences[0] in app.screen.query_one(EventLog).sentences
        assert app.is_running
        await pilot.press("q")
    assert app.return_value == (0 if is_passed else 1)


async def test_a_mission_that_breaks_is_a_sentence(fleet: FleetConfig) -> None:
    async def mission() -> None:
        raise OSError("the bus went away")

    app = ConsoleApp(fleet, FakeClient(fleet), mission=mission)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.2)
        assert any(
            "the bus went away" in sentence for sentence in app.screen.query_one(EventLog).sentences
        )
        await pilot.press("q")
    assert app.return_value == 1


NAN = float("nan")
INF = float("inf")
STRANGE: list[dict[str, object]] = [
    {"position_enu_m": (NAN, 0.0, 0.0)},
    {"position_enu_m": (1e300, -1e300, 1e9)},
    {"position_enu_m": (1e5, 0.0, 0.0), "velocity_enu_m_s": (1e308, 0.0, 0.0)},
    {"goal_position_enu_m": (INF, NAN, 0.0)},
    {"goal_position_enu_m": (1e300, 1e300, 0.0)},
    {"battery_frac": NAN, "battery_voltage_v": INF},
    {"battery_frac": -INF},
    {"nearest_distance_m": NAN, "intervention_m_s2": INF, "law_status": "saturated"},
    {"intervention_m_s2": NAN, "law_status": "relaxed", "nearest_vehicle": "nobody"},
    {
        "state": "unheard of",
        "mode": "\x1b[31m\x00\n",
        "reason": "[/b][red]" * 99,
        "order_kind": "見" * 300,
    },
    {"not_ready": ("\x07",), "is_airborne": False, "loop_period_p99_ms": NAN},
]


async def test_strange_telemetry_is_drawn_without_a_traceback(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(200, 60)) as pilot:
        for size in [(200, 60), (20, 5), (1, 1), (80, 24)]:
            await pilot.resize_terminal(*size)
            for changes in STRANGE:
                client.skew_ns += 1_000_000_000
                client.hear("mav0", **changes)
                client.hear("mav1")
                await see(app, pilot)
                assert "\x1b" not in shown(app, FleetTable), changes
                assert app.is_running, changes


async def test_a_flood_of_events_is_bounded_and_keeps_the_screen_alive(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        for number in range(3000):
            client.say(f"event {number} [/]", "warning")
        await until(pilot, lambda: "event 2999" in shown(app, EventLog))
        log = app.screen.query_one(EventLog)
        assert log.sentences[-1] == "mav0: event 2999 [/]"
        assert len(log.sentences) <= 2000


def test_completion_offers_verbs_vehicles_and_formations(fleet: FleetConfig) -> None:
    assert completions("ta", fleet) == ["takeoff"]
    assert completions("land m", fleet) == ["land mav0", "land mav1", "land mav2"]
    assert completions("formation t", fleet) == ["formation triangle"]
    assert completions("", fleet) == []


@pytest.mark.parametrize(
    ("sentence", "shown_sentence"),
    [
        ("mav1 is disarmed.", "mav1 is disarmed."),
        ("mav1: its battery is empty.", "mav1: its battery is empty."),
        ("its battery is empty.", "mav1: its battery is empty."),
        ("mav10 stands 0.50 m away.", "mav1: mav10 stands 0.50 m away."),
        ("mav1-b stands 0.50 m away.", "mav1: mav1-b stands 0.50 m away."),
    ],
)
def test_an_event_begins_with_the_name_of_its_vehicle(sentence: str, shown_sentence: str) -> None:
    entry = EventEntry.of(sentence, SEVERITY_SIGNS["warning"], vehicle="mav1")

    assert entry.sentence == shown_sentence
