"""A picture that explains one flight, drawn from its trace file.

On the left are the paths in the plane, and all vehicles at the moment of closest approach. On the
right are the distances of all pairs over time, and below them the status of the law of each
vehicle. The law makes a row for each neighbour: a limit of the thrust, which is active when it
changes the thrust.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.patches import Circle, Patch, Polygon
from numpy.typing import NDArray

from groundstation.figures.style import LIMIT, SOFT, colour, styled, write_figure
from onboard.arrays import Array
from onboard.config.fleet import ConfigError
from onboard.types import LawStatus

_FEW = 8  # most vehicles or pairs that each have a colour and a name
_INACTIVE = "#eef1f3"
_STATUS_COLOURS = (_INACTIVE, "#56B4E9", "#E69F00", LIMIT)  # by LawStatus
_STATUS_WORDS = (
    "no row active",
    "thrust changed",
    "relaxed: no thrust fits all rows",
    "infeasible",
)
_EDGE = "#333333"
_OBSTACLE = "#888888"
_NEAREST_PAIR = "#0072B2"
_TIME_MAP = "viridis"


@dataclass(frozen=True, slots=True)
class _TraceData:
    """The content of a trace file, and the distances of all pairs.

    T samples, N vehicles, P pairs of vehicles, O obstacles.
    """

    t_s: Array  # (T,)
    position_enu_m: Array  # (T, N, 3)
    goal_enu_m: Array  # (N, 3)
    status: NDArray[np.int8]  # (T, N)
    active: NDArray[np.int16]  # (T, N) index of the vehicle that is avoided most
    names: list[str]
    limit_m: float  # the safety distance
    body_m: float  # diameter of a body
    title: str
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]]  # (P,) first and second vehicle
    distance_m: Array  # (T, P) horizontal
    closest: tuple[int, int]  # indexes of sample and pair; pair -1 for a single vehicle
    obstacles_m: Array  # (O, 5) x and y of both ends, and the radius

    @property
    def count(self) -> int:
        return len(self.names)

    @property
    def is_few(self) -> bool:
        """Whether each vehicle has its own colour and name."""
        return self.count <= _FEW


def draw(trace: Path, picture: Path) -> None:
    """Draw the picture of a trace file; the suffix of ``picture`` decides its format.

    Raises:
        ConfigError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    data = _read(trace)
    with styled():
        figure = Figure(figsize=(13.0, 7.3), layout="constrained")
        figure.suptitle(data.title, fontsize=13, fontweight="bold", x=0.01, ha="left")
        grid = figure.add_gridspec(2, 2, width_ratios=[1.05, 1.0], height_ratios=[1.0, 0.85])

        paths = figure.add_subplot(grid[:, 0])
        _paths(figure, paths, data)

        distances = figure.add_subplot(grid[0, 1])
        _distances(distances, data)

        activity = figure.add_subplot(grid[1, 1], sharex=distances)
        _activity(activity, data)

        try:
            write_figure(figure, picture)
        except OSError as error:
            raise ConfigError(
                f"--plot {picture}: cannot be written ({error.strerror}). Name another file."
            ) from None


def _read(trace: Path) -> _TraceData:
    """Read a trace, with the distances of all pairs and the title of its picture."""
    with np.load(trace) as file:
        t_s = file["t_s"]
        position = file["position_enu_m"]
        names = [str(name) for name in file["names"]]

        first, second = np.triu_indices(len(names), 1)
        offset = position[:, first, :2] - position[:, second, :2]  # (T, P, 2)
        distance = np.sqrt(np.einsum("tpc,tpc->tp", offset, offset))

        closest = (0, -1)
        nearest = ""
        if len(first):
            sample, pair = np.unravel_index(np.argmin(distance), distance.shape)
            closest = (int(sample), int(pair))
            nearest = f", never nearer than {distance.min():.2f} m"

        if file["success"]:
            end = f"all arrived after {t_s[-1]:.1f} s"
        else:
            end = f"not all arrived in {t_s[-1]:.0f} s"
        flight = f"{file['scenario']}, seed {file['seed']}, law {file['law']}"

        return _TraceData(
            t_s=t_s,
            position_enu_m=position,
            goal_enu_m=file["goal_enu_m"],
            status=file["status"],
            active=file["active_neighbour"],
            names=names,
            limit_m=float(file["safety_distance_m"]),
            body_m=float(file["body_diameter_m"]),
            title=f"{flight}: {len(names)} vehicles, {end}{nearest}",
            pairs=(first, second),
            distance_m=distance,
            closest=closest,
            obstacles_m=file["obstacles_m"],
        )


# The paths


