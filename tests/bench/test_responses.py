"""The emulator responds as PX4 was measured to, and the page that says so is up to date."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench import responses
from tests.bench.responses import Row

pytestmark = pytest.mark.long

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sitl.md"


@pytest.fixture(scope="module")
def table() -> list[Row]:
    return responses.rows()


def test_every_response_agrees_with_what_px4_was_measured_to_do(table: list[Row]) -> None:
    assert len(table) > 60
    off = [row.text for row in table if not row.agrees]
    assert not off, "\n".join(off)


def test_the_page_in_the_docs_is_what_the_command_writes(table: list[Row]) -> None:
    written = PAGE.read_text(encoding="utf-8")
    names = [line.split("|")[1].strip() for line in written.splitlines() if line.startswith("| ")][
        1:
    ]
    assert names == [row.what for row in table], "run: make bench-responses"
    for row in table:
        line = next(line for line in written.splitlines() if line.startswith(f"| {row.what} |"))
        shown = float(line.split("|")[4])
        assert shown == pytest.approx(
            row.emulated, rel=0.02, abs=0.5 if row.unit == "ms" else 0.0
        ), row.what
    assert (PAGE.parent / "figures" / "sitl-responses.png").stat().st_size > 20_000


def test_a_figure_that_is_off_is_said_to_be_off() -> None:
    assert Row(what="x", unit="ms", low=100.0, high=110.0, emulated=120.0, slack=10.0).agrees
    assert not Row(what="x", unit="ms", low=100.0, high=110.0, emulated=123.0, slack=10.0).agrees
    assert not Row(what="x", unit="%", low=9.0, high=10.0, emulated=7.9).agrees
    assert "1 of 2 do not: b" in responses.page(
        [
            Row(what="a", unit="-", low=1.0, high=1.0, emulated=1.0),
            Row(what="b", unit="-", low=1.0, high=1.0, emulated=3.0),
        ]
    )
