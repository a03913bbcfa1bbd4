"""The form of the code stays within its limits."""

from __future__ import annotations

from tests.architecture import form


def test_the_form_of_the_code_stays_within_its_limits() -> None:
    past = [figure for figure in form.figures() if len(figure.places) > figure.limit]
    assert not past, "\n".join(line for figure in past for line in (figure.name, *figure.places))


def test_circles_are_seen() -> None:
    assert form.circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a <-> b <-> c"]
    assert form.circles({"a": {"b", "c"}, "b": {"c"}}) == []