def _paths(figure: Any, axes: Any, data: _TraceData) -> None:
    """Draw the plan view: paths coloured by time, and all vehicles at their closest approach."""
    axes.set_title("Paths, and the moment of closest approach")
    lines = _draw_lines(axes, data)
    for ends_and_radius in data.obstacles_m:
        _draw_obstacle(axes, ends_and_radius)

    start = data.position_enu_m[0]
    goal = data.goal_enu_m
    axes.plot(
        start[:, 0],
        start[:, 1],
        "o",
        ms=6,
        mfc="white",
        mec=_EDGE,
        zorder=4,
        label="start",
    )
    axes.plot(goal[:, 0], goal[:, 1], "x", ms=7, mew=2, color=_EDGE, zorder=4, label="goal")

    _draw_closest_moment(axes, data)
    _set_limits(axes, data)
    _draw_legend(axes, data)

    if lines is not None:
        ticks = _round_ticks(data.t_s[-1])
        bar = figure.colorbar(lines, ax=axes, shrink=0.6, aspect=30, pad=0.01, ticks=ticks)
        bar.set_label("time [s]")


def _draw_lines(axes: Any, data: _TraceData) -> LineCollection | None:
    """Draw the paths; return the lines of the last vehicle, for the colour bar."""
    norm = Normalize(0.0, data.t_s[-1])
    width = 1.4
    if data.is_few:
        width = 2.2

    lines = None
    for i in range(data.count):
        points = data.position_enu_m[:, i, :2]
        segments = np.stack([points[:-1], points[1:]], axis=1)  # (T-1, 2, 2)
        lines = LineCollection(
            segments,  # type: ignore[arg-type]
            cmap=_TIME_MAP,
            norm=norm,
            linewidths=width,
            alpha=0.9,
            zorder=2,
        )
        lines.set_array(data.t_s[:-1])
        axes.add_collection(lines)
    return lines


def _draw_obstacle(axes: Any, ends_and_radius: Array) -> None:
    """Draw a capsule: a disc at each end, and the rectangle between them."""
    x_0, y_0, x_1, y_1, radius = ends_and_radius
    begin = np.array((x_0, y_0))
    end = np.array((x_1, y_1))
    for middle in ((x_0, y_0), (x_1, y_1)):
        axes.add_patch(Circle(middle, radius, fc=_OBSTACLE, lw=0, zorder=1))

    length = max(np.hypot(*(end - begin)), 1e-9)  # a pillar has length 0; avoids dividing by 0
    across = radius * np.array([y_0 - y_1, x_1 - x_0]) / length
    corners = [begin + across, end + across, end - across, begin - across]
    axes.add_patch(Polygon(corners, fc=_OBSTACLE, lw=0, zorder=1))


def _draw_closest_moment(axes: Any, data: _TraceData) -> None:
    """Draw each vehicle as a disc of half the safety distance, and the nearest pair's distance."""
    sample, pair = data.closest
    position = data.position_enu_m[sample]  # (N, 3)
    first, second = data.pairs

    nearest: set[int] = set()
    is_too_near = False
    if pair >= 0:
        nearest = {int(first[pair]), int(second[pair])}
        is_too_near = bool(data.distance_m[sample, pair] < data.limit_m)

    for i in range(data.count):
        middle = position[i, :2]
        radius = 0.5 * data.limit_m
        face = SOFT
        if data.is_few:
            face = colour(i)

        opacity = 0.16
        edge = face
        edge_width = 0.9
        if i in nearest:
            opacity = 0.35
            edge = _EDGE
            if is_too_near:
                edge = LIMIT
            edge_width = 1.8

        axes.add_patch(Circle(middle, radius, fc=face, alpha=opacity, lw=0, zorder=3))
        axes.add_patch(Circle(middle, radius, fill=False, ec=edge, lw=edge_width))
        if data.is_few:
            axes.text(
                *middle,
                data.names[i],
                ha="center",
                va="center",
                fontsize=8,
                fontweight="bold",
                zorder=6,
            )

    if pair >= 0:
        one = position[int(first[pair]), :2]
        two = position[int(second[pair]), :2]
        axes.plot(*np.stack([one, two], axis=1), color=LIMIT, lw=1.6, zorder=5)
        axes.annotate(
            f"{data.distance_m[sample, pair]:.2f} m at {data.t_s[sample]:.1f} s",
            0.5 * (one + two),
            xytext=(14, 14),
            textcoords="offset points",
            color=LIMIT,
            fontweight="bold",
            zorder=7,
            bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.8},
        )


def _set_limits(axes: Any, data: _TraceData) -> None:
    """Show a square that holds all paths and goals."""
    points = np.concatenate([data.position_enu_m.reshape(-1, 3), data.goal_enu_m])[:, :2]
    lowest = points.min(0)
    highest = points.max(0)
    x, y = 0.5 * (lowest + highest)
    half = 0.5 * float((highest - lowest).max()) + 1.2 * data.limit_m

    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
    axes.set(xlabel="east x [m]", ylabel="north y [m]", aspect="equal")


def _draw_legend(axes: Any, data: _TraceData) -> None:
    """Add the legend of marks and discs below the plan view."""
    handles, labels = axes.get_legend_handles_labels()
    handles.append(Circle((0, 0), fc=SOFT, alpha=0.4))
    labels.append(f"radius {0.5 * data.limit_m:.2f} m: touching means {data.limit_m:.2f} m")
    axes.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=3)


