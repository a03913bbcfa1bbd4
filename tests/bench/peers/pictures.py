"""The figures of ``make bench-law``: methods side by side, their paths, what explains the law."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.figures.style import COLOURS, LIMIT, SOFT, colour, new_figure, styled
from onboard.confidence_intervals import exact_interval
from tests.bench.peers.report import Outcome, Summary

Array = NDArray[np.float64]

_BAR_WIDTH = 0.02  # of a histogram


def comparison(rows: Mapping[str, Summary], path: Path, title: str) -> None:
    """Bars for each method: success, violations with their interval, ratio, slew, cost."""
    with styled():
        figure = new_figure(11.0, 0.42 * len(rows) + 1.9, title)
        axes = figure.subplots(1, 5, sharey=True)
        names = list(rows)
        places = range(len(rows))
        shades = [COLOURS[0] if place == 0 else SOFT for place in places]
        values = list(rows.values())
        panels: list[tuple[str, list[float], str]] = [
            ("success %", [100.0 * s.successes / s.flights for s in values], "{:.0f}"),
            (
                "flights below 0.80 m, %",
                [100.0 * s.violations / s.flights for s in values],
                "{:.1f}",
            ),
            ("time / time alone", [s.ratio for s in values], "{:.2f}"),
            ("slew m/s³ rms", [s.slew_m_s3 for s in values], "{:.0f}"),
            ("µs per vehicle-step", [s.us_per_step for s in values], "{:.1f}"),
        ]
        for axis, (label, numbers, form) in zip(axes, panels, strict=True):
            shown = [0.0 if math.isnan(number) else number for number in numbers]
            axis.barh(places, shown, color=shades, height=0.7)
            axis.set_title(label, fontsize=9.5)
            top = max([*shown, 1e-9])
            for place, number in zip(places, numbers, strict=True):
                text = "none" if math.isnan(number) else form.format(number)
                axis.text(shown[place] + 0.03 * top, place, text, va="center", fontsize=8.5)
            axis.set_xlim(0.0, 1.3 * top)
            axis.grid(visible=False, axis="y")
        for place, s in enumerate(values):
            interval = exact_interval(s.violations, s.flights)
            ends_percent = [100.0 * interval.low, 100.0 * interval.high]
            axes[1].plot(ends_percent, [place + 0.28] * 2, color=LIMIT, linewidth=1.2)
        axes[0].set_yticks(places, names)
        axes[0].invert_yaxis()
        figure.savefig(path)


def distances(flights: Mapping[str, Sequence[Outcome]], path: Path, title: str) -> None:
    """A dot for each flight: smallest distance against time, failed flights at the right edge."""
    with styled():
        columns = min(4, len(flights))
        lines = math.ceil(len(flights) / columns)
        figure = new_figure(11.0, 2.5 * lines + 0.6, title)
        axes = np.atleast_1d(figure.subplots(lines, columns, sharex=True, sharey=True)).ravel()
        for axis, (name, outcomes) in zip(axes, flights.items(), strict=False):
            ratio = np.array([min(o.ratio, 5.0) if o.success else 5.4 for o in outcomes])
            nearest = np.array([o.min_separation_m for o in outcomes])
            fails = np.array([not o.success for o in outcomes])
            axis.axhspan(0.0, 0.8, color=LIMIT, alpha=0.06, linewidth=0)
            axis.axhline(0.8, color=LIMIT, linewidth=1.0)
            axis.plot(
                ratio[~fails], nearest[~fails], ".", color=COLOURS[0], markersize=4, alpha=0.7
            )
            axis.plot(ratio[fails], nearest[fails], "x", color=COLOURS[1], markersize=4, alpha=0.7)
            axis.set_title(name, fontsize=9.5)
            axis.set_ylim(0.0, 1.6)
            axis.set_xlim(0.9, 5.6)
            axis.set_xticks([1, 2, 3, 4, 5.4], ["1", "2", "3", "4", "not there"])
        for axis in axes[len(flights) :]:
            axis.set_visible(False)
        figure.supxlabel("time over the time alone", fontsize=10)
        figure.supylabel("smallest distance in m", fontsize=10)
        figure.savefig(path)


def histogram(
    values: Mapping[str, Sequence[float]], path: Path, *, title: str, axis_title: str
) -> None:
    """How many flights have which value: one histogram above the other, on the same axes."""
    everything = np.concatenate([np.array(of_one) for of_one in values.values()])
    edges = np.arange(
        math.floor(everything.min() / _BAR_WIDTH) * _BAR_WIDTH,
        everything.max() + _BAR_WIDTH,
        _BAR_WIDTH,
    )
    with styled():
        figure = new_figure(8.0, 1.9 * len(values) + 0.7, title)
        axes = np.atleast_1d(figure.subplots(len(values), 1, sharex=True, sharey=True))
        for axis, (name, of_one) in zip(axes, values.items(), strict=True):
            axis.hist(of_one, edges, color=COLOURS[0])
            axis.set_title(f"{name}: {len(of_one)} flights, at most {max(of_one):.2f}")
            axis.set_ylabel("flights")
        axes[-1].set_xlabel(axis_title)
        figure.savefig(path)


def by_delay(
    delays_s: Sequence[float], rows: Mapping[str, Sequence[Summary]], path: Path, title: str
) -> None:
    """Violations and time over the delay, a line for each method."""
    delays_ms = [1e3 * delay_s for delay_s in delays_s]
    with styled():
        figure = new_figure(11.0, 4.4, title)
        low, fast = figure.subplots(1, 2)
        for place, (name, figures) in enumerate(rows.items()):
            width = 2.6 if place == 0 else 1.3
            shares = [100.0 * s.violations / s.flights for s in figures]
            low.plot(delays_ms, shares, "o-", color=colour(place), linewidth=width, label=name)
            fast.plot(
                delays_ms, [s.ratio for s in figures], "o-", color=colour(place), linewidth=width
            )
        low.set_ylabel("flights below 0.80 m, %")
        fast.set_ylabel("time / time alone")
        for axis in (low, fast):
            axis.set_xlabel("age of a message when it arrives, ms")
        figure.legend(
            *low.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8.5
        )
        figure.savefig(path)


def paths(traces: Mapping[str, Array], path: Path, title: str, columns: int = 4) -> None:
    """Paths from above, a panel for each: positions (T, N, 3)."""
    with styled():
        columns = min(columns, len(traces))
        lines = math.ceil(len(traces) / columns)
        figure = new_figure(2.8 * columns, 2.95 * lines + 0.5, title)
        axes = np.atleast_1d(figure.subplots(lines, columns, sharex=True, sharey=True)).ravel()
        for axis, (name, positions) in zip(axes, traces.items(), strict=False):
            for n in range(positions.shape[1]):
                axis.plot(positions[:, n, 0], positions[:, n, 1], color=colour(n), linewidth=1.1)
                axis.plot(
                    *positions[0, n, :2], "o", color=colour(n), markersize=4, fillstyle="none"
                )
                axis.plot(*positions[-1, n, :2], "o", color=colour(n), markersize=4)
            axis.set_title(name, fontsize=9.5)
            axis.set_aspect("equal")
        for axis in axes[len(traces) :]:
            axis.set_visible(False)
        figure.savefig(path)


def histories(
    curves: Mapping[str, tuple[Array, Array]],
    path: Path,
    title: str,
    limits: Mapping[str, float],
    until_s: float,
) -> None:
    """Smallest distance over time for several variants, each (t_s, distance_m), with named limit
    lines.
    """
    highest = max(float(distance_m.max()) for _, distance_m in curves.values())
    with styled():
        figure = new_figure(8.0, 3.4, title)
        axis = figure.subplots()
        for place, (name, (t_s, distance_m)) in enumerate(curves.items()):
            axis.plot(t_s, distance_m, label=name, color=colour(place))
        for name, value in limits.items():
            axis.axhline(value, color=LIMIT, linewidth=1.0)
            axis.text(
                0.995,
                value,
                name,
                color=LIMIT,
                ha="right",
                va="bottom",
                fontsize=8.5,
                transform=_across(axis),
            )
        axis.set_xlabel("time in s")
        axis.set_ylabel("smallest distance in m")
        axis.set_ylim(0.0, 1.25 * highest)
        axis.set_xlim(0.0, until_s)
        axis.legend(loc="upper center", ncols=3, fontsize=8.5)
        figure.savefig(path)


def _across(axis: Any) -> Any:
    return axis.get_yaxis_transform()


def half_planes(
    wanted: Array,
    found: Array,
    normals: Array,
    bounds: Array,
    names: Sequence[str],
    radius: float,
    path: Path,
) -> None:
    """The thrust plane of one vehicle: what is wanted, what each neighbour forbids, what is
    commanded.
    """
    with styled():
        figure = new_figure(6.2, 5.6, "One tick of one vehicle, seen in its own acceleration")
        axis = figure.subplots()
        angle = np.linspace(0.0, 2.0 * np.pi, 181)
        axis.plot(radius * np.cos(angle), radius * np.sin(angle), color="#000000", linewidth=1.2)
        axis.text(-0.72 * radius, 0.74 * radius, "tilt limit", ha="right", fontsize=9)
        grid = np.linspace(-1.25 * radius, 1.25 * radius, 400)
        x, y = np.meshgrid(grid, grid)
        for k, (normal, bound, name) in enumerate(zip(normals, bounds, names, strict=True)):
            size = float(np.hypot(*normal))
            side = (normal[0] * x + normal[1] * y - bound) / size
            axis.contourf(x, y, side, levels=[-100.0, 0.0], colors=[colour(k)], alpha=0.16)
            axis.contour(x, y, side, levels=[0.0], colors=[colour(k)], linewidths=1.6)
            unit = normal / size
            along = np.array([unit[1], -unit[0]])
            line = unit * bound / size - unit * 0.08 * radius
            ends = (line + along * 0.6 * radius, line - along * 0.6 * radius)
            spot = max(ends, key=lambda end: float(np.hypot(*(end - wanted))))

            # along the line, and never upside down
            turn = math.degrees(math.atan2(unit[0], -unit[1]))
            if turn > 90.0:
                turn -= 180.0
            elif turn < -90.0:
                turn += 180.0
            axis.text(
                *spot, name, color=colour(k), rotation=turn, ha="center", va="center", fontsize=9
            )
        for vector, text, shade in ((wanted, "wanted", SOFT), (found, "commanded", "#000000")):
            axis.annotate(
                "",
                vector,
                (0.0, 0.0),
                arrowprops={"arrowstyle": "-|>", "color": shade, "linewidth": 2.0},
            )
            axis.annotate(
                text, vector, (6, 6), textcoords="offset points", color=shade, fontsize=10
            )
        axis.plot(*np.stack([wanted, found]).T, color=SOFT, linestyle=":", linewidth=1.2)
        axis.set_xlim(-1.25 * radius, 1.25 * radius)
        axis.set_ylim(-1.25 * radius, 1.25 * radius)
        axis.set_aspect("equal")
        axis.set_xlabel("acceleration east, m/s²")
        axis.set_ylabel("acceleration north, m/s²")
        figure.savefig(path)
