"""Fig. 6: thrust before and after OIST (the law of the paper), and the distances of all pairs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.patheffects import withStroke

from groundstation.figures.data import FlightData, Track
from groundstation.figures.style import (
    LIMIT,
    SOFT,
    colour,
    limit_around_zero,
    line_style,
    new_figure,
    panel_grid,
    title_lines,
)
from onboard.arrays import Array

MAX_PAIRS = 10  # with more pairs, one line for each vehicle shows its nearest neighbour
_MOST_M_S2 = 15.0  # end of the axes of thrust: that of a vehicle that tilts by nearly 60°
_DISTANCES_HEIGHT = 1.5  # of the plot of the distances, as a share of a plot of thrust
_NAMES_IN_A_LINE = 12  # of the legend of the distances
_NAME_PT = 9.0  # size of a line's name
_NAME_SHIFT = 0.045  # from a line to the middle of its name, as a share of the highest line
_PLACES = 200  # along a line, of which its name gets the best
_LETTER = 0.8  # width of a letter over its size, with some room
_POINTS_PER_INCH = 72.0


class _TextPlace(NamedTuple):
    """Where a text stands in the plot of the distances."""

    grid_index: int  # of its middle
    half_width: int  # in points of the grid
    middle_m: float
    room_m: float = 0.0  # of a line's name: to the nearest other line or text


def draw(flight: FlightData) -> Any:
    """Draw thrust on top, with the law's change shaded, and distances below over the full width."""
    columns, blocks = panel_grid(len(flight.tracks))
    thrusts_m_s2 = np.concatenate(
        [
            thrust[:, :2].ravel()
            for track in flight.tracks
            for thrust in (track.thrust_baseline_enu_m_s2, track.thrust_safe_enu_m_s2)
        ]
    )
    limit_m_s2, beyond = limit_around_zero(thrusts_m_s2, least=0.5, most=_MOST_M_S2, unit="m/s²")
    title = f"Thrust before and after OIST, and distances: {flight.title}{beyond}"
    figure = new_figure(max(6.0, 3.7 * columns), 4.2 + 5.0 * blocks, title)
    grid = figure.add_gridspec(
        2 * blocks + 1, columns, height_ratios=[1.0] * (2 * blocks) + [_DISTANCES_HEIGHT]
    )

    first: Any = None  # the first plot, whose axes all others share
    for index, track in enumerate(flight.tracks):
        block, column = divmod(index, columns)
        for row, axis in enumerate("xy"):
            ax = figure.add_subplot(grid[2 * block + row, column], sharex=first, sharey=first)
            if first is None:
                first = ax
            _draw_thrust(ax, track, row, colour(index))

            ax.tick_params(labelbottom=row == 1, labelleft=column == 0)
            if row == 0:
                ax.set_title(track.name, loc="left", color=colour(index))
                # beside the title, so that it hides no curve
                ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=8.5, ncols=2)
            else:
                ax.set_xlabel(flight.time_label)
            if column == 0:
                ax.set_ylabel(f"thrust {axis} [m/s²]")

    first.set_xlim(flight.axis_s)
    first.set_ylim(-limit_m_s2, limit_m_s2)
    _draw_distances(figure.add_subplot(grid[2 * blocks, :], sharex=first), flight)
    return figure


def _draw_thrust(ax: Any, track: Track, axis: int, tint: str) -> None:
    before = track.thrust_baseline_enu_m_s2[:, axis]
    after = track.thrust_safe_enu_m_s2[:, axis]
    ax.fill_between(track.time_s, before, after, color=tint, alpha=0.22, linewidth=0)
    ax.plot(track.time_s, before, color=SOFT, linewidth=1.0, label="before OIST")
    ax.plot(track.time_s, after, color=tint, linewidth=1.3, label="after OIST")


def _draw_distances(ax: Any, flight: FlightData) -> None:
    if len(flight.pairs) <= MAX_PAIRS:
        _draw_pairs(ax, flight)
    else:
        _draw_nearest(ax, flight)
    _draw_limit(ax, flight)
    _draw_closest(ax, flight)
    _, top_m = ax.get_ylim()
    ax.set_ylim(0.0, 1.08 * top_m)

    quantity = "horizontal distance between centres"
    if flight.height_share > 0.0:
        quantity = f"separation (a metre of height counts {flight.height_share:.2f} m)"
    when = "while one of the two flies"
    if len(flight.pairs) > MAX_PAIRS:
        when = "to the nearest neighbour while the vehicle flies"
    title = f"{quantity}, {when} (by {flight.source})"
    ax.set_title(title_lines(title, ax.figure.get_figwidth()), loc="left")
    ax.set_ylabel("distance [m]")
    ax.set_xlabel(flight.time_label)


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
        _name_lines(ax, flight)


def _draw_nearest(ax: Any, flight: FlightData) -> None:
    """Draw a line for each vehicle: the distance to its nearest neighbour, while it flies.

    One that stands is in the lines of those that fly. Its own line would be the distance to the
    nearest one that flies, which is large while only a few do.
    """
    for index, track in enumerate(flight.tracks):
        name = track.name
        distances_m = [
            pair.distance_m for pair in flight.pairs if name in (pair.first, pair.second)
        ]
        nearest_m = np.fmin.reduce(distances_m)
        nearest_m = np.where(track.is_up_at(flight.grid_s), nearest_m, np.nan)
        ax.plot(
            flight.grid_s,
            nearest_m,
            color=colour(index),
            linestyle=line_style(index),
            linewidth=1.4,
            label=name,
        )
    # below the plot, so that it hides no curve
    ax.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.16),
        ncols=min(len(flight.tracks), _NAMES_IN_A_LINE),
        fontsize=8.5,
        title="distance to the nearest neighbour of",
    )


