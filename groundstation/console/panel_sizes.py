"""Share of the terminal that each panel gets. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import Geofence

LOW = 12  # rows below which only the table and what is vital stay
NARROW = 40  # columns below which alarm and keys have a line each
LINES_AROUND = 4  # title, result, order line, status
_TABLE_SHARE = 0.45  # of the height, at most
_PLAN_LEAST = 0.36  # of the width
_PLAN_SHARE = 0.62  # of the width, at most

Size = int | str  # cells, or "1fr" for all that is left


def panel_sizes(
    *, width: int, height: int, vehicles: int, fence: Geofence, alone: str = ""
) -> tuple[Size, Size]:
    """Return the height of the fleet table and the width of the plan.

    The table is as high as its rows while that leaves the plan more than half. The plan is as wide
    as the fence is at its height, since a cell is two dots wide and four high, and not less than
    what numbers and heights take. A low terminal is the table's.

    Args:
        width: of the terminal, in cells.
        height: of the terminal, in cells.
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
