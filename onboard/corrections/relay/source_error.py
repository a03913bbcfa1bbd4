"""The error by which a source of corrections ends: a sentence."""

from __future__ import annotations


class SourceError(Exception):
    """A source cannot be read, or not any more: what happened, where, and what to do.

    Args:
        sentence: for people.
        is_refusal: somebody there has said no; asking again soon changes nothing.
    """

    def __init__(self, sentence: str, *, is_refusal: bool = False) -> None:
        super().__init__(sentence)
        self.is_refusal = is_refusal
