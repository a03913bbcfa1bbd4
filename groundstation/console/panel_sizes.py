"""Sizes of the console's panels for a size of the terminal. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import Geofence

LOW = 12  # height below which only the table and the vital lines are shown
NARROW = 40  # width below which alarm and keys have a line each
TIGHT = 36  # height below which a verdict replaces the separation
SHORT = 22  # height below which a verdict replaces the plan as well
LINES_AROUND = 4  # rows of title, result, order line and status
_TABLE_SHARE = 0.45  # largest share of the height for the table
_PLAN_LEAST_SHARE = 0.36  # smallest share of the width for the plan
_PLAN_MOST_SHARE = 0.62  # largest share of the width for the plan
_EVENTS_LEAST = 3  # rows that a verdict leaves to the events, with their border
_BESIDE_VERDICT = 6  # rows that a verdict leaves to plan and events if both have room
_VERDICT_LEAST = 4  # smallest height of a verdict, with its border
_SPARE = 2  # rows that a verdict leaves at least, for an event and a notice or a long status line
_RIGHT_LEAST = 7  # rows in which separation and events have borders and a row of each is shown

# Smallest sizes of a table and a plan with anything in them.
_TABLE_LEAST = 4  # rows: border, heading and one vehicle
_PLAN_LEAST_ROWS = 4
_PLAN_LEAST_WIDTH = 10
_WIDEST_FENCE = 4.0  # width over depth of a fence; a wider one is drawn smaller

Size = int | str  # cells, or "1fr" for all the remaining room


def panel_sizes(
    *, width: int, height: int, vehicles: int, fence: Geofence, alone: str = ""
) -> tuple[Size, Size]:
    """Return the height of the fleet table and the width of the plan.

    The table is as high as its rows, up to its largest share. The plan is as wide as the fence is
    at the plan's height (a cell is two dots wide and four dots high), but wide enough for numbers
    and heights. In a low terminal only the table is shown.

    Args:
        width: width of the terminal, in cells.
        height: height of the terminal, in cells.
        vehicles: number of rows of the table.
        fence: fence of the fleet, which gives the plan its proportions.
        alone: id of the panel that has all the room; empty for none.
    """
    if height < LOW and not alone:
        alone = "fleet"

    rows_with_frame = max(1, vehicles) + 3  # its border, and the heading
    table_height = min(rows_with_frame, max(_TABLE_LEAST, round(_TABLE_SHARE * height)))

    rows_without_border = height - table_height - LINES_AROUND - 2
    plan_rows = max(_PLAN_LEAST_ROWS, rows_without_border)
    west, east = fence.x
    south, north = fence.y
    proportion = min(_WIDEST_FENCE, (east - west) / (north - south))
    fence_width = math.ceil(2 * plan_rows * proportion) + 6  # with numbers and border
    wanted_width = min(fence_width, round(_PLAN_MOST_SHARE * width))
    plan_width = max(_PLAN_LEAST_WIDTH, round(_PLAN_LEAST_SHARE * width), wanted_width)

    if alone == "fleet":
        return "1fr", plan_width
    if alone == "plan":
        return table_height, "1fr"
    return table_height, plan_width


def is_cramped(height: int, table_height: int) -> bool:
    """Return whether separation and events have so few rows that they go without borders.

    Args:
        height: height of the terminal, in cells.
        table_height: rows of the fleet table.
    """
    return height - table_height - LINES_AROUND < _RIGHT_LEAST


def largest_verdict_height(height: int, table_height: Size) -> int:
    """Return the largest height of a verdict in rows, with its border, that leaves room for events.

    It is 0 where a verdict would push the order line or the worst alarm out of the terminal.

    Args:
        height: height of the terminal, in cells.
        table_height: rows of the fleet table; text if it takes all the room.
    """
    if not isinstance(table_height, int):
        return 0

    rows_below_table = height - table_height - LINES_AROUND
    if rows_below_table < _VERDICT_LEAST + _SPARE:
        return 0

    rows_of_others = _EVENTS_LEAST
    if height >= SHORT:
        rows_of_others = _BESIDE_VERDICT
    return max(_VERDICT_LEAST, rows_below_table - rows_of_others)
