"""``covey import``: a show of another program -> a fleet file, a mission and paths.

Examples:
  covey import show.skyc
  covey import show.skyc --out my_show --fleet fleet.toml
  covey import exported_csvs --promise 1.2

Reads Skybrush's .skyc, and folders and zips with a CSV for each drone. Comments in
the files say what was changed. A show that cannot be corrected is refused, with the
names of its drones. docs/shows.md says more. Exit status: 0 written; 2 wrong input,
nothing written.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File
from groundstation.paths.checks import closest_pairs, pair_words, sample
from groundstation.shows.import_show import import_show, read_show
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_OK
from onboard.plain_text import numbered


def import_(
    show: Annotated[Path, Parameter(name="SHOW.skyc|FOLDER|ZIP")],
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    fleet: File | None = None,
    promise: Annotated[float | None, Parameter(metavar="M")] = None,
    vertical: Annotated[float | None, Parameter(metavar="M")] = None,
) -> int:
    """Make a mission of a show: a fleet file, a mission file, and a path for each drone.

    If the show cannot be flown as it is, it is slowed down, or some vehicles begin later.

    Args:
        show: a .skyc of Skybrush, or a folder or a zip of CSVs
        out: folder of the files (default: the show's name)
        fleet: take types, endpoints and the promised distance from this fleet file (default:
            emulated vehicles)
        promise: distance that the vehicles keep, centre to centre, in metres (default: the fleet's,
            or 0.8)
        vertical: height difference at which one vehicle may pass above another, in metres
            (default: as the fleet says; without --fleet they may not)
    """
    if promise is not None and not 0.1 <= promise <= 100.0:
        raise ConfigError(f"--promise is {promise:g}; it must lie between 0.1 and 100 m.")

    original = read_show(show)
    folder = out or Path(show.stem)
    for path in (folder / "fleet.toml", folder / "mission.toml"):
        if path.exists():
            raise ConfigError(f"{path} exists already. Name another folder with --out.")
    own_fleet = None
    if fleet is not None:
        own_fleet = load_fleet(fleet)

    imported = import_show(original, folder, str(show), own_fleet, promise, vertical)

    duration_s = max(path.duration_s for path in imported.paths.values())
    drones = len(imported.paths)
    print(
        f"'{original.title}': {numbered(drones, 'drone')}, {duration_s:.0f} s above "
        f"{imported.takeoff_m:g} m."
    )
    for note in imported.notes:
        print(f"  {note}")
    for name, lines in imported.own_notes.items():
        for line in lines[1:]:  # the first line only says which drone of the show it is
            print(f"  {name} {line}")
    if drones > 1:
        nearest_pair = closest_pairs(sample(imported.paths))[0]
        print(f"Nearest: {pair_words(nearest_pair)}.")

    mission = shlex.quote(str(folder / "mission.toml"))
    print(f"Written: {folder}/fleet.toml, mission.toml and paths/. Next:")
    print(f"  covey check {mission}")
    print(f"  covey fly {mission} --lockstep")
    return EXIT_OK
