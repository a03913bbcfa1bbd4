"""Fig.

4: trajectories from above with time marks, starts, slots and the safety circles at the closest
approach.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.patches import Circle

from groundstation.figures.data import FlightData
from groundstation.figures.style import LIMIT, SOFT, colour, new_figure
from onboard.arrays import Array

_SAME_M = 0.05
_SIDES = np.array(
    [[1, -1], [-1, -1], [-1, 1], [1, 1], [0, -1.3], [0, 1.3], [-1.3, 0], [1.3, 0]], np.float64
)
_STEPS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0)


def draw(flight: FlightData) -> Any:
    """Draw east to the right and north up, on one scale."""
    figure = new_figure(9.0, 8.6, f"Trajectories from above: {flight.title}")
    ax = figure.subplots()
    length_s = float(flight.grid_s[-1] - flight.grid_s[0])
    step_s = next((step for step in _STEPS_S if length_s / step <= 14.0), _STEPS_S[-1])
    marks_s = np.arange(0.0, flight.grid_s[-1], step_s)
    taken: list[Array] = []
    labels: list[tuple[Array, str, str]] = []
    for index, track in enumerate(flight.tracks):
        tint, path = colour(index), track.path_enu_m
        flying = track.path_time_s >= flight.grid_s[0]
        setpoint = track.setpoint_position_enu_m[track.time_s >= 0.0]
        ax.plot(setpoint[:, 0], setpoint[:, 1], color=SOFT, linewidth=0.9, linestyle=(0, (4, 3)))
        ax.plot(path[flying, 0], path[flying, 1], color=tint, linewidth=2.0, label=track.name)
        marks = track.path_at(marks_s)
        ax.plot(marks[:, 0], marks[:, 1], "o", color="white", markeredgecolor=tint, markersize=5.5)
        taken.append(marks[np.isfinite(marks).all(-1)][:, :2])
        written: list[Array] = []
        for time_s, mark in zip(marks_s, marks, strict=True):
            if all(np.hypot(*(mark[:2] - other)) > _SAME_M * 3 for other in written):
                ax.annotate(
                    f"{time_s:g}",
                    mark[:2],
                    (4, 4),
                    textcoords="offset points",
                    fontsize=8,
                    color=tint,
                )
                written.append(mark[:2])
        known = path[np.isfinite(path).all(-1)]
        if len(known):
            ax.plot(*known[0, :2], "s", color=tint, markersize=9, markeredgecolor="white")
        for slot, orders in _slots(track.slots_enu_m):
            ax.plot(slot[0], slot[1], "+", color=tint, markersize=15, markeredgewidth=2.2)
            labels.append((slot[:2], orders, tint))
    closest = flight.closest()
    if closest is not None:
        pair, at = closest
        positions = {
            track.name: track.path_at(flight.grid_s[at : at + 1])[0, :2] for track in flight.tracks
        }
        for index, track in enumerate(flight.tracks):
            if track.name in (pair.first, pair.second):
                x_m, y_m = positions[track.name]
                ring = Circle(
                    (float(x_m), float(y_m)),
                    flight.safety_distance_m,
                    fill=False,
                    color=colour(index),
                    lw=1.2,
                    alpha=0.75,
                )
                ax.add_patch(ring)
                ax.plot(*positions[track.name], "o", color=colour(index), markersize=7)
        ends = np.array([positions[pair.first], positions[pair.second]])
        ax.plot(ends[:, 0], ends[:, 1], color=LIMIT, linewidth=1.2)
        ax.set_title(
            f"closest: {pair.first} and {pair.second}, {pair.distance_m[at]:.2f} m at "
            f"{flight.take_off_s + flight.grid_s[at]:.1f} s of the record; "
            f"circles of {flight.safety_distance_m:.2f} m around both (by {flight.source})",
            loc="left",
            fontsize=9.5,
            fontweight="normal",
        )
    ax.plot([], [], "s", color=SOFT, label="start")
    ax.plot([], [], "+", color=SOFT, markersize=12, markeredgewidth=2, label="slot, in order")
    ax.plot([], [], color=SOFT, linewidth=0.9, linestyle=(0, (4, 3)), label="setpoint")
    ax.plot([], [], "o", color="white", markeredgecolor=SOFT, label=f"every {step_s:g} s")
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.06)
    ax.set_xlabel("x, east [m]")
    ax.set_ylabel("y, north [m]")
    ax.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.07),
        ncols=min(8, len(flight.tracks) + 4),
        fontsize=9,
    )
    _write(figure, ax, labels, np.concatenate([np.zeros((0, 2)), *taken]))
    return figure


def _write(figure: Any, ax: Any, labels: list[tuple[Array, str, str]], taken: Array) -> None:
    """Write the slots' numbers beside them, each where most room is between marks, slots and other
    numbers.

    Args:
        figure: of the axes.
        ax: axes in metres.
        labels: position (2,) [m], text and colour.
        taken: marks (n, 2) [m].
    """
    figure.canvas.draw()  # fixes the positions of everything
    per_point = figure.dpi / 72.0
    slots = [position for position, _, _ in labels]
    marks = ax.transData.transform(np.concatenate([taken, np.reshape(slots, (-1, 2))])) / per_point
    # the times stand at the upper right of their marks
    busy = [*marks, *np.add(marks[: len(taken)], (9.0, 8.0))]
    for position, text, tint in labels:
        here = ax.transData.transform(position) / per_point
        size = np.array([5.0 * len(text) + 2.0, 9.0])
        others = np.array([other for other in busy if np.hypot(*(other - here)) > 0.5]).reshape(
            -1, 2
        )

        def room(
            shift: Array, here: Array = here, others: Array = others, size: Array = size
        ) -> float:
            gap = np.maximum(np.abs(others - (here + shift)) - size / 2.0, 0.0)
            return float(np.min(np.hypot(gap[:, 0], gap[:, 1]), initial=40.0))

        shifts = [(size / 2.0 + (8.0, 7.0)) * side for side in _SIDES]
        best = max(shifts, key=room)
        ax.annotate(
            text,
            position,
            tuple(best),
            textcoords="offset points",
            fontsize=8.5,
            weight="bold",
            color=tint,
            ha="center",
            va="center",
        )
        busy.append(here + best)


def _slots(slots_enu_m: Array) -> list[tuple[Array, str]]:
    """Slots and the numbers of the orders that went there, those to one slot together."""
    slots: list[tuple[Array, str]] = []
    for number, slot in enumerate(slots_enu_m, start=1):
        for index, (other, orders) in enumerate(slots):
            if np.hypot(*(other[:2] - slot[:2])) < _SAME_M:
                slots[index] = (other, f"{orders}, {number}")
                break
        else:
            slots.append((slot, str(number)))
    return slots
