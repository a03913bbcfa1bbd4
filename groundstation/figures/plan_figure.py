"""Fig. 4: trajectories from above, with time marks, starts, slots, persons, closest approach."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.patches import Circle, Polygon

from groundstation.figures.data import FlightData, Track
from groundstation.figures.style import LIMIT, SOFT, colour, line_style, new_figure
from onboard.arrays import Array

_SAME_M = 0.05  # slots that are nearer to each other than this are one
_MOST_NUMBERS = 5  # of more orders to one slot, only the first ones and the last one are written
_LABEL_ROOM_M = 0.15  # least distance of two labelled time marks of one path
_DASHED = (0, (4, 3))
# Possible positions of a number beside its slot, x and y, in half widths and heights of the number.
_SIDES = np.array(
    [[1, -1], [-1, -1], [-1, 1], [1, 1], [0, -1.3], [0, 1.3], [-1.3, 0], [1.3, 0]], np.float64
)
_STEPS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0)  # possible steps of time marks
_MAX_STEPS = 14.0  # time marks on a path
_TIME_SHIFT_PT = (9.0, 8.0)  # distance from a mark to the middle of its time
_SLOT_SHIFT_PT = (8.0, 7.0)  # distance from a slot to the edge of its number
_ENOUGH_ROOM_PT = 40.0  # more room does not make a number easier to read


class _SlotLabel(NamedTuple):
    """The numbers of the orders that went to one slot."""

    position_m: Array  # (2,)
    text: str
    tint: str


def draw(flight: FlightData) -> Any:
    """Draw the plan view, with east to the right, north up, and the same scale for both."""
    figure = new_figure(9.0, 8.6, f"Trajectories from above: {flight.title}")
    ax = figure.subplots()

    step_s = _step_s(float(flight.grid_s[-1] - flight.grid_s[0]))
    mark_times_s = np.arange(0.0, flight.grid_s[-1], step_s)

    marks_m: list[Array] = []
    labels: list[_SlotLabel] = []
    for index, track in enumerate(flight.tracks):
        tint = colour(index)
        _draw_path(ax, flight, track, index)
        marks_m.append(_draw_time_marks(ax, track, mark_times_s, tint))
        _draw_start(ax, track, tint)
        for slot_m, orders in _slots(track.slots_enu_m[:, :2]):
            ax.plot(*slot_m, "+", color=tint, markersize=15, markeredgewidth=2.2)
            labels.append(_SlotLabel(slot_m, orders, tint))

    draw_outlines(ax, flight)
    _draw_walks(ax, flight)
    _draw_closest(ax, flight)
    _draw_frame(ax, step_s, vehicles=len(flight.tracks))
    _write_slot_labels(figure, ax, labels, np.concatenate([np.zeros((0, 2)), *marks_m]))
    return figure


def _step_s(length_s: float) -> float:
    """Return the time between two marks of a flight."""
    for step_s in _STEPS_S:
        if length_s / step_s <= _MAX_STEPS:
            return step_s
    return _STEPS_S[-1]


def _draw_path(ax: Any, flight: FlightData, track: Track, index: int) -> None:
    setpoint_m = track.setpoint_position_enu_m[track.time_s >= 0.0]
    ax.plot(setpoint_m[:, 0], setpoint_m[:, 1], color=SOFT, linewidth=0.9, linestyle=_DASHED)

    flown_m = track.path_enu_m[track.path_time_s >= flight.grid_s[0]]
    ax.plot(
        flown_m[:, 0],
        flown_m[:, 1],
        color=colour(index),
        linestyle=line_style(index),
        linewidth=2.0,
        label=track.name,
    )


def _draw_time_marks(ax: Any, track: Track, times_s: Array, tint: str) -> Array:
    """Draw marks at these times, labelled where no other is near; return the marks (n, 2) [m].

    The label at time 0, where the vehicle stands, is its name.
    """
    marks_m = track.path_at(times_s)
    ax.plot(marks_m[:, 0], marks_m[:, 1], "o", color="white", markeredgecolor=tint, markersize=5.5)

    written_m: list[Array] = []
    for time_s, mark_m in zip(times_s, marks_m, strict=True):
        position_m = mark_m[:2]
        is_known = bool(np.isfinite(position_m).all())
        is_free = all(math.dist(position_m, other_m) > _LABEL_ROOM_M for other_m in written_m)
        if not is_known or not is_free:
            continue

        text = f"{time_s:g}"
        weight = "normal"
        if time_s == 0.0:
            text = track.name
            weight = "bold"
        ax.annotate(
            text,
            position_m,
            (4, 4),
            textcoords="offset points",
            fontsize=8,
            weight=weight,
            color=tint,
        )
        written_m.append(position_m)

    return marks_m[np.isfinite(marks_m).all(-1)][:, :2]


def _draw_start(ax: Any, track: Track, tint: str) -> None:
    known_m = track.path_enu_m[np.isfinite(track.path_enu_m).all(-1)]
    if len(known_m):
        ax.plot(*known_m[0, :2], "s", color=tint, markersize=9, markeredgecolor="white")


def _slots(goals_m: Array) -> list[tuple[Array, str]]:
    """Return the slots (2,), each with the numbers of the orders that went to it.

    Args:
        goals_m: goals (n, 2) of all orders, in the order in which they were given.
    """
    slots_m: list[Array] = []
    orders: list[list[str]] = []  # of each slot
    for number, goal_m in enumerate(goals_m, start=1):
        for index, slot_m in enumerate(slots_m):
            if math.dist(slot_m, goal_m) < _SAME_M:
                orders[index].append(str(number))
                break
        else:
            slots_m.append(goal_m)
            orders.append([str(number)])
    return [(slot_m, _listed(numbers)) for slot_m, numbers in zip(slots_m, orders, strict=True)]


def _listed(numbers: list[str]) -> str:
    """Return the numbers of a slot's orders as a text that stays short."""
    if len(numbers) <= _MOST_NUMBERS:
        return ", ".join(numbers)
    first = ", ".join(numbers[: _MOST_NUMBERS - 2])
    return f"{first}, … {numbers[-1]} ({len(numbers)} orders)"


