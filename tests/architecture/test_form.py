"""The form of the code stays within its limits."""

from __future__ import annotations

import pytest

from tests.architecture import form

FIGURES = form.figures()


@pytest.mark.parametrize("figure", FIGURES, ids=[figure.name.replace(" ", "-") for figure in FIGURES])
def test_the_form_of_the_code_stays_within_its_limits(figure: form.Figure) -> None:
    assert len(figure.places) <= figure.limit, "\n".join([figure.name, *figure.places])


def test_circles_are_seen() -> None:
    assert form.circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a <-> b <-> c"]
    assert form.circles({"a": {"b", "c"}, "b": {"c"}}) == []
