"""The fleet above a dialog: the rows of the fleet table, without its keys."""

from __future__ import annotations

from textual.strip import Strip

from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.lines import Lines

_MIN_ROWS = 3  # smallest height, with the heading
_SHARE = 0.4  # largest share of the terminal's height


class FleetGlance(Lines):
    """Rows of a fleet table, for dialogs in front of it.

    Args:
        table: table whose rows, cursor and marks are shown.
    """

    def __init__(self, table: FleetTable) -> None:
        super().__init__(id="glance")
        self._table = table

    def fit(self, height: int) -> None:
        """Set the height for a terminal of this height."""
        self.styles.height = self.height_in(height)

    def height_in(self, height: int) -> int:
        """Return the number of rows: those of the fleet, but less than half of the terminal.

        Args:
            height: height of the terminal, in cells.
        """
        most_rows = max(_MIN_ROWS, round(_SHARE * height))
        return min(self._table.row_count + 1, most_rows)

    def show(self) -> None:
        """Draw the present rows of the table."""
        self.redraw()

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the heading and the rows that have room; the last line counts the hidden rows."""
        return self._table.draw_from(self._table.first_row(height), width, height)
