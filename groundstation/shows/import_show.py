"""``covey import``: reads a show of another program, makes it flyable, checks it and writes it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission_findings import refused_findings
from groundstation.recording.output_file import write_together
from groundstation.shows.conversion import Converted
from groundstation.shows.csv_folder import read_csv_zip, read_folder
from groundstation.shows.output import write_show
from groundstation.shows.show import Show
from groundstation.shows.skyc import read_skyc
from onboard.config.fleet import ConfigError, FleetConfig


def read_show(path: Path) -> Show:
    """Return a show as it is in its file.

    Args:
        path: a .skyc of Skybrush, or a folder or a zip with a CSV for each drone.

    Raises:
        ConfigError: the show cannot be read.
    """
    if path.suffix.lower() == ".vviz":
        raise ConfigError(
            f"{path}: VVIZ is for pictures of shows, not for flights. Export .skyc or CSVs."
        )
    if path.suffix.lower() == ".skyb":
        raise ConfigError(
            f"{path}: .skyb is what Skybrush loads onto a single drone: one path, without homes "
            "and without the others. Export the whole show as .skyc, or as CSVs."
        )
    if path.suffix.lower() == ".csv":
        raise ConfigError(
            f"{path}: this is the path of one drone. A show is a folder, or a zip, with a CSV for "
            "each drone: name the folder."
        )
    if path.is_dir():
        return read_folder(path)
    if path.suffix.lower() == ".zip":
        return read_csv_zip(path)
    return read_skyc(path)


def import_show(
    show: Show,
    folder: Path,
    source: str,
    fleet: FleetConfig | None,
    promise_m: float | None,
    vertical_m: float | None = None,
) -> Converted:
    """Write the files of a show; if it cannot be flown, no file is written.

    Args:
        show: the show as it was read.
        folder: folder for the files.
        source: name of the show's file.
        fleet: fleet file whose types, endpoints and safety distance are taken; None makes one.
        promise_m: safety distance [m]; None: that of the fleet file, or the default.
        vertical_m: vertical separation [m]; None: that of the fleet file, or none.

    Raises:
        ConfigError: the show cannot be flown.
        OSError: the files cannot be written; none is left.
    """
    with tempfile.TemporaryDirectory(prefix="covey-import-") as name:
        draft = Path(name) / "show"
        try:
            flyable, _ = write_show(show, draft, source, fleet, promise_m, vertical_m=vertical_m)
            refused = refused_findings(load_mission(draft / "mission.toml"), is_simulated=False)
        except ConfigError as error:
            raise ConfigError(str(error).replace(str(draft), str(folder))) from None

        if refused:
            reasons = " ".join(finding.sentence for finding in refused) + flyable.own_time_words()
            raise ConfigError(
                f"{source}: the law says that this cannot be flown; nothing is written. {reasons}"
            )
        files = [path for path in draft.rglob("*") if path.is_file()]
        write_together({folder / path.relative_to(draft): path.read_bytes() for path in files})
    return flyable
