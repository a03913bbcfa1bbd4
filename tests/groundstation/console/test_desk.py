"""What stays in sight on terminals of every size: the fleet, the verdict's reason, later events."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from rich.text import Text

from groundstation.console.app import ConsoleApp
from groundstation.console.history import History
from groundstation.console.panel_sizes import LOW
from groundstation.console.screens.alarms_screen import AlarmList
from groundstation.console.screens.dialogs import HELP, REPLAY_HELP, HelpScreen, QuitScreen
from groundstation.console.screens.preview_screen import PreviewScreen
from tests.groundstation.console.rig import Oracle
from tests.groundstation.console.scenes import SteadyClient, crowd, fly
from tests.groundstation.console.seeing import screen, see, table_of

SIZES = [(160, 48), (120, 40), (100, 30), (80, 20)]
REASON = "mav3 and mav5 were 0.62 m apart at 12.4 s, declared are 0.80 m."
VERDICT = SimpleNamespace(
    exit_status=1,
    summary=f"FAILED: mission 'eight' with law 'covey'. {REASON}",
    sentences=(
        "Closest: mav3 and mav5, 0.62 m between centres, at 12.4 s.",
        "Furthest from a goal on arrival: 0.09 m.",
        "Landed and disarmed: mav0, mav1, mav2, mav3, mav4, mav5, mav6, mav7.",
        f"FAILED: mission 'eight' with law 'covey'. {REASON}",
    ),
)


def eight(**options: Any) -> tuple[SteadyClient, ConsoleApp]:
    """A console with eight vehicles in the air."""
    fleet = crowd(8, "mav{}", 8.0)
    client = SteadyClient(fleet)
    fly(client, 1.0)
    return client, ConsoleApp(fleet, client, forecaster=Oracle(), **options)


def words_of(app: ConsoleApp) -> str:
    """The text of the front screen, with a sentence in one piece where lines were broken."""
    text = " ".join(screen(app)).replace("│", " ")
    return " ".join(text.split())


@pytest.mark.parametrize("text", [HELP, REPLAY_HELP], ids=["fleet", "replay"])
def test_no_line_of_the_help_is_broken_in_a_terminal_of_80_columns(text: str) -> None:
    width = 68 - 2 - 2 - 1  # of the box, without borders, air and scroll bar
    lines = Text.from_markup(text).plain.splitlines()
    assert [line for line in lines if len(line) > width] == []


@pytest.mark.parametrize("size", [SIZES[0], SIZES[-1]])
@pytest.mark.parametrize("kind", [HelpScreen, QuitScreen, PreviewScreen])
async def test_a_dialog_leaves_the_fleet_in_sight(size: tuple[int, int], kind: type) -> None:
    _, app = eight()
    async with app.run_test(size=size) as pilot:
        if kind is PreviewScreen:
            await pilot.press("colon", *"takeoff mav0 1", "enter")
        else:
            await pilot.press("question_mark" if kind is HelpScreen else "q")

        await pilot.pause()
        assert isinstance(app.screen, kind)
        await see(app, pilot)

        shown = [name for name in app.fleet.enabled_names if f" {name} ●" in words_of(app)]
        hidden = 8 - len(shown)
        assert len(shown) >= 6
        assert (f"+{hidden} more" in words_of(app)) == (hidden > 0)
        assert "esc" in words_of(app)


@pytest.mark.parametrize("size", SIZES[1:])
async def test_a_verdict_shows_its_reason_and_covers_no_later_event(size: tuple[int, int]) -> None:
    async def mission() -> object:
        return VERDICT

    _, app = eight(mission=mission)
    async with app.run_test(size=size) as pilot:
        await pilot.pause()
        app.panels.events.add("mav2: a motor is dead.")
        await see(app, pilot)

        text = words_of(app)
        assert REASON in text
        assert "mav2: a motor is dead." in text

        await pilot.press("v")
        await see(app, pilot)
        assert all(sentence in words_of(app) for sentence in VERDICT.sentences)

        await pilot.press("v")
        await see(app, pilot)
        assert "mission failed ─" not in words_of(app)


@pytest.mark.parametrize("is_enlarged", [False, True])
async def test_a_verdict_gives_its_room_to_the_next_flight(is_enlarged: bool) -> None:
    async def mission() -> object:
        return VERDICT

    client, app = eight(mission=mission)

    async def fly_and_see(pilot: Any, *, is_airborne: bool) -> None:
        client.clock_ns += 1_000_000_000
        for name in app.fleet.enabled_names:
            client.hear(name, is_airborne=is_airborne)
        await see(app, pilot)
        await see(app, pilot)

    async with app.run_test(size=(80, 24)) as pilot:
        await fly_and_see(pilot, is_airborne=True)
        assert "v enlarges" in words_of(app), "the flight goes on after its mission"
        await fly_and_see(pilot, is_airborne=False)
        assert "v enlarges" in words_of(app)
        assert not app.panels.separation.is_on_screen
        if is_enlarged:
            await pilot.press("v")
            await see(app, pilot)

        await fly_and_see(pilot, is_airborne=True)
        assert REASON not in words_of(app)
        assert app.panels.separation.is_on_screen

        await pilot.press("v")
        await see(app, pilot)
        assert REASON in words_of(app)
        await fly_and_see(pilot, is_airborne=True)
        assert REASON in words_of(app)


async def test_a_verdict_without_room_says_how_many_lines_are_hidden() -> None:
    sentences = [f"Sentence {number}." for number in range(20)]

    async def mission() -> object:
        return SimpleNamespace(exit_status=0, summary="", sentences=sentences)

    _, app = eight(mission=mission)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause()
        await see(app, pilot)
        await see(app, pilot)
        shown = app.panels.verdict.content_size.height
        assert f"↓ +{20 - shown} more · v enlarges" in words_of(app)

        await pilot.resize_terminal(160, 60)
        await see(app, pilot)
        await see(app, pilot)
        assert "─ v enlarges" in words_of(app)


@pytest.mark.parametrize("width", [80, 36])
@pytest.mark.parametrize("is_judged", [False, True])
async def test_the_worst_alarm_is_in_the_last_row_at_every_height(
    width: int, is_judged: bool
) -> None:
    async def mission() -> object:
        return VERDICT

    _, app = eight(mission=mission if is_judged else None)
    async with app.run_test(size=(width, 30)) as pilot:
        await see(app, pilot)
        for height in range(5, 25):
            await pilot.resize_terminal(width, height)
            await see(app, pilot)
            shown = screen(app)
            assert "LAND ALL" in shown[-1], (height, shown)
            assert any("✖ mav4 – mav5" in row for row in shown[-2:]), (height, shown)
            if height >= LOW:
                assert any(row.startswith(" : ") for row in shown), (height, shown)


@pytest.mark.parametrize("height", [8, 14])
async def test_a_verdict_without_any_room_is_shown_by_its_key(height: int) -> None:
    async def mission() -> object:
        return VERDICT

    _, app = eight(mission=mission)
    async with app.run_test(size=(80, height)) as pilot:
        await see(app, pilot)
        await see(app, pilot)
        assert "v enlarges" not in words_of(app)
        assert app.panels.separation.is_on_screen == (height >= LOW)

        await pilot.press("v")
        await see(app, pilot)
        assert "v hides" in words_of(app)

        await pilot.press("v")
        await see(app, pilot)
        assert "v hides" not in words_of(app)


@pytest.mark.parametrize("height", [12, 13, 15, 17, 20, 24])
async def test_the_newest_event_is_shown_in_a_low_terminal(height: int) -> None:
    _, app = eight()
    async with app.run_test(size=(60, height)) as pilot:
        app.panels.events.add("mav2: dead.")
        await see(app, pilot)
        await see(app, pilot)
        assert "mav2: dead." in words_of(app)
        assert "least" in words_of(app)


async def test_a_low_terminal_counts_the_vehicles_that_have_no_row() -> None:
    _, app = eight()
    async with app.run_test(size=(80, 20)) as pilot:
        await see(app, pilot)
        assert table_of(app).border_subtitle == "↓ +2 more"

        await pilot.press("end")
        await see(app, pilot)
        assert table_of(app).border_subtitle == "↑ +2"


async def test_the_list_of_alarms_is_as_wide_as_the_terminal_from_the_first_picture() -> None:
    client, app = eight()
    async with app.run_test(size=(100, 30)) as pilot:
        near = (0.0, 0.0, 1.0)
        client.hear("mav0", position_enu_m=near)
        client.hear("mav1", position_enu_m=(0.5, 0.0, 1.0))
        await see(app, pilot)

        await pilot.press("A")
        await asyncio.sleep(0)

        shown = [app.screen.query_one(AlarmList).render_line(y).text.rstrip() for y in range(4)]
        assert any(line.endswith("apart, limit 0.80 m") for line in shown), shown


def test_the_clock_counts_from_the_first_vehicle_up_to_the_last_one_down() -> None:
    client, _ = eight()
    history = History()
    begin_ns = client.now_ns()
    assert history.flight_s(begin_ns) is None

    history.add(client.state, begin_ns)
    assert history.flight_s(begin_ns + 83 * 10**9) == pytest.approx(83.0)

    client.clock_ns = begin_ns + 90 * 10**9
    for name in client.fleet.enabled_names:
        client.hear(name, is_airborne=False, is_armed=False, state="ready")
    history.add(client.state, client.now_ns())
    assert history.flight_s(client.now_ns() + 10**9) == pytest.approx(90.0)

    client.clock_ns += 10**9
    client.hear("mav0", is_airborne=True)
    history.add(client.state, client.now_ns())
    assert history.flight_s(client.now_ns() + 10**9) == pytest.approx(1.0)