def draw_outlines(ax: Any, flight: FlightData) -> None:
    """Draw areas to stay in as outlines, and what to stay out of as surfaces.

    Args:
        ax: axes of matplotlib, in metres.
        flight: holds the outlines of fences and obstacles.
    """
    for outline in flight.outlines:
        edge = LIMIT
        face: Any = to_rgba(LIMIT, 0.12)
        if outline.keeps_in:
            edge = SOFT
            face = "none"
        patch = Polygon(
            outline.corners_enu_m,
            facecolor=face,
            edgecolor=edge,
            linewidth=1.2,
            zorder=0.5,
        )
        ax.add_patch(patch)
        ax.annotate(
            outline.name,
            outline.corners_enu_m[0],
            (3, 3),
            textcoords="offset points",
            fontsize=8,
            color=edge,
        )


def _draw_walks(ax: Any, flight: FlightData) -> None:
    """Draw the walk of each person, and the circle when two vehicles were closest."""
    time_s = 0.0
    closest = flight.closest()
    if closest is not None:
        time_s = float(flight.grid_s[closest[1]])

    for walk in flight.walks:
        path_m = walk.position_enu_m
        ax.plot(path_m[:, 0], path_m[:, 1], color=LIMIT, linewidth=0.9, alpha=0.6)
        east_m, north_m, _ = walk.position_at(time_s)
        ax.add_patch(Circle((east_m, north_m), walk.radius_m, fill=False, color=LIMIT, lw=1.2))
        ax.annotate(
            walk.name,
            (east_m, north_m + walk.radius_m),
            (0, 3),
            textcoords="offset points",
            fontsize=9,
            color=LIMIT,
            ha="center",
        )


