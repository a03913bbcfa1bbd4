"""Fig.

6: thrust before and after OIST, x and y per vehicle, and the distances of all pairs with the limit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.figures.data import FlightData, PairSeparation
from groundstation.figures.style import LIMIT, SOFT, colour, new_figure
from onboard.arrays import Array

MAX_PAIRS = 10


def draw(flight: FlightData) -> Any:
    """Draw thrust on top, with the law's change shaded, and distances below over the full width."""
    columns = len(flight.tracks)
    figure = new_figure(
        max(6.0, 3.7 * columns), 9.2, f"Thrust before and after OIST, and distances: {flight.title}"
    )
    grid = figure.add_gridspec(3, columns, height_ratios=(1.0, 1.0, 1.5))
    first: list[Any] = [None, None]
    for index, track in enumerate(flight.tracks):
        for row, axis in enumerate("xy"):
            ax = figure.add_subplot(grid[row, index], sharex=first[0], sharey=first[0])
            first[0] = first[0] or ax
            before, after = (
                track.thrust_baseline_enu_m_s2[:, row],
                track.thrust_safe_enu_m_s2[:, row],
            )
            ax.fill_between(
                track.time_s, before, after, color=colour(index), alpha=0.22, linewidth=0
            )
            ax.plot(track.time_s, before, color=SOFT, linewidth=1.0, label="before OIST")
            ax.plot(track.time_s, after, color=colour(index), linewidth=1.3, label="after OIST")
            if row == 0:
                ax.set_title(track.name, loc="left", color=colour(index))
                ax.legend(loc="upper right", fontsize=8.5, ncols=2)
            else:
                ax.set_xlabel("time since take-off [s]")
            if index == 0:
                ax.set_ylabel(f"thrust {axis} [m/s²]")
    first[0].set_xlim(flight.grid_s[0], max(flight.grid_s[-1], flight.grid_s[0] + 0.1))
    _limit_thrust(first[0], flight)
    _draw_distances(figure.add_subplot(grid[2, :], sharex=first[0]), flight)
    return figure


def _limit_thrust(ax: Any, flight: FlightData) -> None:
    values = np.concatenate(
        [
            np.concatenate(
                [track.thrust_baseline_enu_m_s2[:, :2], track.thrust_safe_enu_m_s2[:, :2]]
            ).ravel()
            for track in flight.tracks
        ]
    )
    values = np.abs(values[np.isfinite(values)])
    limit = max(0.5, 1.25 * float(np.percentile(values, 99.8))) if values.size else 1.0
    ax.set_ylim(-limit, limit)


def _draw_distances(ax: Any, flight: FlightData) -> None:
    indices = {track.name: index for index, track in enumerate(flight.tracks)}
    if len(flight.pairs) <= MAX_PAIRS:
        for pair in flight.pairs:
            # one line in both vehicles' colours: solid in the first's, dashed over it in the
            # second's
            ax.plot(
                flight.grid_s, pair.distance_m, color=colour(indices[pair.first]), linewidth=2.2
            )
            ax.plot(
                flight.grid_s,
                pair.distance_m,
                color=colour(indices[pair.second]),
                linewidth=2.2,
                linestyle=(0, (3, 3)),
            )
        if flight.pairs:
            _name_lines(ax, flight.grid_s, flight.pairs)
    else:
        for name, index in indices.items():
            own = [pair.distance_m for pair in flight.pairs if name in (pair.first, pair.second)]
            ax.plot(
                flight.grid_s, np.fmin.reduce(own), color=colour(index), linewidth=1.2, label=name
            )
        ax.legend(loc="upper right", ncols=5, fontsize=8, title="distance to the nearest")
    limit_m = flight.safety_distance_m
    ax.axhline(limit_m, color=LIMIT, linewidth=1.6, linestyle=(0, (6, 2)))
    ax.annotate(
        f"safety distance {limit_m:.2f} m", (0.005, limit_m), (0, -11), xycoords=("axes fraction", "data"),
        textcoords="offset points", color=LIMIT, fontsize=9,
    )  # fmt: skip
    closest = flight.closest()
    if closest is not None:
        pair, at = closest
        time_s, distance_m = flight.grid_s[at], pair.distance_m[at]
        ax.plot(time_s, distance_m, "o", color="black", markersize=5)
        ax.annotate(
            f"{distance_m:.2f} m",
            (time_s, distance_m),
            (6, -14),
            textcoords="offset points",
            weight="bold",
            fontsize=9.5,
        )
    ax.set_ylim(0.0, 1.08 * ax.get_ylim()[1])
    what = "horizontal distance between centres"
    if flight.height_share > 0.0:
        what = f"separation (a metre of height counts {flight.height_share:.2f} m)"
    ax.set_title(f"{what}, while one of the two flies (by {flight.source})", loc="left")
    ax.set_ylabel("distance [m]")
    ax.set_xlabel("time since take-off [s]")


def _name_lines(ax: Any, grid_s: Array, pairs: tuple[PairSeparation, ...]) -> None:
    """Write each name where its line is furthest from the others."""
    lines = np.stack([pair.distance_m for pair in pairs])
    margin = len(grid_s) // 20
    for index, pair in enumerate(pairs):
        others = np.abs(np.delete(lines, index, axis=0) - pair.distance_m)
        room = np.fmin.reduce(np.vstack([others, np.full(len(grid_s), 10.0)]))
        room[~np.isfinite(pair.distance_m)] = -1.0
        inner = room[margin : len(room) - margin]
        if inner.size == 0 or inner.max() < 0.0:
            continue
        at = margin + int(np.argmax(inner))
        ax.annotate(
            f"{pair.first} – {pair.second}", (grid_s[at], pair.distance_m[at]), (0, 6), textcoords="offset points",
            fontsize=9, ha="center", color="#333c44",
        )  # fmt: skip
