"""Joins the pieces of PX4's texts, because one STATUSTEXT has room for only 50 characters.

PX4's usual reason for not arming, "Arming denied: Resolve system health failures first", takes two
pieces. The second holds only the last letter.
"""

from __future__ import annotations

from typing import Any

_MAX_PIECES = 4  # PX4's texts have up to 127 characters, three pieces


class StatusTexts:
    """The pieces of the newest text that have arrived."""

    def __init__(self) -> None:
        self._id = -1  # id of the newest text; all of its pieces carry it
        self._pieces: list[bytes] = []

    def joined(self, fields: dict[str, Any]) -> bytes:
        """Return the text that a piece belongs to, with the pieces that have arrived so far.

        A piece that does not continue the newest text starts a new text. So if the start of a text
        was lost, the rest is shown alone.

        Args:
            fields: fields of the STATUSTEXT.
        """
        piece, _, _ = fields["text"].partition(b"\0")
        number = fields["chunk_seq"]
        if number == 0 or fields["id"] != self._id or number != len(self._pieces):
            self._pieces = []
        if len(self._pieces) < _MAX_PIECES:
            self._pieces.append(piece)
        self._id = fields["id"]
        return b"".join(self._pieces)
