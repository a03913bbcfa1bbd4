"""Joins the pieces of PX4's texts: one STATUSTEXT has room for 50 characters only.

PX4's usual reason for not arming, "Arming denied: Resolve system health failures first", is two
pieces. The second one holds the last letter.
"""

from __future__ import annotations

from typing import Any

_MOST_PIECES = 4  # PX4's texts have up to 127 characters, three pieces


class StatusTexts:
    """The pieces of the newest text that have come."""

    def __init__(self) -> None:
        self._id = -1  # id of the newest text, which all of its pieces carry
        self._pieces: list[bytes] = []

    def joined(self, fields: dict[str, Any]) -> bytes:
        """Return the text to which a piece belongs, with the pieces that have come so far.

        A piece that does not continue the newest text begins a new text. So the rest of a text is
        shown alone if its begin was lost.

        Args:
            fields: fields of the STATUSTEXT.
        """
        piece, _, _ = fields["text"].partition(b"\0")
        number = fields["chunk_seq"]
        if number == 0 or fields["id"] != self._id or number != len(self._pieces):
            self._pieces = []
        if len(self._pieces) < _MOST_PIECES:
            self._pieces.append(piece)
        self._id = fields["id"]
        return b"".join(self._pieces)
