"""``covey import fence``: the fence of a .plan or GeoJSON, for a fleet file.

Examples:
  covey import fence field.plan --fleet fleet.toml
  covey import fence field.geojson --fleet fleet.toml --buffer 2 --height -1,30 --write

Prints tables [[fences]] for the fleet file, checked against the file's origin, spots
and limits; --write appends them to the file. docs/fences.md says more.

Exit status: 0 fine; 2 wrong input, nothing written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK


def fence(
    file: Annotated[Path, Parameter(name="FILE.plan|GEOJSON")],
    /,
    *,
    fleet: File,
    buffer: Annotated[float, Parameter(metavar="METRES")] = 0.0,
    height: Annotated[str | None, Parameter(metavar="LOW,HIGH", allow_leading_hyphen=True)] = None,
    write: bool = False,
) -> int:
    """Print the fences of a QGroundControl .plan or a GeoJSON as a fleet file has them.

    Args:
        file: a .plan of QGroundControl, or GeoJSON: polygons, their holes, points with a radius_m;
            a property keep = "out" makes an area to stay out of
        fleet: the fleet file, with an origin
        buffer: distance that goals and paths keep from each edge, in metres
        height: floor and top of each fence in the fleet's frame, in metres
        write: append the fences to the fleet file
    """
    # Imported here: the help page does not need these modules.
    from groundstation.starter.fence_files import read_fences, refuse_imported, toml_of
    from groundstation.starter.fleet_edit import checked_text, write_text

    fences = read_fences(file, buffer, _heights(height))
    refuse_imported(fences, Path(fleet))
    text = toml_of(fences)
    fleet_text = checked_text(Path(fleet), text)
    print(text, end="")
    if write:
        write_text(Path(fleet), fleet_text)
        print(
            f"\nWritten into {fleet}: {len(fences)} fences. Look at it with covey check {fleet}; "
            "every computer needs this file."
        )
    return EXIT_OK


def _heights(text: str | None) -> tuple[float, float] | None:
    """Return floor and top [m] from the words LOW,HIGH; None if the option is not given."""
    if text is None:
        return None
    try:
        low_m, high_m = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(
            f"--height is {text[:40]!r}; write two heights, as in --height -1,30."
        ) from None
    return low_m, high_m
