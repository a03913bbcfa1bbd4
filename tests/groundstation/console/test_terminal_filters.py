"""The console on terminals without Unicode, without colour, dark and light."""

from __future__ import annotations

import os

import pytest
from rich.cells import cell_len
from rich.color import Color

from groundstation.cli import main
from groundstation.console import theme
from groundstation.console.app import ConsoleApp
from groundstation.console.terminal_filters import (
    TerminalFilters,
    is_ascii_wanted,
    is_light_wanted,
    to_ascii,
)
from groundstation.console.widgets.fleet_table import FleetTable
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.scenes import SteadyClient, crowd, ground_and_sky
from tests.groundstation.console.seeing import SIZES, lines, screen, see, strips


@pytest.mark.parametrize("size", SIZES[:2])
async def test_on_a_terminal_without_unicode_every_character_is_ascii_in_its_place(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    client = SteadyClient(crowd(12))
    ground_and_sky(client)
    pictures = []
    for wish in ("0", "1"):
        monkeypatch.setenv("COVEY_ASCII", wish)
        app = ConsoleApp(client.fleet, client)
        async with app.run_test(size=size) as pilot:
            app.time_text = lambda received_ns: "12:00:00"  # type: ignore[method-assign]
            await see(app, pilot)
            pictures.append(screen(app))
            await pilot.press("question_mark")
            await pilot.pause()
            if wish == "1":
                assert all(line.isascii() and line.isprintable() for line in screen(app))
    unicode, ascii_ = pictures
    assert any(not line.isascii() for line in unicode)
    assert all(line.isascii() and line.isprintable() for line in ascii_)
    assert [cell_len(line) for line in ascii_] == [cell_len(line) for line in unicode]
    assert any("* flying" in line for line in ascii_)


@pytest.mark.parametrize(
    ("environ", "is_ascii"),
    [
        ({}, False),
        ({"LANG": "en_US.UTF-8"}, False),
        ({"LANG": "de_DE.utf8"}, False),
        ({"LANG": "C"}, True),
        ({"LC_ALL": "POSIX", "LANG": "en_US.UTF-8"}, True),
        ({"LANG": "en_US.ISO-8859-1"}, True),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, False),
        ({"COVEY_ASCII": "1", "LANG": "en_US.UTF-8"}, True),
        ({"COVEY_ASCII": "0", "LANG": "C"}, False),
    ],
)
def test_ascii_follows_the_locale_unless_covey_ascii_is_set(
    environ: dict[str, str], is_ascii: bool
) -> None:
    assert is_ascii_wanted(environ, is_utf8_forced=False) == is_ascii


def test_a_locale_that_python_has_set_itself_does_not_count() -> None:
    assert is_ascii_wanted({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, is_utf8_forced=True)
    assert not is_ascii_wanted({"LC_CTYPE": "C.UTF-8"}, is_utf8_forced=True)


def test_every_character_has_an_ascii_likeness_of_its_width() -> None:
    for code in [*range(0x20, 0x3100), *range(0x4E00, 0x4E40), *range(0x1F600, 0x1F610)]:
        char = chr(code)
        if char.isprintable():
            plain = to_ascii(char)
            assert plain.isascii()
            assert cell_len(plain) == cell_len(char), hex(code)


async def test_without_colour_no_colour_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    client = SteadyClient(crowd(12))
    ground_and_sky(client)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await see(app, pilot)
        for strip in strips(app):
            for segment in strip:
                for colour in (segment.style.color, segment.style.bgcolor) if segment.style else ():
                    assert colour is None or colour.is_default
        assert sum("▌" in line for line in lines(app, FleetTable)) == 1, "the cursor is a sign"


def _luminance(colour: str) -> float:
    parts = Color.parse(colour).get_truecolor().normalized
    red, green, blue = (
        part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _contrast(one: str, two: str) -> float:
    high, low = sorted((_luminance(one), _luminance(two)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_every_colour_is_read_on_its_ground_dark_and_light() -> None:
    named = {theme.TEXT, theme.FAINT, theme.GOOD, theme.WARN, theme.BAD, theme.KILL, theme.CALM}
    written = named | {*theme.VEHICLE_COLOURS, *theme.HEIGHT_COLOURS}
    for colour in written:
        assert _contrast(colour, theme.GROUND) >= 4.5, colour
        assert _contrast(theme.LIGHT[colour], theme.LIGHT[theme.GROUND]) >= 4.5, colour


@pytest.mark.parametrize(
    ("environ", "is_light"),
    [
        ({}, False),
        ({"COLORFGBG": "0;15"}, True),
        ({"COLORFGBG": "15;0"}, False),
        ({"COLORFGBG": "0;default;15"}, True),
        ({"COLORFGBG": "0;15", "COVEY_THEME": "dark"}, False),
        ({"COVEY_THEME": "light"}, True),
        ({"COLORFGBG": ";"}, False),
    ],
)
def test_a_light_ground_is_known_from_the_environment(
    environ: dict[str, str], is_light: bool
) -> None:
    assert is_light_wanted(environ) == is_light


async def test_t_changes_between_dark_and_light(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLORFGBG", raising=False)
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)

    def grounds() -> set[str]:
        return {
            segment.style.bgcolor.get_truecolor().hex
            for strip in strips(app)
            for segment in strip
            if segment.style and segment.style.bgcolor
        }

    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        assert max(map(_luminance, grounds())) < 0.1
        await pilot.press("t")
        await pilot.pause()
        assert min(map(_luminance, grounds())) > 0.6
        await pilot.press("t")
        await pilot.pause()
        assert max(map(_luminance, grounds())) < 0.1


def test_an_app_reads_the_environment_of_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "COVEY_ASCII", "1")
    assert TerminalFilters().is_ascii


@pytest.mark.parametrize("words", [["--ascii", "--version"], ["tui", "--ascii", "--help"]])
def test_the_flag_stands_anywhere_on_the_command_line(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COVEY_ASCII", "0")
    assert main(words) == 0
    assert os.environ["COVEY_ASCII"] == "1"
