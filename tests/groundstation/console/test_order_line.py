"""Orders by word: pasted, refused, remembered, completed, garbage."""

from __future__ import annotations

import random
from pathlib import Path

import msgspec
import pytest
from textual import events

from groundstation.console.widgets.order_line import OrderLine, completions
from groundstation.console.widgets.result_lines import ResultLines
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.rig import Rig

# character -> name of its key; all others have their own
KEYS = {" ": "space", ":": "colon", "\n": "enter", "\x1b": "escape"}


def type_at_once(rig: Rig, text: str) -> None:
    """Type keys of which none waits until the console has handled the one before it."""
    for character in text:
        rig.app.post_message(events.Key(KEYS.get(character, character), character))


async def test_pasted_lines_become_one_that_only_enter_sends(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        await pilot.press("colon")
        rig.app.panels.order_line.post_message(events.Paste("land mav1\nkill all\n"))
        await pilot.pause(0.05)
        assert rig.app.panels.order_line.value == "land mav1 kill all"
        assert rig.client.ordered == []

        await pilot.press("enter")
        assert rig.client.ordered == []
        await pilot.press("ctrl+u")
        rig.app.panels.order_line.post_message(events.Paste("land mav1\r\n"))
        await pilot.pause(0.05)
        assert rig.client.ordered == []
        await pilot.press("enter")
        assert rig.client.ordered == ["land mav1"]


async def test_letters_typed_right_after_the_colon_are_written_and_are_no_keys(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        line = rig.app.panels.order_line
        table = rig.app.panels.table

        # All keys wait in the terminal already: none of them waits for the line to have the focus.
        type_at_once(rig, ":land 3")
        await pilot.pause(0.05)

        assert line.value == "land 3"
        assert table.marked == ()
        assert not table.is_writing


@pytest.mark.parametrize(
    ("typed", "ordered"),
    [
        (":hold 0\x1b:land all\n", ["land mav0,mav1,mav2"]),
        (":hold 0\n:land all\n", ["hold mav0", "land mav0,mav1,mav2"]),
        (":hodl 0\n\x1b:land all\n", ["land mav0,mav1,mav2"]),
        (":hold 0\x1bj:land 1\n", ["land mav1"]),
    ],
)
async def test_an_order_typed_while_the_console_is_busy_is_given(
    rig: Rig, typed: str, ordered: list[str]
) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        type_at_once(rig, typed)
        await pilot.pause(0.3)
        assert rig.client.ordered == ordered
        assert rig.app.panels.order_line.value == ""
        assert rig.app.focused is rig.app.panels.table


async def test_a_colon_is_a_letter_where_words_are_written(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        line = rig.app.panels.order_line

        await pilot.press("slash", "colon", "a")
        assert rig.app.panels.table.filter == ":a"
        assert rig.app.focused is rig.app.panels.table

        await pilot.press("escape", "colon", *"a:b")
        assert line.value == "a:b"


async def test_a_colon_opens_no_order_line_behind_a_dialog(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("question_mark", "colon", "escape", "space")
        assert rig.app.focused is rig.app.panels.table
        assert rig.app.panels.table.marked == ("mav0",)


@pytest.mark.parametrize("pages", [("enter",), ("A",), ("enter", "A")])
async def test_letters_of_an_order_that_is_begun_on_a_page_are_no_keys_of_the_page(
    rig: Rig, pages: tuple[str, ...]
) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover(show_id="show")
        rig.app.refresh_fleet()
        line = rig.app.panels.order_line

        await pilot.press(*pages, "colon", *"prw")
        assert line.value == "prw"
        assert rig.client.ordered == []

        await pilot.press("escape", "down", *pages, "f4", "w")
        assert line.value == "move mav1 w"
        assert rig.client.ordered == []


async def test_an_operator_who_has_given_an_order_has_left_the_order_line(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        line = rig.app.panels.order_line
        table = rig.app.panels.table
        assert "press :" in rig.screen_text
        assert "esc leaves" not in rig.screen_text

        await pilot.press("colon")
        assert "now write" in rig.screen_text
        assert "esc leaves" in rig.screen_text

        await pilot.press(*"land mav1", "enter")
        await pilot.pause()
        assert rig.client.ordered == ["land mav1"]
        assert (rig.app.focused, line.value) == (table, "")
        assert "press :" in rig.screen_text
        assert "esc leaves" not in rig.screen_text

        await pilot.press("down", "f12", "f12")  # in a hurry: keys are keys again
        assert rig.client.ordered[1:] == ["kill mav1"]

        await rig.preview(pilot, "move mav0 0 1.5 1")
        await pilot.press("escape")
        assert (rig.app.focused, line.value) == (table, "")


async def test_a_refused_order_stays_to_be_corrected_below_the_sentence_that_says_why(
    rig: Rig,
) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        line = rig.app.panels.order_line
        for order in (
            "lnad all",
            "takeoff nobody",
            "land 2-0",
            "land 9",
            "take control now",
            "reset nobody",
            "move all nan 0 1",
        ):
            await pilot.press("escape", "colon")
            line.value = order
            await pilot.press("enter")
            await pilot.pause()
            assert (rig.app.focused, line.value, rig.client.ordered) == (line, order, [])
            assert "esc leaves" in rig.screen_text
            reason = rig.line(ResultLines).strip()
            assert reason[:40] in rig.said, order

        await pilot.press("x", "backspace")
        assert line.value == order
        await pilot.press("ctrl+u", *"hold all", "enter")
        assert rig.client.ordered == ["hold mav0,mav1,mav2"]
        assert (rig.app.focused, line.value) == (rig.app.panels.table, "")
        await pilot.press("colon", *"hodl", "enter", "escape")
        assert (rig.app.focused, line.value) == (rig.app.panels.table, "")


@pytest.mark.long
async def test_earlier_orders_come_back_also_in_the_next_run(
    fleet: FleetConfig, state_home: Path
) -> None:
    for _ in range(2):
        rig = Rig(fleet)
        async with rig.app.run_test(size=(80, 24)) as pilot:
            rig.hover()
            await pilot.press(
                "colon", *"land mav2", "enter", "colon", *"hold mav1", "enter", "colon", *"lan"
            )
            await pilot.press("up", "up")
            assert rig.app.panels.order_line.value == "land mav2"
            await pilot.press("down", "down")
            assert rig.app.panels.order_line.value == "lan"
    assert (state_home / "covey" / "orders").read_text().splitlines() == [
        "land mav2",
        "hold mav1",
    ] * 2
    (state_home / "covey" / "orders").write_bytes(b"\xff\x00\x1b[31m\nland mav0\n" + b"x" * 9000)
    rig = Rig(fleet)
    async with rig.app.run_test(size=(80, 24)) as pilot:
        await pilot.press("colon", "up")
        assert rig.app.panels.order_line.value == "land mav0"


async def test_a_state_folder_that_cannot_be_written_costs_the_memory_only(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/nowhere")
    rig = Rig(fleet)
    async with rig.app.run_test(size=(80, 24)) as pilot:
        await pilot.press("colon", *"land mav1", "enter", "colon", "up")
        assert rig.app.panels.order_line.value == "land mav1"


async def test_a_user_without_a_home_folder_can_write_orders(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    rig = Rig(fleet)
    async with rig.app.run_test(size=(80, 24)) as pilot:
        await pilot.press("colon", *"land mav1", "enter", "colon", "up")
        assert rig.app.panels.order_line.value == "land mav1"


async def test_tab_completes_what_is_certain_and_lists_the_rest(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 24)) as pilot:
        await pilot.press("colon", *"la", "tab", "space", "m", "tab")
        assert rig.app.panels.order_line.value == "land mav"
        assert "mav0  mav1  mav2" in rig.line(ResultLines)
        await pilot.press(*"1,mav2")
        assert rig.app.focused is rig.app.screen.query_one(OrderLine)


def test_completion_knows_lists_formations_and_control(fleet: FleetConfig) -> None:
    assert completions("land mav0,m", fleet) == ["land mav0,mav1", "land mav0,mav2"]
    assert completions("formation triangle a", fleet) == ["formation triangle all"]
    assert completions("take c", fleet) == ["take control", "take control force"]
    assert completions("move mav1 1", fleet) == []


async def test_garbage_never_orders_and_never_breaks(rig: Rig) -> None:
    chance = random.Random(5)
    words = [
        "all",
        "mav0",
        "mav9",
        "9-1",
        "2-0",
        "0-",
        "-1",
        "1e999",
        "nan",
        "in",
        "triangle",
        "",
        "\t",
        "é" * 20,
        "[/b]",
        "take",
        "control",
        "reset",
        "1,,2",
        "force",
        "\x1b[2J",
    ]
    async with rig.app.run_test(size=(80, 24)) as pilot:
        for _ in range(60):
            line = " ".join(chance.choices(words, k=chance.randint(1, 5)))
            rig.app.call_later(rig.app.orders.take_line, line.strip() or "x")
        await pilot.pause(0.3)
        assert rig.client.ordered == []
        assert rig.app.is_running


async def test_all_stands_for_all_and_not_for_names_that_begin_like_them(
    fleet: FleetConfig,
) -> None:
    spare = msgspec.structs.replace(fleet.vehicles["mav2"], name="mav20", enabled=False)
    rig = Rig(msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav20": spare}))
    async with rig.app.run_test(size=(120, 24)) as pilot:
        rig.hover()
        await rig.write(pilot, "land mav0,mav1,mav20")
        assert "land mav0,mav1,mav20" in rig.said
        await rig.write(pilot, "hold all")
        assert "hold all" in rig.said


async def test_a_fleet_of_none_is_a_sentence(fleet: FleetConfig) -> None:
    vehicles = {
        name: msgspec.structs.replace(one, enabled=False) for name, one in fleet.vehicles.items()
    }
    rig = Rig(msgspec.structs.replace(fleet, vehicles=vehicles))
    async with rig.app.run_test(size=(80, 24)) as pilot:
        await pilot.press(
            "ctrl+l", "f7", "f3", "f4", "escape", "w", "f12", "f12", "colon", *"land all", "enter"
        )
        await rig.write(pilot, "takeoff")
        assert rig.client.ordered == []
        assert "nobody to order" in rig.said
