"""Fetches the flight logs (ULog) of several PX4s, unattended.

Each log is fetched by file transfer. If the transfer ends early, the file is opened again and read
from the first missing byte. If file transfer brings nothing more, the rest is fetched by LOG_DATA.
An incomplete log is named ``NAME.ulg.part``, and the next fetch continues after its last byte.

Logs are fetched from disarmed vehicles only, because PX4 writes the log of a flight until it
disarms, and until then the link is needed for the flight.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from groundstation.client.autopilot_link import AutopilotLink
from groundstation.px4.agent_log_link import AgentLogLink
from groundstation.px4.file_pieces import Pieces
from groundstation.px4.log_transfer import (
    ArmedInBetween,
    FileTransfer,
    LogData,
    LogEntry,
    LogLink,
    Piece,
    TransferRefused,
    TransferSilent,
)
from groundstation.px4.parameter_sets import VehicleReport
from groundstation.px4.vehicle_links import VehicleLink, for_each, is_device_of_another_computer
from groundstation.px4_logs.log_age import age_key
from onboard.config.config_error import ConfigError
from onboard.config.file_reading import ULOG, opened

# function of the name of a vehicle, the number of received bytes, and the number of all bytes
Progress = Callable[[str, int, int], None]

SUFFIX = ".ulg"
_PART_SUFFIX = ".part"
# Log folders of a flight controller, and of a PX4 on a computer. An agent forwards requests for
# files below these folders only.
_ROOTS = ("/fs/microsd/log", "/log")
_HEAD_BYTES = 16  # head of a ULog; its start time tells one flight from another
_LOG_HERE = ULOG._replace(most_bytes=None)  # only the head of a log that is here is read
_MAX_FAILURES = 2  # attempts in a row without a new byte, after which a method is given up
_SMALL_GAP_BYTES = 5_000  # a gap up to this size is read by single requests, not by a burst
_SHOWN_BYTES = 50_000  # bytes between two reports of progress
_MB = 1e6


class IncompleteError(Exception):
    """A log was not fetched completely; the message is a sentence."""


@dataclass(frozen=True, slots=True)
class VehicleLog:
    """One log on a vehicle's card."""

    name: str  # date and time of its start, in PX4's form
    size: int
    path: str = ""  # path for file transfer; empty if it was listed by LOG_DATA
    number: int | None = None  # number for LOG_DATA; None if it was listed by file transfer


class CheckedLink:
    """A link that raises as soon as the vehicle is armed.

    Args:
        link: the link to the vehicle's PX4.
    """

    def __init__(self, link: AutopilotLink) -> None:
        self._link = link

    def send(self, name: str, *values: object) -> None:
        """Send a message to the autopilot."""
        self._link.send(name, *values)

    def next_message(self, names: Iterable[str], timeout_s: float) -> Any | None:
        """Return the autopilot's next message of these names; None if none comes in time.

        Raises:
            ArmedInBetween: a heartbeat says that the vehicle is armed.
        """
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = end_s - time.monotonic()
            message = self._link.next_message((*names, "HEARTBEAT"), left_s)
            if message is None or message.get_type() != "HEARTBEAT":
                return message
            if self._link.says_armed(message):
                raise ArmedInBetween


def fetch(
    links: Sequence[VehicleLink],
    through_agents: Mapping[str, AgentLogLink],
    folder: Path,
    *,
    newest: int,
    progress: Progress,
) -> list[VehicleReport]:
    """Fetch the newest logs of vehicles.

    Args:
        links: links to the vehicles.
        through_agents: vehicle -> link through its agent, where its PX4 is not reached directly.
        folder: folder for the logs, which are named VEHICLE-DATE_TIME.ulg.
        newest: number of logs of each vehicle.
        progress: called with the progress, from several threads.
    """

    def fetch_one(link: VehicleLink) -> VehicleReport:
        agent_link = through_agents.get(link.vehicle.name)
        return _fetch_one(link, agent_link, folder, newest, progress)

    return for_each(fetch_one, links)