def _round_ticks(end_s: float) -> Array:
    """Return about ten round times from 0 to the end."""
    for step_s in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0):
        if end_s / step_s <= 9.0:
            return np.arange(0.0, end_s, step_s)
    return np.arange(0.0, end_s, 100.0)


# The distances


def _distances(axes: Any, data: _TraceData) -> None:
    """Draw the distances of all pairs over time, the safety distance, and the closest approach."""
    axes.set_title("Distance of every pair")
    largest_m = float(np.max(data.distance_m, initial=data.limit_m))
    top_m = min(largest_m, 4.0 * data.limit_m)
    pair_count = data.distance_m.shape[1]

    axes.axhspan(0.0, data.limit_m, color=LIMIT, alpha=0.07, lw=0)
    axes.axhline(data.limit_m, color=LIMIT, lw=1.4, ls="--")
    _draw_limit_words(axes, data, data.limit_m, "safety distance")
    axes.axhline(data.body_m, color=LIMIT, lw=1.0, ls=":")
    _draw_limit_words(axes, data, data.body_m, "they touch")

    if pair_count:
        legend_columns = 1
        if pair_count <= _FEW:
            _draw_named_pairs(axes, data)
            legend_columns = 3
        else:
            _draw_many_pairs(axes, data, top_m)

        sample, pair = data.closest
        axes.plot(data.t_s[sample], data.distance_m[sample, pair], "o", color=LIMIT, ms=6, zorder=5)
        axes.legend(loc="upper right", ncols=legend_columns, fontsize=8)

    axes.set(
        ylim=(0.0, top_m * 1.15),
        ylabel="between centres, in the plane [m]",
        xlim=(0.0, data.t_s[-1]),
    )


def _draw_limit_words(axes: Any, data: _TraceData, distance_m: float, words: str) -> None:
    """Write what a limit means, at its right end."""
    sentence = f"{words} {distance_m:.2f} m "
    axes.text(data.t_s[-1], distance_m, sentence, color=LIMIT, ha="right", va="top")


def _draw_named_pairs(axes: Any, data: _TraceData) -> None:
    """Draw each pair in its own colour."""
    first, second = data.pairs
    for k in range(len(first)):
        name = f"{data.names[first[k]]} - {data.names[second[k]]}"
        axes.plot(data.t_s, data.distance_m[:, k], color=colour(k), lw=1.4, alpha=1.0, label=name)


def _draw_many_pairs(axes: Any, data: _TraceData, top_m: float) -> None:
    """Draw the pairs below the top of the axes, and in front of them the smallest distance."""
    for k in range(data.distance_m.shape[1]):
        distance_m = data.distance_m[:, k]
        if distance_m.min() <= top_m:
            axes.plot(data.t_s, distance_m, color=SOFT, lw=0.5, alpha=0.5)

    axes.plot(
        data.t_s,
        data.distance_m.min(1),
        color=_NEAREST_PAIR,
        lw=2.0,
        label="nearest pair of the moment",
    )


# What the law did


def _activity(axes: Any, data: _TraceData) -> None:
    """Draw for each vehicle when the law changed its thrust.

    With few vehicles the colour shows the most avoided neighbour; with many it shows the status.
    """
    status = data.status[1:].T  # (N, T-1)
    row_edges = np.arange(data.count + 1) - 0.5

    if data.is_few:
        axes.set_title("Whose row binds: coloured as the neighbour that is avoided")
        palette = [_INACTIVE]
        legend = []
        for i, name in enumerate(data.names):
            palette.append(colour(i))
            legend.append(Patch(fc=colour(i), label=f"avoids {name}"))
        values = np.where(status > 0, data.active[1:].T + 1, 0)  # 0 is the inactive colour
        values = np.clip(values, 0, data.count)
    else:
        axes.set_title("What the law did to each vehicle's thrust")
        palette = list(_STATUS_COLOURS)
        legend = []
        for k in sorted(set(np.unique(status).tolist())):
            legend.append(Patch(fc=_STATUS_COLOURS[k], ec=SOFT, label=_STATUS_WORDS[k]))
        values = status

    colour_edges = np.arange(len(palette) + 1) - 0.5
    axes.pcolormesh(
        data.t_s,  # the edges of the T - 1 ticks
        row_edges,
        values,
        cmap=ListedColormap(palette),
        norm=BoundaryNorm(colour_edges, len(palette)),
        rasterized=True,
    )

    if data.is_few:
        vehicle, tick = np.nonzero(status == int(LawStatus.RELAXED))
        if len(tick):
            axes.plot(data.t_s[tick + 1], vehicle + 0.36, "|", color=LIMIT, ms=5)
            legend.append(Patch(fc="white", ec=LIMIT, label="relaxed: no thrust fits all rows"))
        axes.set_yticks(range(data.count), data.names)

    axes.grid(False)
    axes.invert_yaxis()
    axes.set(xlabel="time [s]", ylabel="vehicle", xlim=(0.0, data.t_s[-1]))
    axes.legend(
        handles=legend,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.17),
        ncols=4,
        fontsize=8,
    )
