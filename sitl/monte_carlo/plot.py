"""The explaining picture of one flight: paths, distances and what the law did, from its trace file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.patches import Circle, Patch, Polygon
from numpy.typing import NDArray

from groundstation.figures.style import LIMIT, SOFT, colour, styled
from onboard.arrays import Array
from onboard.config.fleet import ConfigError
from onboard.types import LawStatus

_FEW = 8  # up to so many vehicles have a colour and a name of their own
_STATUS_COLOURS = ("#eef1f3", "#56B4E9", "#E69F00", LIMIT)  # by LawStatus
_STATUS_WORDS = (
    "no row active",
    "thrust changed",
    "relaxed: no thrust fits all rows",
    "infeasible",
)
_TIME_MAP = "viridis"


@dataclass(frozen=True, slots=True)
class _Data:
    """A trace file's content, and where its closest approach is: sample, both vehicles, distance
    [m].
    """

    t_s: Array
    position_enu_m: Array
    goal_enu_m: Array
    status: NDArray[np.int8]
    active: NDArray[np.int16]
    names: list[str]
    limit_m: float
    body_m: float
    title: str
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]]
    distance_m: Array
    closest: tuple[int, int]
    obstacles_m: Array  # (O, 5) both ends in the plane and the radius

    @property
    def count(self) -> int:
        return len(self.names)


def draw(trace: Path, picture: Path) -> None:
    """Draw the picture of a trace file; the suffix of ``picture`` says in which format.

    Raises:
        ConfigError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    data = _read(trace)
    with styled():
        figure = Figure(figsize=(13.0, 7.3), layout="constrained")
        figure.suptitle(data.title, fontsize=13, fontweight="bold", x=0.01, ha="left")
        grid = figure.add_gridspec(2, 2, width_ratios=[1.05, 1.0], height_ratios=[1.0, 0.85])
        _paths(figure, figure.add_subplot(grid[:, 0]), data)
        distances = figure.add_subplot(grid[0, 1])
        _distances(distances, data)
        _activity(figure.add_subplot(grid[1, 1], sharex=distances), data)
        try:
            figure.savefig(picture, metadata={"Date": None} if picture.suffix == ".svg" else None)
        except OSError as error:
            raise ConfigError(
                f"--plot {picture}: cannot be written ({error.strerror}). Name another file."
            ) from None


def _read(trace: Path) -> _Data:
    with np.load(trace) as file:
        position, names = file["position_enu_m"], [str(name) for name in file["names"]]
        first, second = np.triu_indices(len(names), 1)
        gap = position[:, first, :2] - position[:, second, :2]
        distance = np.sqrt(np.einsum("tpc,tpc->tp", gap, gap))
        sample, pair = (
            (int(k) for k in np.unravel_index(np.argmin(distance), distance.shape))
            if len(first)
            else (0, -1)
        )
        t_s = file["t_s"]
        end = (
            f"all arrived after {t_s[-1]:.1f} s"
            if file["success"]
            else f"not all arrived in {t_s[-1]:.0f} s"
        )
        nearest = f", never nearer than {distance.min():.2f} m" if len(first) else ""
        return _Data(
            t_s=t_s,
            position_enu_m=position,
            goal_enu_m=file["goal_enu_m"],
            status=file["status"],
            active=file["active_neighbour"],
            names=names,
            limit_m=float(file["safety_distance_m"]),
            body_m=float(file["body_diameter_m"]),
            title=f"{file['scenario']}, seed {file['seed']}, law {file['law']}: {len(names)} vehicles, {end}{nearest}",
            pairs=(first, second),
            distance_m=distance,
            closest=(sample, pair),
            obstacles_m=file["obstacles_m"],
        )