def _fetch_one(
    link: VehicleLink,
    agent_link: AgentLogLink | None,
    folder: Path,
    newest: int,
    progress: Progress,
) -> VehicleReport:
    name = link.vehicle.name
    log_link: LogLink
    if link.link is not None:
        log_link = CheckedLink(link.link)
        is_armed = link.is_armed
        link_words = link.version_text
    elif agent_link is not None:
        log_link = agent_link
        is_armed = bool(agent_link.is_armed)
        link_words = "through its agent"
    else:
        return VehicleReport(name, is_fine=False, headline=_trouble(link), answers=False)

    if is_armed:
        headline = "nothing was fetched: it is armed. Land and disarm it."
        return VehicleReport(name, is_fine=False, headline=headline)

    lines: list[str] = []
    try:
        logs = listed(log_link, newest)
        for log in logs:
            target = folder / f"{name}-{log.name}{SUFFIX}"
            lines.append(_fetched(log_link, log, target, name, progress))
    except ArmedInBetween:
        headline = (
            "stopped: it was armed meanwhile. Land and disarm it, and fetch once more:"
            " it goes on where it was."
        )
        return VehicleReport(name, is_fine=False, headline=headline, lines=tuple(lines))
    except (ConfigError, IncompleteError) as error:
        return VehicleReport(name, is_fine=False, headline=str(error), lines=tuple(lines))
    except OSError as error:
        headline = f"a file cannot be written: {error}. Make room, or give another folder."
        return VehicleReport(name, is_fine=False, headline=headline, lines=tuple(lines))

    if not logs:
        headline = "its PX4 has no log, or gives none out: look at SDLOG_MODE and at its card."
        return VehicleReport(name, is_fine=False, headline=headline)
    return VehicleReport(name, is_fine=True, headline=link_words, lines=tuple(lines))


def _trouble(link: VehicleLink) -> str:
    vehicle = link.vehicle
    if not is_device_of_another_computer(vehicle) or vehicle.direct is not None:
        return link.trouble

    device, _, _ = vehicle.autopilot.removeprefix("serial://").rpartition(":")  # without baud rate
    return (
        f"Its PX4 is at {device} of {vehicle.host}, another computer, and its agent, through which"
        f" the log would come, is not heard. Start the agent, or run 'covey log fetch DIR"
        f" --vehicles {vehicle.name}' there, or take the card, or give a way past the companion as"
        f" vehicles.{vehicle.name}.direct (docs/deployment.md)."
    )


# -- which logs ------------------------------------------------------------------------------------


def listed(link: LogLink, newest: int) -> list[VehicleLog]:
    """Return the newest logs of a vehicle, the newest first.

    Args:
        link: link to its PX4.
        newest: number of logs.
    """
    logs = _listed_by_file_transfer(link, newest)
    if logs is not None:
        return logs

    entries = LogData(link).entries()
    entries.sort(key=lambda entry: (entry.unix_s, entry.number), reverse=True)
    return [
        VehicleLog(name=_name_of(entry), size=entry.size, number=entry.number)
        for entry in entries[:newest]
    ]


def _listed_by_file_transfer(link: LogLink, newest: int) -> list[VehicleLog] | None:
    """Return the newest logs of a vehicle; None if its PX4 does not list them by file transfer."""
    transfer = FileTransfer(link)
    try:
        transfer.reset()
    except (TransferSilent, TransferRefused):
        return None

    for root in _ROOTS:
        try:
            return _listed_in(transfer, root, newest)
        except TransferRefused:
            continue  # this PX4 has another root folder
        except TransferSilent:
            return None
    return None


def _listed_in(transfer: FileTransfer, root: str, newest: int) -> list[VehicleLog]:
    """Return the newest logs in the folders below a root.

    PX4 names folders and files by date and time. If it does not know the date of a flight, it names
    them ``sess012/log001``; these logs count as older than all others.
    """
    folders = [entry.name for entry in transfer.folder(root) if entry.is_folder]
    folders.sort(key=age_key, reverse=True)

    logs: list[VehicleLog] = []
    for folder in folders:
        files = [
            entry
            for entry in transfer.folder(f"{root}/{folder}")
            if not entry.is_folder and entry.name.endswith(SUFFIX) and entry.size
        ]
        files.sort(key=lambda entry: entry.name, reverse=True)
        for entry in files:
            stem = entry.name.removesuffix(SUFFIX)
            path = f"{root}/{folder}/{entry.name}"
            logs.append(VehicleLog(name=f"{folder}_{stem}", size=entry.size, path=path))
        if len(logs) >= newest:
            break
    return logs[:newest]