def _draw_limit(ax: Any, flight: FlightData) -> None:
    limit_m = flight.safety_distance_m
    ax.axhline(limit_m, color=LIMIT, linewidth=1.6, linestyle=(0, (6, 2)))

    # at the other end than the number of the smallest distance
    place = 0.005
    side = "left"
    if _is_closest_early(flight):
        place = 0.995
        side = "right"
    ax.annotate(
        _limit_words(limit_m),
        (place, limit_m),
        (0, -11),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha=side,
        color=LIMIT,
        fontsize=9,
    )


def _limit_words(limit_m: float) -> str:
    return f"safety distance {limit_m:.2f} m"


def _distance_words(distance_m: float) -> str:
    return f"{distance_m:.2f} m"


def _is_closest_early(flight: FlightData) -> bool:
    """Whether the smallest distance of all pairs is in the first half of the figure."""
    closest = flight.closest()
    if closest is None:
        return False
    _, grid_index = closest
    return 2 * grid_index < len(flight.grid_s)


def _draw_closest(ax: Any, flight: FlightData) -> None:
    """Mark the smallest distance of all pairs, with its value below it, where no other line is."""
    closest = flight.closest()
    if closest is None:
        return

    pair, grid_index = closest
    time_s = flight.grid_s[grid_index]
    distance_m = pair.distance_m[grid_index]
    ax.plot(time_s, distance_m, "o", color="black", markersize=5)

    # towards the middle of the figure
    shift_pt = -6
    side = "right"
    if _is_closest_early(flight):
        shift_pt = 6
        side = "left"
    ax.annotate(
        _distance_words(distance_m),
        (time_s, distance_m),
        (shift_pt, -14),
        textcoords="offset points",
        ha=side,
        weight="bold",
        fontsize=9.5,
        # readable where the line of the safety distance is behind it
        path_effects=[withStroke(linewidth=3.5, foreground="white")],
    )


def _name_lines(ax: Any, flight: FlightData) -> None:
    """Write the name of each pair above or below its line, where other lines and texts are furthest
    off.
    """
    lines_m = np.stack([pair.distance_m for pair in flight.pairs])
    if not np.isfinite(lines_m).any():
        return

    shift_m = _NAME_SHIFT * float(np.nanmax(lines_m))
    limit_line_m = np.full(len(flight.grid_s), flight.safety_distance_m)
    texts = _other_texts(ax, flight, shift_m)

    for index, pair in enumerate(flight.pairs):
        text = f"{pair.first} – {pair.second}"
        others_m = np.vstack([np.delete(lines_m, index, axis=0), limit_line_m])
        place = _name_place(
            pair.distance_m,
            others_m,
            texts,
            half_width=_half_width(ax, flight, text),
            shift_m=shift_m,
        )
        if place is None:
            continue

        texts.append(place)
        ax.annotate(
            text,
            (flight.grid_s[place.grid_index], place.middle_m),
            fontsize=_NAME_PT,
            ha="center",
            va="center",
            color="#333c44",
        )


def _half_width(ax: Any, flight: FlightData, text: str) -> int:
    """Return half the width of a text, in points of the grid."""
    figure_pt = _POINTS_PER_INCH * float(ax.figure.get_figwidth())
    width_share = _LETTER * _NAME_PT * len(text) / figure_pt
    return round(0.5 * width_share * len(flight.grid_s))


def _other_texts(ax: Any, flight: FlightData, shift_m: float) -> list[_TextPlace]:
    """Return the places of the number of the smallest distance and of the limit's text.

    Both are below what they name, at about the distance of a line's name from its line.
    """
    limit_m = flight.safety_distance_m
    half_width = _half_width(ax, flight, _limit_words(limit_m))
    middle = half_width
    direction = -1
    if _is_closest_early(flight):
        middle = len(flight.grid_s) - half_width
        direction = 1
    texts = [_TextPlace(middle, half_width, limit_m - shift_m)]

    closest = flight.closest()
    if closest is not None:
        pair, grid_index = closest
        distance_m = float(pair.distance_m[grid_index])
        half_width = _half_width(ax, flight, _distance_words(distance_m))
        middle = grid_index + direction * half_width
        texts.append(_TextPlace(middle, half_width, distance_m - shift_m))
    return texts


def _name_place(
    line_m: Array,
    others_m: Array,
    texts: Sequence[_TextPlace],
    *,
    half_width: int,
    shift_m: float,
) -> _TextPlace | None:
    """Return the place beside a line with the most room for its name; None: there is no line.

    Args:
        line_m: distances (n,) of the pair.
        others_m: the other lines (k, n).
        texts: texts that already stand there.
        half_width: half of the name's width, in points of the grid.
        shift_m: height from the line to the middle of the name.
    """
    count = len(line_m)
    margin = count // 20  # no name at the very start or end

    best: _TextPlace | None = None
    for grid_index in np.linspace(margin, count - 1 - margin, _PLACES).astype(int).tolist():
        window = slice(max(0, grid_index - half_width), grid_index + half_width + 1)
        own_m = line_m[window]
        if not np.isfinite(own_m).all():
            continue

        # where lines run together, a name could be that of any
        to_own_m = np.abs(others_m[:, grid_index] - line_m[grid_index])
        for middle_m in (float(own_m.max()) + shift_m, float(own_m.min()) - shift_m):
            gaps_m = np.abs(others_m[:, window] - middle_m)
            room_m = float(min(np.fmin.reduce(gaps_m, axis=None), np.fmin.reduce(to_own_m)))
            for text in texts:
                if abs(text.grid_index - grid_index) < half_width + text.half_width:
                    room_m = min(room_m, abs(text.middle_m - middle_m))
            if best is None or room_m > best.room_m:
                best = _TextPlace(grid_index, half_width, middle_m, room_m)
    return best
