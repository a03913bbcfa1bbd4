"""Fig. 2: commanded and flown attitude, roll and pitch per vehicle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.figures.data import FlightData
from groundstation.figures.style import SOFT, colour, limit_around_zero, new_figure

_MOST_DEG = 60.0  # end of the axes; a vehicle that tilts more than this falls
_MAX_ROWS = 6  # with more vehicles, two stand in a row


def draw(flight: FlightData) -> Any:
    """Draw roll and pitch of a vehicle side by side, of one or two vehicles in a row."""
    count = len(flight.tracks)
    columns = 1
    if count > _MAX_ROWS:
        columns = 2
    rows = math.ceil(count / columns)
    angles_deg = np.concatenate(
        [
            angles.ravel()
            for track in flight.tracks
            for angles in (track.commanded_deg, track.flown_deg)
        ]
    )
    limit_deg, beyond = limit_around_zero(angles_deg, least=2.0, most=_MOST_DEG, unit="deg")
    title = f"Commanded and flown attitude: {flight.title}{beyond}"
    figure = new_figure(4.0 + 7.0 * columns, 1.2 + 2.1 * rows, title)
    grid = figure.add_gridspec(rows, 2 * columns)

    first: Any = None  # the first plot, whose axes all others share
    for index, track in enumerate(flight.tracks):
        tint = colour(index)
        row, place = divmod(index, columns)
        is_lowest = index + columns >= count
        for angle_index, angle in enumerate(("roll", "pitch")):
            column = 2 * place + angle_index
            ax = figure.add_subplot(grid[row, column], sharex=first, sharey=first)
            if first is None:
                first = ax

            ax.plot(
                track.time_s,
                track.commanded_deg[:, angle_index],
                color=SOFT,
                linewidth=1.0,
                label="commanded (setpoint)",
            )
            ax.plot(track.time_s, track.flown_deg[:, angle_index], color=tint, label="flown")
            ax.axhline(0.0, color="#c5ccd2", linewidth=0.8, zorder=0)

            ax.set_title(f"{track.name} {angle}", loc="left", color=tint)
            ax.tick_params(labelbottom=is_lowest, labelleft=column == 0)
            if column == 0:
                ax.set_ylabel("angle [deg]")
            if is_lowest:
                ax.set_xlabel(flight.time_label)

    first.set_xlim(flight.axis_s)
    first.set_ylim(-limit_deg, limit_deg)
    first.legend(loc="upper right", ncols=2, fontsize=9)
    return figure