def _name_of(entry: LogEntry) -> str:
    if not entry.unix_s:
        return f"log{entry.number:03d}"
    return time.strftime("%Y-%m-%d_%H_%M_%S", time.gmtime(entry.unix_s))


# -- one log ---------------------------------------------------------------------------------------


class _Download:
    """Writes the pieces of one log to a file.

    Args:
        file: the file to which bytes are appended.
        pieces: assembles the pieces of the log.
        show: called with the number of received bytes.
    """

    def __init__(self, file: BinaryIO, pieces: Pieces, show: Callable[[int], None]) -> None:
        self._file = file
        self._show = show
        self._shown_bytes = pieces.bytes_in_order
        self.pieces = pieces

    def head(self) -> bytes:
        """Return the first bytes of the file, as far as they have been received."""
        self._file.seek(0)
        head = self._file.read(_HEAD_BYTES)
        self._file.seek(0, os.SEEK_END)
        return head

    def take(self, piece: Piece) -> None:
        """Add a piece."""
        self._file.write(self.pieces.add(piece.offset, piece.data))
        if self.pieces.bytes_in_order - self._shown_bytes >= _SHOWN_BYTES or self.pieces.is_whole:
            self._shown_bytes = self.pieces.bytes_in_order
            self._show(self._shown_bytes)


def _fetched(link: LogLink, log: VehicleLog, target: Path, vehicle: str, progress: Progress) -> str:
    """Fetch one log; return a line about it.

    Raises:
        ArmedInBetween, ConfigError, IncompleteError, OSError: it was not fetched completely.
    """
    target = _without_another_flight(link, log, target)
    if target.exists() and target.stat().st_size == log.size:
        return f"{target}: is here already"

    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(target.name + _PART_SUFFIX)
    begin_s = time.monotonic()
    with part.open("ab+") as file:
        count_before = _usable_bytes(link, log, file, part)
        pieces = Pieces(log.size, count_before)
        download = _Download(file, pieces, lambda count: progress(vehicle, count, log.size))

        methods = _by_all_methods(link, log, download)

    if not pieces.is_whole:
        raise _incomplete(part, pieces.bytes_in_order, log)
    part.replace(target)

    if count_before:
        methods.insert(0, f"{count_before / _MB:.2f} MB were here")
    took_s = time.monotonic() - begin_s
    return f"{target}: {log.size / _MB:.2f} MB in {took_s:.0f} s, {'; '.join(methods)}"


def _without_another_flight(link: LogLink, log: VehicleLog, target: Path) -> Path:
    """Return a path at which there is no log of another flight.

    A PX4 that does not know the date may use a name again, for instance on a new card. A file that
    begins as this log does is an earlier part of it.
    """
    path = target
    number = 1
    while path.exists() and path.stat().st_size != log.size:
        with opened(path, _LOG_HERE) as file:
            known_head = file.read(_HEAD_BYTES)
        if known_head == _head(link, log)[: len(known_head)]:
            break
        number += 1
        path = target.with_name(f"{target.stem}-{number}{SUFFIX}")
    return path


def _by_all_methods(link: LogLink, log: VehicleLog, download: _Download) -> list[str]:
    """Fetch the missing bytes by one method after the other, until no method brings more.

    Returns:
        Words about each method that brought bytes.
    """
    pieces = download.pieces
    sessions = 0
    count_by_file = 0  # bytes by file transfer
    count_by_data = 0  # bytes by LOG_DATA
    failures = 0
    while not pieces.is_whole and failures < _MAX_FAILURES:
        count_before = pieces.bytes_in_order
        if log.path:
            sessions += _by_file_transfer(link, log.path, download)
        count_between = pieces.bytes_in_order
        if not pieces.is_whole:
            _by_log_data(link, log, download)
        count_after = pieces.bytes_in_order

        count_by_file += count_between - count_before
        count_by_data += count_after - count_between
        failures += 1
        if count_after > count_before:
            failures = 0

    methods = []
    if count_by_file:
        again = f", opened {sessions} times" if sessions > 1 else ""
        methods.append(f"{count_by_file / _MB:.2f} MB by file transfer{again}")
    if count_by_data:
        methods.append(f"{count_by_data / _MB:.2f} MB by LOG_DATA")
    return methods


