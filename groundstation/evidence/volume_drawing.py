"""The picture of the three volumes, seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.patches import Polygon, Rectangle

from groundstation.evidence.volumes import Outline, Point, Volumes
from groundstation.figures.style import SOFT, new_figure, styled
from onboard.config.fleet import FleetConfig
from onboard.config.flight_space import flight_space_of

DRAWING_NAME = "volumes.png"
# the colours in which authorities draw the volumes
_GREEN = "#1a9850"
_YELLOW = "#e6ab02"
_RED = "#d73027"
_MARGIN_SHARE = 0.04  # margin around the volumes, as a share of their width
_LONGEST_NAME = 24  # letters of a fence's name in the legend


def draw_volumes(
    path: Path, title: str, shapes: Volumes, fleet: FleetConfig, hulls: Sequence[Sequence[Point]]
) -> None:
    """Write the picture.

    Args:
        path: path of the PNG.
        title: title of the picture.
        shapes: the volumes.
        fleet: the fleet file, whose fence and spots are drawn.
        hulls: convex hulls of the flights, which are drawn as thin lines.
    """
    with styled():
        figure = new_figure(9.0, 8.6, title)
        axes = figure.subplots()
        buffer = f"ground risk buffer (+{shapes.fall_reach_m:.1f} m)"
        contingency = (
            f"contingency volume (+{shapes.excursion_m:.1f} m, up to"
            f" {shapes.contingency_above_ground_m:.1f} m)"
        )
        geography = f"flight geography (up to {shapes.geography_above_ground_m:.1f} m)"
        _add_outline(axes, shapes.buffer, _RED, buffer)
        _add_outline(axes, shapes.contingency, _YELLOW, contingency)
        _add_outline(axes, shapes.geography, _GREEN, geography)
        for hull in hulls:
            if len(hull) > 2:
                axes.add_patch(Polygon(hull, closed=True, fill=False, lw=0.4, ec=SOFT, alpha=0.5))

        _add_fence(axes, fleet)
        for name in fleet.enabled_names:
            east_m, north_m, _ = fleet.vehicles[name].start_enu_m
            axes.plot(east_m, north_m, "k^", markersize=5)
        _set_limits(axes, shapes.buffer, fleet)
        axes.set_xlabel("east m")
        axes.set_ylabel("north m")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.07), ncols=2)
        figure.savefig(path)


def _add_outline(axes: Any, outline: Outline, tint: str, label: str) -> None:
    axes.add_patch(Polygon(outline, closed=True, fc=tint, ec=tint, alpha=0.18))
    axes.add_patch(Polygon(outline, closed=True, fill=False, ec=tint, lw=1.8, label=label))


def _add_fence(axes: Any, fleet: FleetConfig) -> None:
    west_m, east_m = fleet.fleet.geofence_m.x
    south_m, north_m = fleet.fleet.geofence_m.y
    axes.add_patch(
        Rectangle(
            (west_m, south_m),
            east_m - west_m,
            north_m - south_m,
            fill=False,
            linestyle="--",
            ec="black",
            lw=1.0,
            label="fence of the fleet file",
        )
    )
    for outline in flight_space_of(fleet).outlines():
        style = "-." if outline.keeps_in else ":"
        words = "to stay in" if outline.keeps_in else "to stay out of"
        corners = outline.corners_enu_m
        axes.add_patch(
            Polygon(
                corners,
                closed=True,
                fill=False,
                linestyle=style,
                ec="black",
                lw=1.0,
                label=f"fence {outline.name[:_LONGEST_NAME]}, {words}",
            )
        )


def _set_limits(axes: Any, outline: Outline, fleet: FleetConfig) -> None:
    fence = fleet.fleet.geofence_m
    all_east_m = [*(east_m for east_m, _ in outline), *fence.x]
    all_north_m = [*(north_m for _, north_m in outline), *fence.y]
    margin_m = _MARGIN_SHARE * (max(all_east_m) - min(all_east_m))
    axes.set_xlim(min(all_east_m) - margin_m, max(all_east_m) + margin_m)
    axes.set_ylim(min(all_north_m) - margin_m, max(all_north_m) + margin_m)
    axes.set_aspect("equal")
