"""Fig. 5: positions and trajectory setpoints, x, y and z over time, a column per vehicle."""

from __future__ import annotations

import math
from typing import Any

from groundstation.figures.data import FlightData
from groundstation.figures.style import PANELS_IN_A_ROW, SOFT, colour, new_figure


def draw(flight: FlightData) -> Any:
    """Draw a row for each axis; the vehicles of a large fleet stand in several blocks of rows."""
    count = len(flight.tracks)
    columns = min(count, PANELS_IN_A_ROW)
    blocks = math.ceil(count / columns)
    title = f"Position and trajectory setpoint: {flight.title}"
    figure = new_figure(max(5.0, 3.7 * columns), 1.0 + 6.4 * blocks, title)
    grid = figure.add_gridspec(3 * blocks, columns)

    begin_s = flight.grid_s[0]
    end_s = max(flight.grid_s[-1], begin_s + 0.1)  # a short record has an axis, too
    first_of_row: dict[int, Any] = {}  # the plots whose axes the others share, for x, y and z
    for index, track in enumerate(flight.tracks):
        block, column = divmod(index, columns)
        for row, axis in enumerate("xyz"):
            same_axis = first_of_row.get(row)
            ax = figure.add_subplot(
                grid[3 * block + row, column], sharex=first_of_row.get(0), sharey=same_axis
            )
            first_of_row.setdefault(row, ax)

            setpoint = track.setpoint_position_enu_m[:, row]
            ax.plot(track.time_s, setpoint, color=SOFT, linestyle=(0, (4, 2)), label="setpoint")
            ax.plot(track.path_time_s, track.path_enu_m[:, row], color=colour(index), label="flown")

            ax.tick_params(labelbottom=row == 2, labelleft=column == 0)
            if row == 0:
                ax.set_title(track.name, loc="left", color=colour(index))
            if column == 0:
                ax.set_ylabel(f"{axis} [m]")
            if row == 2:
                ax.set_xlabel("time since take-off [s]")

    first = first_of_row[0]
    first.set_xlim(begin_s, end_s)
    first.legend(loc="best", fontsize=8.5)
    return figure
