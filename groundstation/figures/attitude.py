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

    begin_s = flight.grid_s[0]
    end_s = max(flight.grid_s[-1], begin_s + 0.1)  # a short record has an axis, too
    for index, track in enumerate(flight.tracks):
        tint = colour(index)
        for column, angle in enumerate(("roll", "pitch")):
            ax = axes[index, column]
            ax.plot(
                track.time_s,
                track.commanded_deg[:, column],
                color=SOFT,
                linewidth=1.0,
                label="commanded (setpoint)",
            )
            ax.plot(track.time_s, track.flown_deg[:, column], color=tint, label="flown")
            ax.axhline(0.0, color="#c5ccd2", linewidth=0.8, zorder=0)

            ax.set_title(f"{track.name} {angle}", loc="left", color=tint)
            ax.set_xlim(begin_s, end_s)
            if column == 0:
                ax.set_ylabel("angle [deg]")
            if index == rows - 1:
                ax.set_xlabel("time since take-off [s]")

    limit_deg = _limit_deg(flight)
    axes[0, 0].set_ylim(-limit_deg, limit_deg)
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize=9)
    return figure


def _limit_deg(flight: FlightData) -> float:
    """Return a scale [deg] for nearly all angles, so that a spike does not flatten the curves."""
    parts = []
    for track in flight.tracks:
        parts.append(track.commanded_deg.ravel())
        parts.append(track.flown_deg.ravel())
    angles_deg = np.concatenate(parts)
    angles_deg = np.abs(angles_deg[np.isfinite(angles_deg)])

    if not angles_deg.size:
        return 2.0
    return max(2.0, 1.2 * float(np.percentile(angles_deg, 99.8)))