def _draw_closest(ax: Any, flight: FlightData) -> None:
    """Draw the two vehicles that came closest to each other, at that moment."""
    closest = flight.closest()
    if closest is None:
        return
    pair, grid_index = closest

    positions_m = {}
    for index, track in enumerate(flight.tracks):
        if track.name not in (pair.first, pair.second):
            continue
        position_m = track.path_at(flight.grid_s[grid_index : grid_index + 1])[0, :2]
        positions_m[track.name] = position_m
        x_m, y_m = position_m
        ring = Circle(
            (float(x_m), float(y_m)),
            flight.safety_distance_m / 2.0,
            fill=False,
            color=colour(index),
            lw=1.2,
            alpha=0.75,
        )
        ax.add_patch(ring)
        ax.plot(*position_m, "o", color=colour(index), markersize=7)

    ends_m = np.array([positions_m[pair.first], positions_m[pair.second]])
    ax.plot(ends_m[:, 0], ends_m[:, 1], color=LIMIT, linewidth=1.2)

    record_s = flight.take_off_s + flight.grid_s[grid_index]
    ax.set_title(
        f"closest: {pair.first} and {pair.second}, {pair.distance_m[grid_index]:.2f} m at "
        f"{record_s:.1f} s of the record; "
        f"the circles touch at {flight.safety_distance_m:.2f} m (by {flight.source})",
        loc="left",
        fontsize=9.5,
        fontweight="normal",
    )


def _draw_frame(ax: Any, step_s: float, *, vehicles: int) -> None:
    """Draw the legend and the names of the axes."""
    ax.plot([], [], "s", color=SOFT, label="start")
    ax.plot([], [], "+", color=SOFT, markersize=12, markeredgewidth=2, label="slot, in order")
    ax.plot([], [], color=SOFT, linewidth=0.9, linestyle=_DASHED, label="setpoint")
    ax.plot([], [], "o", color="white", markeredgecolor=SOFT, label=f"every {step_s:g} s")

    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.06)
    ax.set_xlabel("x, east [m]")
    ax.set_ylabel("y, north [m]")
    ax.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.07),
        ncols=min(8, vehicles + 4),  # the vehicles, and the four marks above
        fontsize=9,
    )


def _write_slot_labels(figure: Any, ax: Any, labels: list[_SlotLabel], marks_m: Array) -> None:
    """Write the numbers beside the slots.

    Each number is on the side with the most room between marks, slots and other numbers.

    Args:
        figure: the figure of the axes.
        ax: axes in metres.
        labels: labels of the slots.
        marks_m: positions of the time marks (n, 2).
    """
    figure.draw_without_rendering()  # computes the positions of all parts
    per_point = figure.dpi / 72.0

    slots_m = np.reshape([label.position_m for label in labels], (-1, 2))
    mark_points = ax.transData.transform(marks_m) / per_point
    slot_points = ax.transData.transform(slots_m) / per_point
    time_points = mark_points + np.array(_TIME_SHIFT_PT)  # where the times of the marks stand
    busy_points = [*mark_points, *slot_points, *time_points]

    for label, slot_point in zip(labels, slot_points, strict=True):
        size = np.array([5.0 * len(label.text) + 2.0, 9.0])  # points, about that of its text
        others = [other for other in busy_points if math.dist(other, slot_point) > 0.5]

        best_shift = np.zeros(2)
        best_room = -1.0
        for side in _SIDES:
            shift = (size / 2.0 + _SLOT_SHIFT_PT) * side
            room = _room(slot_point + shift, size, np.array(others).reshape(-1, 2))
            if room > best_room:
                best_shift = shift
                best_room = room

        ax.annotate(
            label.text,
            label.position_m,
            tuple(best_shift),
            textcoords="offset points",
            fontsize=8.5,
            weight="bold",
            color=label.tint,
            ha="center",
            va="center",
        )
        # both ends and the middle of the text
        for part in (-0.5, 0.0, 0.5):
            busy_points.append(slot_point + best_shift + np.array([part * size[0], 0.0]))


def _room(middle: Array, size: Array, others: Array) -> float:
    """Return the distance from a text's box to the nearest of other points (n, 2), in points."""
    gaps = np.maximum(np.abs(others - middle) - size / 2.0, 0.0)
    distances = np.hypot(gaps[:, 0], gaps[:, 1])
    return float(np.min(distances, initial=_ENOUGH_ROOM_PT))
