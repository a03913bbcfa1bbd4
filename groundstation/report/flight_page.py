"""Writes ``DIR/report.html``: a flight folder's record and logs as one page."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from groundstation.px4_logs.flight_logs import logs_of_flight
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.output_file import refuse_other_file, written_beside
from groundstation.recording.recorded_flight import Flight
from groundstation.report.payload import payload
from groundstation.report.report_page import page
from groundstation.scene.ground_tiles import GroundTiles, read_ground_tiles
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.plain_text import plain_line

PAGE_NAME = "report.html"
_MAX_NAMES = 200  # letters of the names in a sentence
_PAGE_MARK = b"Covey</title>"  # how the title of every page ends


class Written(NamedTuple):
    """A page that was written to a file."""

    path: Path
    size: int  # bytes
    notes: tuple[str, ...]  # sentences about what the record lacks


class MadePage(NamedTuple):
    """A page that is not written to a file."""

    text: str  # HTML
    notes: tuple[str, ...]  # sentences about what the record lacks


def make_page(
    folder: Path,
    *,
    fleet_path: str | None = None,
    compared: Path | None = None,
    tiles: Path | None = None,
) -> MadePage:
    """Return the page of a flight.

    Args:
        folder: the flight folder, or the MCAP file in it.
        fleet_path: the fleet file; None takes the one beside the record, if there is one.
        compared: the flight folder of another flight, shown beside this one.
        tiles: the folder with pictures of the ground.

    Raises:
        ConfigError: there is no record, it has no vehicle, the other flight has none of its
            vehicles, or no tile covers its fence.
    """
    flight = read_flight(folder, fleet_path)
    ghost = None
    ghost_notes: tuple[str, ...] = ()
    if compared is not None:
        ghost = read_flight(compared)
        ghost_notes = _ghost_notes(folder, flight, compared, ghost)
    logs = logs_of_flight(folder, flight)
    ground = None
    if tiles is not None:
        ground = _ground(folder, tiles, flight.fleet)
    data = payload(flight, made_by=_made_by(), ghost=ghost, logs=logs, ground=ground)
    text = page(flight.title, data, has_pictures=ground is not None)
    return MadePage(text=text, notes=(*flight.notes, *logs.notes, *ghost_notes))


def _ghost_notes(folder: Path, flight: Flight, compared: Path, ghost: Flight) -> tuple[str, ...]:
    """Return a sentence about the vehicles that the other flight does not have, if there are any.

    Raises:
        ConfigError: it has none of them.
    """
    alone = [name for name in flight.vehicles if name not in ghost.vehicles]
    if len(alone) == len(flight.vehicles):
        others = plain_line(", ".join(ghost.vehicles))[:_MAX_NAMES]
        raise ConfigError(
            f"{compared} has none of the vehicles of {folder}, but {others}, so there is nothing to"
            " compare. Name a flight of the same vehicles."
        )
    if not alone:
        return ()
    names = plain_line(", ".join(alone))[:_MAX_NAMES]
    return (f"{compared} does not have these vehicles, which are shown without a ghost: {names}.",)


def _ground(folder: Path, tiles: Path, fleet: FleetConfig | None) -> GroundTiles:
    """Return pictures of the ground below the fleet of a flight."""
    if fleet is None:
        raise ConfigError(
            f"--tiles: {folder} has no fleet file, which says where on Earth it was flown. Give it"
            " with --fleet."
        )
    return read_ground_tiles(tiles, fleet)


def write_page(
    folder: Path,
    out: Path | None = None,
    *,
    fleet_path: str | None = None,
    compared: Path | None = None,
    tiles: Path | None = None,
) -> Written:
    """Write the page of a flight.

    Args:
        folder: the flight folder, or the MCAP file in it.
        out: the file to write; None writes ``report.html`` in the flight folder.
        fleet_path: the fleet file; None takes the one beside the record, if there is one.
        compared: the flight folder of another flight, shown beside this one.
        tiles: the folder with pictures of the ground.

    Raises:
        ConfigError: there is no record, it has no vehicle, the other flight has none of its
            vehicles, no tile covers its fence, or ``out`` is a file that is no page.
        OSError: the page cannot be written.
    """
    if out is not None:
        refuse_other_file(out, lambda begin: _PAGE_MARK in begin, other="is no page of a flight")
    made = make_page(folder, fleet_path=fleet_path, compared=compared, tiles=tiles)
    text = made.text.encode("utf-8")
    path = folder.parent / PAGE_NAME
    if folder.is_dir():
        path = folder / PAGE_NAME
    if out is not None:
        path = out

    with written_beside(path) as part:
        part.write_bytes(text)
    return Written(path=path, size=len(text), notes=made.notes)


def _made_by() -> str:
    try:
        return f"covey {version('covey')}"
    except PackageNotFoundError:
        return "covey (not installed)"