def _incomplete(part: Path, count: int, log: VehicleLog) -> IncompleteError:
    return IncompleteError(
        f"{part} has {count} of {log.size} bytes, then PX4 gave out nothing more."
        " Run this once more: it goes on there."
    )


def _usable_bytes(link: LogLink, log: VehicleLog, file: BinaryIO, part: Path) -> int:
    """Return the number of bytes from an earlier fetch; the bytes of another log are removed.

    Raises:
        IncompleteError: PX4 does not say whether they are of this log; they are kept.
    """
    count = file.seek(0, os.SEEK_END)
    if count and count <= log.size:
        file.seek(0)
        known_head = file.read(_HEAD_BYTES)
        file.seek(0, os.SEEK_END)

        head = _head(link, log)
        if len(head) < len(known_head):
            raise _incomplete(part, count, log)
        if head.startswith(known_head):
            return count
    file.truncate(0)
    return 0


def _head(link: LogLink, log: VehicleLog) -> bytes:
    """Return the first bytes of a log on the vehicle; empty if they cannot be read."""
    if log.path:
        transfer = FileTransfer(link)
        try:
            transfer.open(log.path)
            return transfer.read(0, _HEAD_BYTES).data
        except (TransferRefused, TransferSilent):
            return b""
    if log.number is None:
        return b""
    return b"".join(piece.data for piece in LogData(link).read(log.number, 0, _HEAD_BYTES))


def _by_file_transfer(link: LogLink, path: str, download: _Download) -> int:
    """Fetch the missing bytes by file transfer; return how often the file was opened."""
    transfer = FileTransfer(link)
    pieces = download.pieces
    sessions = 0
    failures = 0
    while not pieces.is_whole and failures < _MAX_FAILURES:
        before = pieces.bytes_in_order
        try:
            transfer.open(path)
            sessions += 1
            _read_on(transfer, download)
        except (TransferRefused, TransferSilent):
            pass  # PX4 has ended the session: open the file once more

        failures += 1
        if pieces.bytes_in_order > before:
            failures = 0

    # close the session; if this fails, PX4 closes it by itself after a while
    with contextlib.suppress(TransferRefused, TransferSilent):
        transfer.reset()
    return sessions


def _read_on(transfer: FileTransfer, download: _Download) -> None:
    """Read an open file until the log is whole, or no more bytes come."""
    pieces = download.pieces
    while not pieces.is_whole:
        before = pieces.bytes_in_order
        begin, end = pieces.gap
        if end < pieces.size and end - begin <= _SMALL_GAP_BYTES:
            download.take(transfer.read(begin, end - begin))
        else:
            for piece in transfer.burst(begin):
                download.take(piece)
                if pieces.drops_more:
                    # So many pieces wait behind a hole that further ones would be dropped. The
                    # caller reopens the file, which ends the burst, and reads the hole first.
                    return
        if pieces.bytes_in_order == before:
            return


def _by_log_data(link: LogLink, log: VehicleLog, download: _Download) -> None:
    """Fetch the missing bytes by LOG_DATA."""
    data = LogData(link)
    number = log.number
    if number is None:
        number = _number_of(data, log, download)
    if number is None:
        return

    pieces = download.pieces
    failures = 0
    while not pieces.is_whole and failures < _MAX_FAILURES:
        before = pieces.bytes_in_order
        begin, end = pieces.gap
        for piece in data.read(number, begin, end - begin):
            download.take(piece)

        failures += 1
        if pieces.bytes_in_order > before:
            failures = 0
    data.stop()


def _number_of(data: LogData, log: VehicleLog, download: _Download) -> int | None:
    """Return the number that LOG_DATA gives a log of the card; None if it cannot be found.

    LOG_ENTRY contains only size and date of the last change. So the log is recognised by its first
    bytes, or by its size if no byte of it has come yet. Larger logs are compared as well, because
    PX4 may still have written after the log was listed.
    """
    candidates = [entry for entry in data.entries() if entry.size >= log.size]
    candidates.sort(key=lambda entry: (entry.size, -entry.unix_s))

    known_head = download.head()
    if not known_head:
        for entry in candidates:
            if entry.size == log.size:
                return entry.number
        return None

    for entry in candidates:
        head = b"".join(piece.data for piece in data.read(entry.number, 0, _HEAD_BYTES))
        if head.startswith(known_head):
            return entry.number
    return None
