"""Whatever text comes, it takes the cells that it was given and no others."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from groundstation.console import theme
from groundstation.console.canvas import Canvas, Label
from groundstation.console.terminal_filters import to_ascii

SOME = settings(max_examples=150, deadline=None)
TEXT = st.text(max_size=60) | st.text(alphabet="ab無人é́❤️👨‍👩דрa\u200b\u200d\ufe0f🇩🇪", max_size=50)


@SOME
@given(TEXT, st.integers(0, 50), st.booleans())
def test_text_is_fitted_into_exactly_its_width(text: str, width: int, right: bool) -> None:
    clean = theme.clean(text)
    assert clean.isprintable() or not clean
    assert cell_len(theme.fit(clean, width, right=right)) == width
    assert cell_len(theme.fit_name(clean, width)) == width


@SOME
@given(TEXT, st.integers(2, 50))
def test_wrapped_lines_have_the_whole_text_and_no_more_than_their_width(
    text: str, width: int
) -> None:
    clean = theme.clean(text)
    lines = theme.wrap(clean, width, most=200)
    assert max(map(cell_len, lines)) <= width
    assert "".join(lines).replace(" ", "") == clean.replace(" ", "")


@SOME
@given(TEXT)
def test_an_ascii_text_has_as_many_cells_as_the_text_it_replaces(text: str) -> None:
    clean = theme.clean(text)
    plain = to_ascii(clean)
    assert plain.isascii()
    assert cell_len(plain) == cell_len(clean)


@SOME
@given(
    st.lists(st.tuples(st.integers(-9, 29), st.integers(-2, 6), TEXT), max_size=6),
    st.integers(1, 24),
)
def test_a_picture_keeps_its_width_whatever_text_is_written_on_it(
    texts: list[tuple[int, int, str]], width: int
) -> None:
    canvas = Canvas(width, 4)
    canvas.circles(np.array([[3.0, 3.0], [1e9, -1e9], [np.nan, 0.0]]), 5.0, theme.CALM)
    canvas.lines(
        np.array([[0.0, 0.0], [np.nan, 1.0]]), np.array([[90.0, 9.0], [3.0, np.inf]]), theme.BAD
    )
    for column, row, text in texts:
        canvas.text(column, row, theme.clean(text), theme.TEXT)
    assert [strip.cell_length for strip in canvas.strips()] == [width] * 4
    assert [cell_len(strip.text) for strip in canvas.strips()] == [width] * 4


@pytest.mark.parametrize("half", [0, 1])
def test_covering_half_of_a_wide_character_removes_its_other_half(half: int) -> None:
    canvas = Canvas(4, 1)
    canvas.text(0, 0, "\u4e2d\u4e2d", theme.TEXT)
    canvas.text(1 + half, 0, "x", theme.TEXT)
    assert canvas.strips()[0].text == (" x\u4e2d", "\u4e2dx ")[half]


@SOME
@example([(3, 0, 15, 1), (5, 0, 16, 1)])
@example([(5, 0, 1, 0), (4, 0, 2, 0), (6, 0, 3, 0)])
@example([(10, 0, 123, 0), (0, 0, 45, 1)])
@given(
    st.lists(
        st.tuples(st.integers(-2, 13), st.integers(-1, 2), st.integers(0, 199), st.integers(0, 1)),
        max_size=12,
    )
)
def test_a_label_is_drawn_whole_or_not_at_all(
    labels: list[tuple[int, int, int, int]],
) -> None:
    canvas = Canvas(11, 2)
    for row in (0, 1):
        canvas.text(0, row, "×→" * 5, theme.TEXT)  # which labels may cover
    columns = canvas.labels(
        [
            Label(column, row, f"{'✓' * lead}{number}", theme.TEXT, lead)
            for column, row, number, lead in labels
        ]
    )
    expected: list[list[str]] = [[], []]
    written = [(at, *label) for at, label in zip(columns, labels, strict=True) if at is not None]
    for at, column, row, number, lead in sorted(written):
        expected[row].append(str(number))
        assert abs(at - (column - lead)) <= 3
    shown = [strip.text for strip in canvas.strips()]
    assert [re.findall(r"\d+", line) for line in shown] == expected

    for begin, (column, row, _, _) in zip(columns, labels, strict=True):
        if 0 <= column < 11 and 0 <= row < 2:
            assert shown[row][column] not in "×→", "a label, or a dot"
        else:
            assert begin is None
    if expected != [[], []]:
        first = next(label for label in labels if 0 <= label[0] < 11 and 0 <= label[1] < 2)
        assert str(first[2]) in expected[first[1]]


@pytest.mark.parametrize("column", range(2, 8))
def test_no_number_of_the_grid_goes_on_from_a_label(column: int) -> None:
    canvas = Canvas(11, 1)
    canvas.text(4, 0, "-10", theme.TEXT)
    assert canvas.labels([Label(column, 0, "5", theme.TEXT)]) == [column]
    shown = canvas.strips()[0].text
    assert re.findall(r"[-.\d]+", shown) == (["5", "-10"] if column == 2 else ["5"])


@SOME
@example(values=[1e308], width=1, top=1.0)
@example(values=[1e308], width=1, top=0.1)
@given(st.lists(st.floats(), max_size=40), st.integers(0, 30), st.floats(0.1, 1e6))
def test_a_spark_is_drawn_for_any_number(values: list[float], width: int, top: float) -> None:
    assert cell_len(theme.spark(values, width, top)) == width
