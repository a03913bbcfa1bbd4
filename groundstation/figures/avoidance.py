"""Fig. 6: thrust before and after OIST (the law of the paper), and the distances of all pairs."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.figures.data import FlightData, PairSeparation, Track
from groundstation.figures.style import LIMIT, SOFT, colour, new_figure
from onboard.arrays import Array

MAX_PAIRS = 10  # with more pairs, one line for each vehicle shows its nearest neighbour
_FAR_M = 10.0  # largest room around a line that its name makes use of
_NAME_PT = 9.0  # size of a line's name
_LETTER = 0.8  # width of a letter over its size, with some room
_POINTS_PER_INCH = 72.0


def draw(flight: FlightData) -> Any:
    """Draw thrust on top, with the law's change shaded, and distances below over the full width."""
    columns = len(flight.tracks)
    title = f"Thrust before and after OIST, and distances: {flight.title}"
    figure = new_figure(max(6.0, 3.7 * columns), 9.2, title)
    grid = figure.add_gridspec(3, columns, height_ratios=(1.0, 1.0, 1.5))

    first: Any = None  # the first plot, whose axes all others share
    for index, track in enumerate(flight.tracks):
        for row, axis in enumerate("xy"):
            ax = figure.add_subplot(grid[row, index], sharex=first, sharey=first)
            if first is None:
                first = ax
            _draw_thrust(ax, track, row, colour(index))

            if row == 0:
                ax.set_title(track.name, loc="left", color=colour(index))
                # beside the title, so that it hides no curve
                ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=8.5, ncols=2)
            else:
                ax.set_xlabel("time since take-off [s]")
            if index == 0:
                ax.set_ylabel(f"thrust {axis} [m/s²]")

    begin_s = flight.grid_s[0]
    end_s = max(flight.grid_s[-1], begin_s + 0.1)  # a short record has an axis, too
    first.set_xlim(begin_s, end_s)
    _limit_thrust(first, flight)
    _draw_distances(figure.add_subplot(grid[2, :], sharex=first), flight)
    return figure


def _draw_thrust(ax: Any, track: Track, axis: int, tint: str) -> None:
    before = track.thrust_baseline_enu_m_s2[:, axis]
    after = track.thrust_safe_enu_m_s2[:, axis]
    ax.fill_between(track.time_s, before, after, color=tint, alpha=0.22, linewidth=0)
    ax.plot(track.time_s, before, color=SOFT, linewidth=1.0, label="before OIST")
    ax.plot(track.time_s, after, color=tint, linewidth=1.3, label="after OIST")


def _limit_thrust(ax: Any, flight: FlightData) -> None:
    """Scale the axis to nearly all values, so that a spike does not flatten the curves."""
    parts = []
    for track in flight.tracks:
        parts.append(track.thrust_baseline_enu_m_s2[:, :2].ravel())
        parts.append(track.thrust_safe_enu_m_s2[:, :2].ravel())
    values_m_s2 = np.concatenate(parts)
    values_m_s2 = np.abs(values_m_s2[np.isfinite(values_m_s2)])

    limit_m_s2 = 1.0
    if values_m_s2.size:
        limit_m_s2 = max(0.5, 1.25 * float(np.percentile(values_m_s2, 99.8)))
    ax.set_ylim(-limit_m_s2, limit_m_s2)


def _draw_distances(ax: Any, flight: FlightData) -> None:
    if len(flight.pairs) <= MAX_PAIRS:
        _draw_pairs(ax, flight)
    else:
        _draw_nearest(ax, flight)
    _draw_limit(ax, flight.safety_distance_m)
    _draw_closest(ax, flight)
    _, top_m = ax.get_ylim()
    ax.set_ylim(0.0, 1.08 * top_m)

    quantity = "horizontal distance between centres"
    if flight.height_share > 0.0:
        quantity = f"separation (a metre of height counts {flight.height_share:.2f} m)"
    ax.set_title(f"{quantity}, while one of the two flies (by {flight.source})", loc="left")
    ax.set_ylabel("distance [m]")
    ax.set_xlabel("time since take-off [s]")


