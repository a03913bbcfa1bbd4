"""Fig. 5: positions and trajectory setpoints, x, y and z over time, a column per vehicle."""

from __future__ import annotations

from typing import Any

from groundstation.figures.data import FlightData
from groundstation.figures.style import SOFT, colour, new_figure, panel_grid


def draw(flight: FlightData) -> Any:
    """Draw a row for each axis; the vehicles of a large fleet stand in several blocks of rows."""
    columns, blocks = panel_grid(len(flight.tracks))
    title = f"Position and trajectory setpoint: {flight.title}"
    figure = new_figure(max(5.0, 3.7 * columns), 1.0 + 6.4 * blocks, title)
    grid = figure.add_gridspec(3 * blocks, columns)

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
                ax.set_xlabel(flight.time_label)

    first = first_of_row[0]
    first.set_xlim(flight.axis_s)
    first.legend(loc="best", fontsize=8.5)
    return figure
