"""Share of the terminal that each panel gets. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import Geofence

LOW = 12  # rows below which only the table and what is vital stay
NARROW = 40  # columns below which alarm and keys have a line each
# Rows below which a verdict takes the room of the separation, and that of the plan as well.
TIGHT = 36
SHORT = 22
LINES_AROUND = 4  # title, result, order line, status
_TABLE_SHARE = 0.45  # of the height, at most
_PLAN_LEAST = 0.36  # of the width
_PLAN_SHARE = 0.62  # of the width, at most
_EVENTS_LEAST = 3  # rows that a verdict leaves to the events, with their border
_BESIDE_VERDICT = 6  # rows that it leaves to plan and events where there is room for both
_VERDICT_LEAST = 4  # rows of a verdict, with its border

Size = int | str  # cells, or "1fr" for all that is left


def panel_sizes(
    *, width: int, height: int, vehicles: int, fence: Geofence, alone: str = ""
) -> tuple[Size, Size]:
    """Return the height of the fleet table and the width of the plan.

    The table is as high as its rows while that leaves the plan more than half. The plan is as wide
    as the fence is at its height, since a cell is two dots wide and four high, and not less than
    what numbers and heights take. A low terminal is the table's.

    Args:
        width: width of the terminal, in cells.
        height: height of the terminal, in cells.
        vehicles: rows of the table.
        fence: gives the plan its proportions.
        alone: id of the panel that has all the room; empty for none.
    """
    if height < LOW and not alone:
        alone = "fleet"

    rows_with_frame = max(1, vehicles) + 3
    table_height = min(rows_with_frame, max(4, round(_TABLE_SHARE * height)))

    plan_rows = max(4, height - table_height - LINES_AROUND - 2)
    proportion = min(4.0, (fence.x[1] - fence.x[0]) / (fence.y[1] - fence.y[0]))
    fence_width = math.ceil(2 * plan_rows * proportion) + 6
    plan_width = max(10, round(_PLAN_LEAST * width), min(fence_width, round(_PLAN_SHARE * width)))

    if alone == "fleet":
        return "1fr", plan_width
    if alone == "plan":
        return table_height, "1fr"
    return table_height, plan_width


def verdict_most(height: int, table_height: int) -> int:
    """Return how many rows a verdict takes at most, with its border.

    Events that come after it stay in sight; what has no room of the verdict is shown by enlarging
    it.

    Args:
        height: height of the terminal, in cells.
        table_height: rows of the fleet table.
    """
    rows_left = height - table_height - LINES_AROUND
    left_to_others = _BESIDE_VERDICT if height >= SHORT else _EVENTS_LEAST
    return max(_VERDICT_LEAST, rows_left - left_to_others)
