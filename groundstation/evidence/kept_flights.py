"""The flights of a campaign, kept in a file of JSON lines.

The first line identifies the campaign: fleet, mission, wind and version of Covey. Each further line
is one flight. A campaign that was stopped continues with the flights in the file. The file of
another campaign is refused, so that no flight of it is counted.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import msgspec

from onboard.config.file_reading import EVIDENCE_FILE, read_bytes
from onboard.config.fleet import ConfigError

KEPT_NAME = "flights.jsonl"
NOTHING = "nothing"  # the fault of an undisturbed flight


class FlightCase(msgspec.Struct, frozen=True, kw_only=True):
    """One flight of a campaign."""

    fault: str
    round: int
    victim: str = ""
    at_s: float = 0.0  # time of the fault since the start of the simulation
    seed: int = 0
    wind_enu_m_s: tuple[float, float] = (0.0, 0.0)


class FlownCase(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a flight. All numbers are rounded, since the digest contains them."""

    case: FlightCase
    wrong: tuple[str, ...]  # sentences about what must not happen; empty: the flight is right
    seen: dict[str, int]  # condition of the failsafe table -> ticks in which it held
    took_off: bool
    first_airborne_s: float
    last_airborne_s: float
    smallest_m: float | None  # smallest distance, by ground truth, of pairs that the law flies
    smallest_silenced_m: float | None  # the same for pairs in which one vehicle no longer avoids
    hull_m: tuple[tuple[float, float], ...]  # convex hull of positions in the air, east and north
    highest_m: float
    fastest_m_s: float  # horizontal
    had_pair: bool = False  # whether two vehicles were in the air at the same time

    @property
    def is_right(self) -> bool:
        """Whether nothing happened that must not happen."""
        return not self.wrong


class KeptFlights:
    """The file of a campaign.

    Args:
        path: path of the file; it is created if it does not exist.
        origin: hashes and numbers that identify the campaign, by name.

    Raises:
        ConfigError: the file belongs to another campaign, or cannot be read.
    """

    def __init__(self, path: Path, origin: dict[str, str]) -> None:
        self.path = path
        self.flown: dict[FlightCase, FlownCase] = {}
        if os.path.lexists(path):  # a broken symbolic link counts, too; reading it then refuses it
            self._read(origin)
        else:
            path.write_bytes(msgspec.json.encode(origin) + b"\n")

    def _read(self, origin: dict[str, str]) -> None:
        """Read the flights of a file, which must have this origin.

        The file is rewritten, because its last line may be incomplete.
        """
        for flight in read_flights(self.path, origin):
            self.flown[flight.case] = flight
        self._write_whole(origin)

    def _write_whole(self, origin: dict[str, str]) -> None:
        """Rewrite the file without an incomplete line; wholly or not at all."""
        lines = [msgspec.json.encode(origin), *map(msgspec.json.encode, self.flown.values())]
        target = self.path.resolve()
        new_path = target.with_name(f".{target.name}.new")
        try:
            new_path.write_bytes(b"".join(line + b"\n" for line in lines))
            shutil.copymode(target, new_path)
            new_path.replace(target)
        except OSError as error:
            with contextlib.suppress(OSError):
                new_path.unlink()
            raise ConfigError(
                f"{self.path} cannot be written ({error.strerror}). Correct its permissions, or"
                " make room; its flights are kept."
            ) from None

    def keep(self, flight: FlownCase) -> None:
        """Add a flight."""
        self.flown[flight.case] = flight
        with self.path.open("ab") as stream:
            stream.write(msgspec.json.encode(flight) + b"\n")


def read_flights(path: Path, origin: dict[str, str]) -> list[FlownCase]:
    """Return the flights of a file, without an incomplete last line.

    Args:
        path: path of the file.
        origin: hashes and numbers that identify the campaign, by name; others are not compared.

    Raises:
        ConfigError: the file belongs to another campaign, or cannot be read.
    """
    lines = read_bytes(path, EVIDENCE_FILE).splitlines()
    try:
        kept_origin = msgspec.json.decode(lines[0], type=dict[str, str])
    except (IndexError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise ConfigError(
            f"{path} does not begin with a line of covey evidence. Give another folder."
        ) from None
    different = [name for name in origin if kept_origin.get(name) != origin[name]]
    if different:
        raise ConfigError(
            f"{path} holds flights of another campaign ({', '.join(different)} differs)."
            " Give another folder."
        )

    flights = []
    for line in lines[1:]:
        try:
            flights.append(msgspec.json.decode(line, type=FlownCase))
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            break  # an incomplete last line: the campaign was stopped while it was written
    return flights


def digest(flights: Sequence[FlownCase]) -> str:
    """Return the SHA-256 of flights; the order in which they were flown does not change it."""
    lines = sorted(msgspec.json.encode(flight, order="deterministic") for flight in flights)
    return hashlib.sha256(b"\n".join(lines)).hexdigest()
