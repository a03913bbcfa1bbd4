"""``covey import``: a show of another program -> a fleet file, a mission and paths that covey
flies.

Examples:
  covey import show.skyc
  covey import show.skyc --out my_show --fleet fleet.toml
  covey import exported_csvs --promise 1.2

Reads Skybrush's .skyc, and folders with a CSV for each drone. All that is changed stands as a
comment in the files; what cannot be mended is refused with the drones' names. docs/shows.md says
more. Exit status: 0 written; 2 wrong input, nothing written.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission_findings import refused_findings
from groundstation.paths.checks import closest_pairs, pair_words, sample
from groundstation.shows.conversion import Converted
from groundstation.shows.csv_folder import read_folder
from groundstation.shows.output import write_show
from groundstation.shows.show import Show
from groundstation.shows.skyc import read_skyc
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_OK


def import_(
    show: Annotated[Path, Parameter(name="SHOW.skyc|FOLDER")],
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    fleet: File | None = None,
    promise: Annotated[float | None, Parameter(metavar="M")] = None,
) -> int:
    """Write DIR/fleet.toml, DIR/mission.toml and a path for each drone of a show; mend what can be
    mended.

    Args:
        show: a .skyc of Skybrush, or a folder of CSVs
        out: folder of the files (default: the show's name)
        fleet: take types, endpoints and the promised distance from this fleet file (default:
            emulated vehicles)
        promise: distance that the vehicles keep, centre to centre, in metres (default: the fleet's,
            or 0.8)
    """
    if promise is not None and not 0.1 <= promise <= 100.0:
        raise ConfigError(f"--promise is {promise:g}; it must lie between 0.1 and 100 m.")
    if show.suffix.lower() == ".vviz":
        raise ConfigError(
            f"{show}: VVIZ is for pictures of shows, not for flights. Export .skyc or CSVs."
        )
    read = read_folder(show) if show.is_dir() else read_skyc(show)
    folder = out or Path(show.stem)
    if (folder / "fleet.toml").exists():
        raise ConfigError(
            f"{folder / 'fleet.toml'} exists already. Name another folder with --out."
        )
    made = _written(read, folder, str(show), None if fleet is None else load_fleet(fleet), promise)
    seconds = max(path.duration_s for path in made.paths.values())
    print(f"'{read.title}': {len(made.paths)} drones, {seconds:.0f} s above {made.takeoff_m:g} m.")
    for line in (*read.notes, *made.notes):
        print(f"  {line}")
    for name, lines in made.own_notes.items():
        for line in lines[1:]:
            print(f"  {name} {line}")
    if len(made.paths) > 1:
        print(f"Nearest: {pair_words(closest_pairs(sample(made.paths), 0.0)[0])}.")
    print(f"Written: {folder}/fleet.toml, mission.toml and paths/. Next:")
    print(f"  covey check {folder}/mission.toml")
    print(f"  covey fly {folder}/mission.toml --lockstep")
    return EXIT_OK


def _written(
    show: Show, folder: Path, source: str, fleet: FleetConfig | None, promise_m: float | None
) -> Converted:
    """Write a show's files and judge them as they will be flown; what cannot be flown leaves no
    file behind.
    """
    with tempfile.TemporaryDirectory(prefix="covey-import-") as name:
        draft = Path(name) / "show"
        try:
            made, _ = write_show(show, draft, source, fleet, promise_m)
            refused = refused_findings(load_mission(draft / "mission.toml"), is_simulated=False)
        except ConfigError as error:
            raise ConfigError(str(error).replace(str(draft), str(folder))) from None
        if refused:
            reasons = " ".join(finding.sentence for finding in refused)
            raise ConfigError(
                f"{source}: the law says that this cannot be flown; nothing is written. {reasons}"
            )
        shutil.copytree(draft, folder, dirs_exist_ok=True)
    return made