def _paths(figure: Any, axes: Any, data: _Data) -> None:
    """Plan view: paths coloured by time, and everybody with half the safety distance about it at
    the closest moment.
    """
    axes.set_title("Paths, and the moment of closest approach")
    norm = Normalize(0.0, data.t_s[-1])
    lines = None
    for i in range(data.count):
        points = data.position_enu_m[:, i, :2]
        lines = LineCollection(
            np.stack([points[:-1], points[1:]], axis=1),  # type: ignore[arg-type]
            cmap=_TIME_MAP,
            norm=norm,
            linewidths=2.2 if data.count <= _FEW else 1.4,
            alpha=0.9,
            zorder=2,
        )
        lines.set_array(data.t_s[:-1])
        axes.add_collection(lines)
    for x_0, y_0, x_1, y_1, radius in data.obstacles_m:
        begin, end = np.array((x_0, y_0)), np.array((x_1, y_1))
        for middle in ((x_0, y_0), (x_1, y_1)):
            axes.add_patch(Circle(middle, radius, fc="#888888", lw=0, zorder=1))
        across = radius * np.array([y_0 - y_1, x_1 - x_0]) / max(np.hypot(*(end - begin)), 1e-9)
        axes.add_patch(
            Polygon(
                [begin + across, end + across, end - across, begin - across],
                fc="#888888",
                lw=0,
                zorder=1,
            )
        )
    start, goal = data.position_enu_m[0], data.goal_enu_m
    axes.plot(
        start[:, 0], start[:, 1], "o", ms=6, mfc="white", mec="#333333", zorder=4, label="start"
    )
    axes.plot(goal[:, 0], goal[:, 1], "x", ms=7, mew=2, color="#333333", zorder=4, label="goal")
    sample, pair = data.closest
    now = data.position_enu_m[sample]
    nearest = {int(data.pairs[0][pair]), int(data.pairs[1][pair])} if pair >= 0 else set()
    for i in range(data.count):
        is_near = i in nearest
        face = colour(i) if data.count <= _FEW else SOFT
        edge = LIMIT if is_near and data.distance_m[sample, pair] < data.limit_m else "#333333"
        disc = Circle(
            now[i, :2], 0.5 * data.limit_m, fc=face, alpha=0.35 if is_near else 0.16, lw=0, zorder=3
        )
        axes.add_patch(disc)
        axes.add_patch(
            Circle(
                now[i, :2],
                0.5 * data.limit_m,
                fill=False,
                ec=edge if is_near else face,
                lw=1.8 if is_near else 0.9,
            )
        )
        if data.count <= _FEW:
            axes.text(
                *now[i, :2],
                data.names[i],
                ha="center",
                va="center",
                fontsize=8,
                fontweight="bold",
                zorder=6,
            )
    if pair >= 0:
        one, two = (now[int(places[pair]), :2] for places in data.pairs)
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
    reach = np.concatenate([data.position_enu_m.reshape(-1, 3), goal])[:, :2]
    middle = 0.5 * (reach.min(0) + reach.max(0))
    half = 0.5 * float((reach.max(0) - reach.min(0)).max()) + 1.2 * data.limit_m
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set(xlabel="east x [m]", ylabel="north y [m]", aspect="equal")
    handles, labels = axes.get_legend_handles_labels()
    handles.append(Circle((0, 0), fc=SOFT, alpha=0.4))
    labels.append(f"radius {0.5 * data.limit_m:.2f} m: touching means {data.limit_m:.2f} m")
    axes.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=3)
    if lines is not None:
        bar = figure.colorbar(
            lines, ax=axes, shrink=0.6, aspect=30, pad=0.01, ticks=_round_ticks(data.t_s[-1])
        )
        bar.set_label("time [s]")


def _round_ticks(end_s: float) -> Array:
    step = next(
        width for width in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if end_s / width <= 9.0
    )
    return np.arange(0.0, end_s, step)


