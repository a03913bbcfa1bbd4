"""The gallery: its show of thirty is made, and every mission flown and drawn.

``make bench-gallery`` flies all in lockstep and writes docs/figures/gallery-NAME.png; ``--show``
writes configs/shows/thirty.skyc first.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.patches import Circle

from groundstation.figures.data import TOPICS, FlightData, from_samples
from groundstation.figures.plan_figure import draw_outlines
from groundstation.figures.style import LIMIT, SOFT, colour, new_figure, styled
from groundstation.recording.timeline import Timeline
from groundstation.shows.gallery import GALLERY, SHOW, gallery_mission, sentence_of
from onboard.config.flight_space import outlines_of
from onboard.config.people import Person
from sitl.lockstep.flight import Lockstep
from tests.groundstation.shows.made_shows import eased, write_skyc

ROOT = Path(__file__).parents[2]
SECONDS = 18.0
APART_M = 1.5
TURN_RAD = math.radians(50.0)


def write_show(path: Path) -> None:
    """Write the show: five rows of six rise, turn together, a wave through them, and come down."""

    def way(k: int):
        x = APART_M * (k % 6 - 2.5)
        y = APART_M * (k // 6 - 2.0)

        def at(t: float) -> tuple[float, float, float]:
            u = eased((t - 3.0) / (SECONDS - 6.0))
            c = math.cos(TURN_RAD * u)
            s = math.sin(TURN_RAD * u)
            wave = 0.4 * math.sin(math.pi * u) ** 2 * math.sin(2.0 * math.pi * u + 0.5 * x)
            high = 1.6 * eased(t / 3.0) * eased((SECONDS - t) / 3.0)
            return c * x - s * y, s * x + c * y, high + wave

        return at

    write_skyc(
        path,
        {f"D{k + 1:02d}": way(k) for k in range(30)},
        SECONDS,
        show={"meta": {"title": "thirty"}},
    )


def draw(flight: FlightData, name: str, path: Path, people: Mapping[str, Person]) -> None:
    """Draw the ways from above, and beside them the distance of the closest pair over time.

    The walks of persons are dashed.
    """
    figure = new_figure(11.0, 5.2, sentence_of(name).partition(":")[0])
    above, over = figure.subplots(1, 2, width_ratios=[1.0, 1.1])
    for index, track in enumerate(flight.tracks):
        ways = track.path_enu_m
        above.plot(ways[:, 0], ways[:, 1], color=colour(index), linewidth=1.4)
        known = ways[np.isfinite(ways).all(-1)]
        if len(known):
            above.plot(
                *known[0, :2], "s", color=colour(index), markersize=6, markeredgecolor="white"
            )
            above.plot(*known[-1, :2], "o", color=colour(index), markersize=5)
    draw_outlines(above, flight)
    for person in people.values():
        walk = np.array(person.walk_enu_m)
        above.plot(walk[:, 0], walk[:, 1], "--", color=LIMIT, linewidth=1.2)
        above.add_patch(Circle(tuple(walk[0]), person.radius_m, fill=False, color=LIMIT))
    above.set_aspect("equal", adjustable="datalim")
    above.set(xlabel="east [m]", ylabel="north [m]", title="from above: from squares to dots")
    nearest = np.min(
        [np.where(np.isfinite(one.distance_m), one.distance_m, np.inf) for one in flight.pairs],
        axis=0,
    )
    over.plot(flight.grid_s, np.where(np.isfinite(nearest), nearest, np.nan), color=colour(0))
    over.axhline(flight.safety_distance_m, color=LIMIT, linewidth=1.2)
    over.annotate(
        "promised", (0.0, flight.safety_distance_m), (4, 4), textcoords="offset points", color=LIMIT
    )
    over.set(
        xlabel="time [s]",
        ylabel="closest pair [m]",
        ylim=(0.0, None),
        title="distance of the closest pair",
    )
    over.grid(color=SOFT, alpha=0.3)
    figure.savefig(path, dpi=80)


def main(words: Sequence[str]) -> int:
    """Fly and draw all, or those that are named; the number of flights that failed."""
    if "--show" in words:
        write_show(ROOT / f"configs/shows/{SHOW}.skyc")
    failed = 0
    for name in [word for word in words if word != "--show"] or GALLERY:
        with tempfile.TemporaryDirectory() as made, styled():
            mission = gallery_mission(name, Path(made))
            with Lockstep(mission.fleet, folder=Path(made)) as flight:
                verdict = flight.fly(mission)
            failed += not verdict.passed
            print(f"{name}: {verdict.summary}")
            with contextlib.closing(Timeline(Path(made))) as timeline:
                samples = list(timeline.samples(TOPICS))
            limits = mission.fleet.fleet
            flown = from_samples(
                samples,
                title=name,
                safety_distance_m=limits.safety_distance_m,
                height_share=limits.height_share,
                outlines=outlines_of(mission.fleet),
            )
            if flown is not None:
                draw(
                    flown,
                    name,
                    ROOT / f"docs/figures/gallery-{name}.png",
                    mission.fleet.people,
                )
    return failed
