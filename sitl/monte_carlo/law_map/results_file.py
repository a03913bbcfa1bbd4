"""The file of results of a map or a benchmark: one JSON line for each unit that has been flown.

The map of the law (``covey simulate --map``) shows in which cells of delay, loss, speed and number
of vehicles the law holds. A unit is a batch of flights in one cell. A run can be interrupted at any
time, and continued from its file.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import msgspec

from onboard.config.file_reading import RESULTS_FILE, json_values, opened, read_bytes
from onboard.config.fleet import ConfigError
from sitl.monte_carlo.executors import say
from sitl.monte_carlo.law_map.unit_flights import SCHEMA, MapRow

_HEAD_BYTES = 64  # longer than the begin of a first line that tells the kind of the file


class ResultsKind(NamedTuple):
    """The kind of a file of results."""

    head: str  # key of the first line, whose value is the schema
    command: str  # the command that writes such files
    option: str  # the option of that command that names the file
    numbers: tuple[str, ...]  # keys of a row whose values are numbers
    others: tuple[str, ...] = ()  # further keys that a row must have
    # what each of a row's "flights" has, of which there is at least one; None: a row lists none
    flight: type[msgspec.Struct] | None = None


MAP = ResultsKind(
    head="law_map",
    command="covey simulate --map",
    option="--map-file",
    numbers=("flights", "below", "collisions", "arrived", "worst_m", "speed_m_s"),
    others=("ratio",),
)


class ResultsFile:
    """The rows of a map in a file that only one run at a time can write; a context manager."""

    def __init__(
        self, path: Path, version: str, *, kind: ResultsKind = MAP, is_anew: bool = False
    ) -> None:
        """Open or begin the file.

        Args:
            path: path of the file.
            version: version of the law that flies now (``unit_flights.version``).
            kind: kind of the file.
            is_anew: whether an existing file is put aside, and a new one begun.

        Raises:
            ConfigError: another run is writing the file, or it is a different kind of file, or of
                another version.
        """
        self.path = path
        self._kind = kind
        self.version = version
        self._descriptor = _locked(path)
        try:
            if is_anew:
                self._put_aside()
            self.rows = self._read()
        except ConfigError:
            os.close(self._descriptor)
            raise

    def __enter__(self) -> ResultsFile:
        """Return the file."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        """Close the file, so that other runs can write it."""
        os.close(self._descriptor)

    def _put_aside(self) -> None:
        """Rename the file, unless it is empty, and begin a new one."""
        begin = os.pread(self._descriptor, _HEAD_BYTES, 0)
        self._check_kind(begin)
        if not begin:
            return

        aside = _free_name(self.path)
        try:
            self.path.rename(aside)
        except OSError as error:
            raise ConfigError(
                f"{self.path}: it cannot be renamed to {aside.name} ({error.strerror}). Name "
                "another file."
            ) from None
        new_descriptor = _locked(self.path)
        os.close(self._descriptor)
        self._descriptor = new_descriptor
        say(f"the former results are kept in {aside}")

    def _check_kind(self, data: bytes) -> None:
        """Refuse a file of another kind, which is not changed.

        Args:
            data: the begin of the file; its first line may be incomplete.
        """
        begin = f'{{"{self._kind.head}": '.encode()
        if data and not data.startswith(begin[: len(data)]):
            raise ConfigError(
                f"{self.path}: this is no file of `{self._kind.command}`. Name another one."
            )

    def _read(self) -> dict[tuple[str, int], MapRow]:
        """Return the complete rows, and cut off an incomplete line that a killed run has left."""
        data = read_bytes(self.path, RESULTS_FILE)
        after_last_newline = data.rfind(b"\n") + 1
        complete = data[:after_last_newline]

        self._check_kind(data)

        head: MapRow = {}
        rows: dict[tuple[str, int], MapRow] = {}
        if complete:
            head, rows = parsed(complete.decode("utf-8", "replace"), self.path, self._kind)

        if len(complete) < len(data):
            os.ftruncate(self._descriptor, len(complete))
        if not complete:
            self._append({self._kind.head: SCHEMA, "version": self.version})
            return {}

        if head["version"] != self.version:
            raise ConfigError(
                f"{self.path} was flown by another version of the law, its vehicles, or on another "
                f"kind of processor ({head['version']}, here {self.version}): its flights and "
                "these are not added up. Continue with that version, name another file with "
                f"{self._kind.option}, or begin anew with --anew, which puts this one aside."
            )
        return rows

    def add(self, row: MapRow) -> None:
        """Append a row, unless there is one for that stage of that cell."""
        key = (row["cell"], int(row["stage"]))
        if key not in self.rows:
            self.rows[key] = row
            self._append(row)

    def _append(self, row: MapRow) -> None:
        line = (json.dumps(row) + "\n").encode()
        try:
            is_whole = os.write(self._descriptor, line) == len(line)
            os.fsync(self._descriptor)
        except OSError:
            is_whole = False
        if not is_whole:
            raise ConfigError(
                f"{self.path}: a result could not be written; is the disk full? Make room; the "
                "same command goes on."
            )


def _locked(path: Path) -> int:
    """Return the descriptor of a file that no other run writes meanwhile.

    Raises:
        ConfigError: another run is writing the file, or it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            opened(path, RESULTS_FILE).close()  # refuses a pipe, where os.open would block
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
    except OSError as error:
        raise ConfigError(
            f"{path}: the results cannot be kept there ({error.strerror}). Name another file."
        ) from None

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise ConfigError(
            f"{path}: another run is writing this file. Let it end, or name another file."
        ) from None
    return descriptor


