"""The gallery from the command line: its list, and a name that is none."""

from __future__ import annotations

import pytest

from groundstation.cli import main
from groundstation.shows.gallery import ACCIDENTS, GALLERY, sentence_of
from onboard.config.example_files import example_names


def test_all_are_listed_with_what_they_show(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gallery"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [line.split()[0] for line in lines if line.startswith("  ") and line[2] != " "]
    assert names == [*GALLERY, *ACCIDENTS]


def test_the_list_says_which_missions_other_commands_do_not_know_by_name(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["gallery"]) == 0
    unknown = sorted({*GALLERY, *ACCIDENTS} - set(example_names("mission file")))
    assert f"(all but {', '.join(unknown)}): covey fly NAME --sitl." in capsys.readouterr().out


def test_the_list_breaks_its_lines_between_words_at_the_width_of_the_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["gallery"]) == 0
    printed = capsys.readouterr().out
    assert max(len(line) for line in printed.splitlines()) <= 80
    assert sentence_of("paper") in " ".join(printed.split())


def test_a_name_that_is_none_is_refused_with_those_that_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["gallery", "nothing"]) == 2
    assert ", ".join((*GALLERY, *ACCIDENTS)) in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "meant"), [("londn", "london"), ("London", "london"), ("swp", "swap")]
)
def test_a_name_that_is_nearly_right_is_refused_with_the_right_one(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "gallery", typed]) == 2
    assert f"Did you mean '{meant}'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--record", "flights/london"], "--record"),
        (["--law", "off"], "--law"),
        (["--seed", "-1"], "--seed is -1"),
    ],
)
def test_an_accident_refuses_options_that_it_does_not_obey(
    options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "gallery", "london", *options]) == 2
    assert sentence in capsys.readouterr().err
