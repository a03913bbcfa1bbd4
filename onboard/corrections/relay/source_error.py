"""The error that ends a source of corrections, as a sentence."""

from __future__ import annotations


class SourceError(Exception):
    """A source cannot be read, or no longer. The sentence says what happened, where, and what to
    do.

    Args:
        sentence: the reason, for people.
        is_refusal: whether the source has refused, so that an early retry is useless.
    """

    def __init__(self, sentence: str, *, is_refusal: bool = False) -> None:
        super().__init__(sentence)
        self.is_refusal = is_refusal