def _distances(axes: Any, data: _Data) -> None:
    """All pairs' distances over time, the smallest of each moment in front, against the promise."""
    axes.set_title("Distance of every pair")
    top = min(float(np.max(data.distance_m, initial=data.limit_m)), 4.0 * data.limit_m)
    axes.axhspan(0.0, data.limit_m, color=LIMIT, alpha=0.07, lw=0)
    axes.axhline(data.limit_m, color=LIMIT, lw=1.4, ls="--")
    axes.text(
        data.t_s[-1],
        data.limit_m,
        f"safety distance {data.limit_m:.2f} m ",
        color=LIMIT,
        ha="right",
        va="top",
    )
    axes.axhline(data.body_m, color=LIMIT, lw=1.0, ls=":")
    axes.text(
        data.t_s[-1],
        data.body_m,
        f"they touch {data.body_m:.2f} m ",
        color=LIMIT,
        ha="right",
        va="top",
    )
    if data.distance_m.shape[1]:
        is_few = data.distance_m.shape[1] <= _FEW
        for k in range(data.distance_m.shape[1]):
            if not is_few and data.distance_m[:, k].min() > top:
                continue
            name = f"{data.names[data.pairs[0][k]]} - {data.names[data.pairs[1][k]]}"
            axes.plot(
                data.t_s,
                data.distance_m[:, k],
                color=colour(k) if is_few else SOFT,
                lw=1.4 if is_few else 0.5,
                alpha=1.0 if is_few else 0.5,
                label=name if is_few else None,
            )
        if not is_few:
            axes.plot(
                data.t_s,
                data.distance_m.min(1),
                color="#0072B2",
                lw=2.0,
                label="nearest pair of the moment",
            )
        sample, pair = data.closest
        axes.plot(data.t_s[sample], data.distance_m[sample, pair], "o", color=LIMIT, ms=6, zorder=5)
        axes.legend(loc="upper right", ncols=3 if is_few else 1, fontsize=8)
    axes.set(
        ylim=(0.0, top * 1.15), ylabel="between centres, in the plane [m]", xlim=(0.0, data.t_s[-1])
    )


def _activity(axes: Any, data: _Data) -> None:
    """Draw when each was active: for few vehicles in the colour of the neighbour that binds most,
    else by status.
    """
    status = data.status[1:].T
    edges_s = np.append(data.t_s[:-1], data.t_s[-1])
    rows = np.arange(data.count + 1) - 0.5
    if data.count <= _FEW:
        axes.set_title("Whose row binds: coloured as the neighbour that is avoided")
        palette = ["#eef1f3", *(colour(i) for i in range(data.count))]
        values = np.where(status > 0, data.active[1:].T + 1, 0)
        values = np.clip(values, 0, data.count)
        legend = [Patch(fc=colour(i), label=f"avoids {name}") for i, name in enumerate(data.names)]
    else:
        axes.set_title("What the law did to each vehicle's thrust")
        palette, values = list(_STATUS_COLOURS), status
        flown = sorted(set(np.unique(status).tolist()))
        legend = [Patch(fc=_STATUS_COLOURS[k], ec=SOFT, label=_STATUS_WORDS[k]) for k in flown]
    colours = ListedColormap(palette)
    axes.pcolormesh(
        edges_s,
        rows,
        values,
        cmap=colours,
        norm=BoundaryNorm(np.arange(len(palette) + 1) - 0.5, len(palette)),
        rasterized=True,
    )
    if data.count <= _FEW:
        relaxed = status == int(LawStatus.RELAXED)
        vehicle, tick = np.nonzero(relaxed)
        if len(tick):
            axes.plot(data.t_s[tick + 1], vehicle + 0.36, "|", color=LIMIT, ms=5)
            legend.append(Patch(fc="white", ec=LIMIT, label="relaxed: no thrust fits all rows"))
        axes.set_yticks(range(data.count), data.names)
    axes.grid(False)
    axes.invert_yaxis()
    axes.set(xlabel="time [s]", ylabel="vehicle", xlim=(0.0, data.t_s[-1]))
    axes.legend(
        handles=legend, loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=4, fontsize=8
    )
