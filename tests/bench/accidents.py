"""Four accidents that happened, flown with their defences and without.

    make bench-accidents                                  # seeds 1 to 20 of all: half an hour
    make bench-accidents ARGS="london --seeds 1:3"
    make bench-accidents ARGS="--seeds 1:2 --pictures"    # docs/figures/gallery-NAME.png

A line for each flight. The exit status is 1 when an accident does not happen without its defence,
or happens with it. What they are stands in ``sitl/lockstep/accidents.py``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from groundstation.figures.style import LIMIT, colour, new_figure, styled
from groundstation.mission_files.loading import load_mission
from groundstation.shows.gallery import sentence_of
from onboard.config.fleet_config import Geofence
from sitl.lockstep.accidents import ACCIDENTS, FlownAccident, fly

ROOT = Path(__file__).parents[2]


def flown_once(name: str, *, is_defended: bool, seed: int) -> FlownAccident:
    """Fly one accident once."""
    mission = load_mission(ROOT / f"configs/missions/{name}.toml")
    return fly(ACCIDENTS[name], mission, is_defended=is_defended, seed=seed)


def is_as_promised(flown: FlownAccident) -> bool:
    """Return whether the accident happened without its defence, or did not happen with it."""
    if flown.is_defended:
        return not flown.harm and flown.min_separation_m >= flown.promised_m
    return bool(flown.harm)


def draw(without: FlownAccident, defended: FlownAccident, fence: Geofence, path: Path) -> None:
    """Draw the ways from above: without the defence, and with it."""
    title = sentence_of(without.name).partition(":")[0]
    figure = new_figure(11.0, 5.4, title)
    for axes, flown in zip(figure.subplots(1, 2), (without, defended), strict=True):
        ways_m = np.array(flown.places_m)
        for index in range(ways_m.shape[1]):
            way_m = ways_m[:, index]
            axes.plot(*way_m.T, color=colour(index), linewidth=1.4)
            axes.plot(*way_m[0], "s", color=colour(index), markersize=6, markeredgecolor="white")
            axes.plot(*way_m[-1], "o", color=colour(index), markersize=5)
        west_m, east_m = fence.x
        south_m, north_m = fence.y
        corners_x = [west_m, east_m, east_m, west_m, west_m]
        corners_y = [south_m, south_m, north_m, north_m, south_m]
        axes.plot(corners_x, corners_y, color=LIMIT, linewidth=1.2)
        axes.set_aspect("equal", adjustable="datalim")
        which = "with" if flown.is_defended else "without"
        words = flown.harm or ("no harm" if flown.took_off else "nobody took off")
        axes.set(xlabel="east [m]", ylabel="north [m]", title=f"{which} the defence: {words}")
    figure.savefig(path, dpi=80)


def main(words: Sequence[str]) -> int:
    """Fly and print; the exit status is 1 when one is not as promised."""
    parser = argparse.ArgumentParser(prog="make bench-accidents", description=__doc__)
    parser.add_argument("names", nargs="*", default=list(ACCIDENTS))
    parser.add_argument("--seeds", default="1:21", help="first:end")
    parser.add_argument("--pictures", action="store_true", help="of the last seed")
    options = parser.parse_args(words)
    first, end = (int(part) for part in options.seeds.split(":"))

    failed = 0
    for seed in range(first, end):
        for name in options.names:
            both = []
            for is_defended in (False, True):
                flown = flown_once(name, is_defended=is_defended, seed=seed)
                mark = "" if is_as_promised(flown) else "  NOT AS PROMISED"
                print(f"{flown.line}{mark}", flush=True)
                failed += bool(mark)
                both.append(flown)
            if options.pictures:
                mission = load_mission(ROOT / f"configs/missions/{name}.toml")
                fence = ACCIDENTS[name].accident_fleet(mission.fleet).fleet.geofence_m
                with styled():
                    draw(both[0], both[1], fence, ROOT / f"docs/figures/gallery-{name}.png")
    return int(failed > 0)