def _draw_pairs(ax: Any, flight: FlightData) -> None:
    """Draw a line for each pair, in the colours of both vehicles.

    The line is solid in the colour of the first vehicle, with dashes in that of the second.
    """
    tints = {track.name: colour(index) for index, track in enumerate(flight.tracks)}
    for pair in flight.pairs:
        ax.plot(flight.grid_s, pair.distance_m, color=tints[pair.first], linewidth=2.2)
        ax.plot(
            flight.grid_s,
            pair.distance_m,
            color=tints[pair.second],
            linewidth=2.2,
            linestyle=(0, (3, 3)),
        )
    if flight.pairs:
        _name_lines(ax, flight.grid_s, flight.pairs)


def _draw_nearest(ax: Any, flight: FlightData) -> None:
    """Draw a line for each vehicle: the distance to its nearest neighbour."""
    for index, track in enumerate(flight.tracks):
        name = track.name
        distances_m = [
            pair.distance_m for pair in flight.pairs if name in (pair.first, pair.second)
        ]
        nearest_m = np.fmin.reduce(distances_m)
        ax.plot(flight.grid_s, nearest_m, color=colour(index), linewidth=1.2, label=name)
    # above the plot, so that it hides no curve
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 0.99),
        ncols=len(flight.tracks),
        fontsize=8,
        title="distance to the nearest",
    )


def _draw_limit(ax: Any, limit_m: float) -> None:
    ax.axhline(limit_m, color=LIMIT, linewidth=1.6, linestyle=(0, (6, 2)))
    ax.annotate(
        f"safety distance {limit_m:.2f} m",
        (0.005, limit_m),
        (0, -11),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        color=LIMIT,
        fontsize=9,
    )


def _draw_closest(ax: Any, flight: FlightData) -> None:
    """Mark the smallest distance of all pairs, with its value."""
    closest = flight.closest()
    if closest is None:
        return

    pair, grid_index = closest
    time_s = flight.grid_s[grid_index]
    distance_m = pair.distance_m[grid_index]
    ax.plot(time_s, distance_m, "o", color="black", markersize=5)
    ax.annotate(
        f"{distance_m:.2f} m",
        (time_s, distance_m),
        (6, -14),
        textcoords="offset points",
        weight="bold",
        fontsize=9.5,
        # readable where the line of the safety distance is behind it
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
    )


def _name_lines(ax: Any, grid_s: Array, pairs: tuple[PairSeparation, ...]) -> None:
    """Write the name of each pair where its line is furthest from the other lines.

    A name stands above all of its line that is below it, so that the line does not cross it.
    """
    width_pt = _POINTS_PER_INCH * ax.figure.get_figwidth()
    lines_m = np.stack([pair.distance_m for pair in pairs])
    margin = len(grid_s) // 20  # no name at the very start or end

    for index, pair in enumerate(pairs):
        gaps_m = np.abs(np.delete(lines_m, index, axis=0) - pair.distance_m)
        room_m = np.fmin.reduce(np.vstack([gaps_m, np.full(len(grid_s), _FAR_M)]))
        room_m[~np.isfinite(pair.distance_m)] = -1.0  # there is no line
        inner_m = room_m[margin : len(room_m) - margin]
        if inner_m.size == 0 or inner_m.max() < 0.0:
            continue

        grid_index = margin + int(np.argmax(inner_m))
        name = f"{pair.first} – {pair.second}"
        share = _LETTER * _NAME_PT * len(name) / width_pt
        half = round(0.5 * share * len(grid_s))
        below_m = pair.distance_m[max(0, grid_index - half) : grid_index + half + 1]
        ax.annotate(
            name,
            (grid_s[grid_index], np.nanmax(below_m)),
            (0, 6),
            textcoords="offset points",
            fontsize=_NAME_PT,
            ha="center",
            color="#333c44",
        )
