"""Fig. 2: commanded and flown attitude, roll and pitch per vehicle."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.figures.data import FlightData
from groundstation.figures.style import SOFT, colour, new_figure


def draw(flight: FlightData) -> Any:
    """Draw a row per vehicle, with a column each for roll and pitch."""
    rows = len(flight.tracks)
    figure = new_figure(11.0, 1.2 + 2.1 * rows, f"Commanded and flown attitude: {flight.title}")
    axes = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
    for index, track in enumerate(flight.tracks):
        for column, angle in enumerate(("roll", "pitch")):
            ax = axes[index, column]
            ax.plot(
                track.time_s,
                track.commanded_deg[:, column],
                color=SOFT,
                linewidth=1.0,
                label="commanded (setpoint)",
            )
            ax.plot(track.time_s, track.flown_deg[:, column], color=colour(index), label="flown")
            ax.set_title(f"{track.name} {angle}", loc="left", color=colour(index))
            ax.set_xlim(flight.grid_s[0], max(flight.grid_s[-1], flight.grid_s[0] + 0.1))
            ax.axhline(0.0, color="#c5ccd2", linewidth=0.8, zorder=0)
            if column == 0:
                ax.set_ylabel("angle [deg]")
            if index == rows - 1:
                ax.set_xlabel("time since take-off [s]")
    angles = np.concatenate(
        [np.concatenate([track.commanded_deg, track.flown_deg]).ravel() for track in flight.tracks]
    )
    angles = np.abs(angles[np.isfinite(angles)])
    # one spike on the ground must not flatten the flight
    limit_deg = max(2.0, 1.2 * float(np.percentile(angles, 99.8))) if angles.size else 2.0
    axes[0, 0].set_ylim(-limit_deg, limit_deg)
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize=9)
    return figure
