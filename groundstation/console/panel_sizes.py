"""Share of the terminal that each panel gets. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import Geofence

# rows below which only the table and what is vital stay; columns below which alarm and keys part
LOW, NARROW = 12, 40
LINES_AROUND = 4  # title, result, order line, status
_TABLE_SHARE, _PLAN_LEAST, _PLAN_SHARE = 0.45, 0.36, 0.62

Room = int | str


def panel_sizes(
    width: int, height: int, vehicles: int, fence: Geofence, alone: str = ""
) -> tuple[Room, Room]:
    """Return the height of the fleet table and the width of the plan, in cells, or ``1fr`` for an
    ``alone`` panel.

    The table is as high as its rows while that leaves the plan more than half; the plan as wide as
    the fence is at its height, since a cell is two dots wide and four high, and not less than what
    numbers and heights need. A low terminal is the table's.
    """
    if height < LOW and not alone:
        alone = "fleet"
    table = min(max(1, vehicles) + 3, max(4, round(_TABLE_SHARE * height)))
    rows = max(4, height - table - LINES_AROUND - 2)
    across = min(4.0, (fence.x[1] - fence.x[0]) / (fence.y[1] - fence.y[0]))
    plan = max(
        10,
        round(_PLAN_LEAST * width),
        min(math.ceil(2 * rows * across) + 6, round(_PLAN_SHARE * width)),
    )
    return ("1fr" if alone == "fleet" else table), ("1fr" if alone == "plan" else plan)