def _free_name(path: Path) -> Path:
    """Return the first of PATH.old, PATH.old2, PATH.old3 and so on that does not exist."""
    name = path.with_name(f"{path.name}.old")
    number = 1
    while name.exists():
        number += 1
        name = path.with_name(f"{path.name}.old{number}")
    return name


def parsed(
    text: str, path: Path, kind: ResultsKind = MAP
) -> tuple[MapRow, dict[tuple[str, int], MapRow]]:
    """Return the head of a file of results, and its rows by cell and stage.

    The head holds the version. If there are two rows of a cell and stage, the first one counts.

    Args:
        text: content of the file.
        path: path of the file, for messages.
        kind: kind of the file.

    Raises:
        ConfigError: the text is not a file of results, is damaged, or has an unknown schema.
    """
    try:
        head, *lines = (json_values(line, str(path)) for line in text.splitlines())
        schema = head[kind.head]
        version = str(head["version"])

        rows: dict[tuple[str, int], MapRow] = {}
        for row in lines:
            has_numbers = all(isinstance(row[name], int | float) for name in kind.numbers)
            if not has_numbers or not all(name in row for name in kind.others):
                raise TypeError(f"numbers are missing in {row['cell']}")
            if kind.flight is not None:
                if not row["flights"]:
                    raise TypeError(f"flights are missing in {row['cell']}")
                for flight in row["flights"]:
                    msgspec.convert(flight, kind.flight)
            key = (str(row["cell"]), int(row["stage"]))
            rows.setdefault(key, row)
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path}: this is no file of `{kind.command}`, or it is damaged ({error}). Name "
            "another, or begin anew with --anew, which puts this one aside."
        ) from None

    if schema != SCHEMA:
        raise ConfigError(
            f"{path}: a file of schema {schema}; this version of Covey reads {SCHEMA}. "
            "Begin anew with --anew, which puts this one aside."
        )
    return {"version": version}, rows


def digest(rows: dict[tuple[str, int], MapRow]) -> str:
    """Return the digest of all rows; the order in which they were flown does not change it."""
    lines = [json.dumps(rows[key], sort_keys=True) for key in sorted(rows)]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
