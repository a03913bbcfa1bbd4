"""The flights of a campaign, kept as lines of JSON behind a first line that says of which campaign.

A campaign that was stopped goes on with the lines that there are. They belong to one fleet, one
mission, one wind and one Covey: with others the file is refused, so that no line of another
campaign is counted.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from onboard.config.file_reading import EVIDENCE_FILE, read_bytes
from onboard.config.fleet import ConfigError

KEPT_NAME = "flights.jsonl"
NOTHING = "nothing"  # what breaks in a flight in which nothing does


class FlightCase(msgspec.Struct, frozen=True, kw_only=True):
    """One flight of a campaign."""

    fault: str
    round: int
    victim: str = ""
    at_s: float = 0.0  # since the start of the simulation
    seed: int = 0
    wind_enu_m_s: tuple[float, float] = (0.0, 0.0)


class FlownCase(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a flight. Everything is rounded: the digest of the campaign is of these."""

    case: FlightCase
    wrong: tuple[str, ...]  # sentences; empty when all held
    seen: dict[str, int]  # ticks in which a condition of the failsafe table held
    took_off: bool
    first_airborne_s: float
    last_airborne_s: float
    # by ground truth, of pairs that the law flies, and of pairs with one that fell silent
    smallest_m: float | None
    smallest_silenced_m: float | None
    hull_m: tuple[tuple[float, float], ...]  # around all places in the air, east and north
    highest_m: float
    fastest_m_s: float  # over the ground

    @property
    def is_right(self) -> bool:
        """Whether all held."""
        return not self.wrong


class KeptFlights:
    """The file of a campaign.

    Args:
        path: of the file.
        origin: of which campaign: hashes and numbers, by their names.

    Raises:
        ConfigError: the file is of another campaign, or cannot be read.
    """

    def __init__(self, path: Path, origin: dict[str, str]) -> None:
        self.path = path
        self.flown: dict[FlightCase, FlownCase] = {}
        if os.path.lexists(path):  # also a link that leads nowhere
            self._read(origin)
        else:
            path.write_bytes(msgspec.json.encode(origin) + b"\n")

    def _read(self, origin: dict[str, str]) -> None:
        lines = read_bytes(self.path, EVIDENCE_FILE).splitlines()
        try:
            kept_origin = msgspec.json.decode(lines[0], type=dict[str, str])
        except (IndexError, msgspec.DecodeError, RecursionError):
            raise ConfigError(
                f"{self.path} does not begin with a line of covey evidence. Give another folder."
            ) from None
        different = [name for name in origin if kept_origin.get(name) != origin[name]]
        if different:
            raise ConfigError(
                f"{self.path} holds flights of another campaign ({', '.join(different)} differs)."
                " Give another folder, or remove it."
            )

        for line in lines[1:]:
            try:
                one = msgspec.json.decode(line, type=FlownCase)
            except (msgspec.DecodeError, RecursionError):
                break  # the last line, cut when it was stopped
            self.flown[one.case] = one
        self._write_whole(origin)

    def _write_whole(self, origin: dict[str, str]) -> None:
        """Write the file anew, without a line that was cut."""
        lines = [msgspec.json.encode(origin), *map(msgspec.json.encode, self.flown.values())]
        self.path.write_bytes(b"".join(line + b"\n" for line in lines))

    def keep(self, one: FlownCase) -> None:
        """Add a flight."""
        self.flown[one.case] = one
        with self.path.open("ab") as stream:
            stream.write(msgspec.json.encode(one) + b"\n")


def digest(flights: Sequence[FlownCase]) -> str:
    """Return the SHA-256 of flights, whatever the order in which they were flown."""
    lines = sorted(msgspec.json.encode(one, order="deterministic") for one in flights)
    return hashlib.sha256(b"\n".join(lines)).hexdigest()
