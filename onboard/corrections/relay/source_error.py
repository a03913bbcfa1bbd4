"""The error with which a source of corrections ends, as a sentence."""

from __future__ import annotations


class SourceError(Exception):
    """A source cannot be read (any more); the sentence says what happened, where, and what to do.

    Args:
        sentence: the reason, for people.
        is_refusal: whether the source has refused, so that retrying soon is useless.
    """

    def __init__(self, sentence: str, *, is_refusal: bool = False) -> None:
        super().__init__(sentence)
        self.is_refusal = is_refusal
