from __future__ import annotations

import base64
import hashlib
import re
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.report.flight_page import write_page
from groundstation.report.report_page import OWN_SCRIPTS, _own
from tests.groundstation.report.made_up import opened, rows, story, write

MARKUP = '</script><img src=x onerror="globalThis.hacked = true"><b>'
WAYS_TO_MARKUP = ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(")


@pytest.fixture
def page(tmp_path: Path) -> str:
    names = (f"a{MARKUP}", "mav1")
    told = [*rows(names), *story(names[0], author=MARKUP, sentence=MARKUP)]
    folder = write(tmp_path / "a<script>alert(1)<script>", told)
    (folder / "verdict.json").write_text(
        '{"passed": false, "summary": "</script><script>hacked = true</script>", "checks": 3}'
    )
    return write_page(folder).path.read_text(encoding="utf-8")


def hashes(texts: list[str]) -> set[str]:
    digests = [hashlib.sha256(text.encode()).digest() for text in texts]
    return {f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests}


def policy(page: str) -> dict[str, list[str]]:
    [text] = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    text = text.replace("&#x27;", "'")
    return {part.split()[0]: part.split()[1:] for part in text.split("; ")}


def test_the_policy_names_exactly_the_scripts_and_styles_of_the_page(page: str) -> None:
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    styles = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    allowed = policy(page)

    assert len(scripts) > 5
    assert set(allowed["script-src"]) == hashes(scripts)
    assert set(allowed["style-src"]) == hashes(styles)
    assert allowed["default-src"] == ["'none'"]


def test_no_text_of_a_record_is_markup_in_the_page(page: str) -> None:
    assert "hacked" not in page
    assert "<img" not in page
    assert page.count("<script") == page.count("</script>")
    assert "<title>a&lt;script&gt;alert(1)&lt;script&gt; - Covey</title>" in page


def test_texts_of_a_record_are_in_the_data_as_they_were_written(page: str) -> None:
    [data] = re.findall(r'id="flight">([^<]*)</script>', page)
    header, _ = opened(base64.b64decode(data))

    assert header["vehicles"][1]["name"] == f"a{MARKUP}"
    assert header["verdict"]["passed"] is False


def test_the_page_loads_nothing_from_anywhere(page: str) -> None:
    addresses = set(re.findall(r"""(?:src|href)=["']?([^"'\s>]+)""", page.partition("<body")[0]))

    assert not addresses
    assert "url(" not in page
    assert "@import" not in page


@pytest.mark.parametrize("name", OWN_SCRIPTS)
def test_no_script_makes_elements_from_markup(name: str) -> None:
    assert not [way for way in WAYS_TO_MARKUP if way in _own(name)]


def test_the_command_writes_the_page_beside_the_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path, rows())

    assert main(["report", str(folder)]) == 0

    assert (folder / "report.html").is_file()
    assert "open it in a browser" in capsys.readouterr().out


def test_the_command_refuses_what_is_no_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "flight.mcap").write_bytes(b"<html>no record</html>")

    assert main(["report", str(tmp_path)]) == 2

    assert "this is no MCAP file" in capsys.readouterr().err
    assert not (tmp_path / "report.html").exists()


def test_a_rehearsal_lies_beside_the_record_that_is_named(tmp_path: Path) -> None:
    folder = write(tmp_path / "flight", rows(("mav0", "mav1")))
    write(folder / "rehearsal", rows(("mav0", "mav1")))
    assert main(["report", str(folder / "flight.mcap"), "--rehearse"]) == 0
    assert (folder / "report.html").is_file()


def test_a_flight_of_other_vehicles_is_no_comparison(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "flight", rows(("mav0", "mav1"), length_s=1.0))
    others = write(tmp_path / "others", rows(("cf1", "cf2"), length_s=1.0))
    assert main(["report", str(folder), "--compare", str(others)]) == 2
    said = f"{others} has none of the vehicles of {folder}, but cf1, cf2, so there is nothing"
    assert said in capsys.readouterr().err
    assert not (folder / "report.html").exists()

    some = write(tmp_path / "some", rows(("mav1", "mav2"), length_s=1.0))
    assert main(["report", str(folder), "--compare", str(some)]) == 0
    said = f"{some} does not have these vehicles, which are shown without a ghost: mav0.\n"
    assert said in capsys.readouterr().out

    same = write(tmp_path / "same", rows(("mav0", "mav1"), length_s=1.0))
    assert main(["report", str(folder), "--compare", str(same)]) == 0
    assert "ghost" not in capsys.readouterr().out


def test_a_page_replaces_a_page_and_an_empty_file_and_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "flight", rows())
    notes = tmp_path / "notes.html"
    notes.write_text("<title>My notes</title>")
    empty = tmp_path / "empty"
    empty.touch()

    assert main(["report", str(folder), "--out", str(notes)]) == 2
    assert "no page of a flight, so it is not overwritten" in capsys.readouterr().err
    assert notes.read_text() == "<title>My notes</title>"
    for _ in range(2):
        assert main(["report", str(folder), "--out", str(empty)]) == 0


def test_a_page_may_end_in_part_and_a_file_beside_it_is_left_alone(tmp_path: Path) -> None:
    folder = write(tmp_path / "flight", [*rows(), *story("mav0")])
    mine = tmp_path / "page.part"
    other = tmp_path / "other.part"
    other.write_text("mine")
    assert write_page(folder, out=mine).path.exists()
    write_page(folder, out=tmp_path / "other.html")
    assert other.read_text() == "mine"
