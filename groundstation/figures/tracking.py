"""Fig. 5: positions and trajectory setpoints, x, y and z over time, a column per vehicle."""

from __future__ import annotations

from typing import Any

from groundstation.figures.data import FlightData
from groundstation.figures.style import SOFT, colour, new_figure


def draw(flight: FlightData) -> Any:
    """Draw a row for each axis."""
    columns = len(flight.tracks)
    title = f"Position and trajectory setpoint: {flight.title}"
    figure = new_figure(max(5.0, 3.7 * columns), 7.4, title)
    axes = figure.subplots(3, columns, sharex=True, sharey="row", squeeze=False)

    begin_s = flight.grid_s[0]
    end_s = max(flight.grid_s[-1], begin_s + 0.1)  # a short record has an axis, too
    for index, track in enumerate(flight.tracks):
        for row, axis in enumerate("xyz"):
            ax = axes[row, index]
            setpoint = track.setpoint_position_enu_m[:, row]
            ax.plot(track.time_s, setpoint, color=SOFT, linestyle=(0, (4, 2)), label="setpoint")
            ax.plot(track.path_time_s, track.path_enu_m[:, row], color=colour(index), label="flown")
            ax.set_xlim(begin_s, end_s)

            if row == 0:
                ax.set_title(track.name, loc="left", color=colour(index))
                ax.legend(loc="best", fontsize=8.5)
            if index == 0:
                ax.set_ylabel(f"{axis} [m]")
            if row == 2:
                ax.set_xlabel("time since take-off [s]")
    return figure
