"""The two protocols by which PX4 sends a log: file transfer (MAVLink FTP), and LOG_DATA.

File transfer is fast: PX4 answers one request for a burst with many pieces. But it may end a burst
early (v1.16 does so after some seconds, without a message). It also has only one session for each
link, which may still be open from before. So the session is reset before a file is opened, and
missing bytes are requested again, from their offset. LOG_DATA is slower, and needs no session.

A payload of FTP has a head (:class:`_Head`) and up to 239 bytes of data. It is described in
MAVLink's documentation, "File Transfer Protocol".
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, Protocol

_PAYLOAD_BYTES = 251
_HEAD = struct.Struct("<HBBBBBxI")  # the fields of _Head, with a byte of padding before the last
_MAX_DATA = _PAYLOAD_BYTES - _HEAD.size  # bytes

# operations
_RESET = 2
_LIST = 3
_OPEN = 4
_READ = 5
_BURST = 15
_ACK = 128
_NAK = 129

# errors
END_OF_FILE = 6

_ATTEMPTS = 4  # number of times that a request is sent if no answer comes
_ANSWER_S = 0.6  # longest wait for the answer to a request
_SILENT_S = 1.0  # a burst has ended after this time without a piece
_MAX_ENTRIES = 20_000  # entries of a folder
_MAX_LOGS = 10_000
_ALL_LOGS = 0xFFFF  # last log of a request for all logs
_LOG_PART_BYTES = 90 * 512  # largest part of a log in one request; a LOG_DATA has 90 bytes


class LogLink(Protocol):
    """The parts of a link to PX4 that a transfer uses."""

    def send(self, name: str, *values: object) -> None:
        """Send a message to the autopilot."""

    def next_message(self, names: Iterable[str], timeout_s: float) -> Any | None:
        """Return the autopilot's next message of these names; None if none comes in time."""


class Piece(NamedTuple):
    """Some bytes of a file."""

    offset: int
    data: bytes


class _Head(NamedTuple):
    """Head of a payload of FTP."""

    sequence: int
    session: int
    operation: int
    size: int  # number of bytes of data
    answered_operation: int
    is_complete: int  # whether a burst is complete
    offset: int


class FileEntry(NamedTuple):
    """One entry of a folder."""

    name: str
    size: int
    is_folder: bool


class LogEntry(NamedTuple):
    """One log in PX4's list (LOG_ENTRY)."""

    number: int
    size: int
    unix_s: int  # Unix time of its last change; 0 if PX4 does not know the date


class TransferRefused(Exception):
    """PX4 answered a request with an error.

    Attributes:
        error: number of the error in MAVLink FTP.
    """

    def __init__(self, error: int) -> None:
        super().__init__(f"error {error}")
        self.error = error


class ArmedInBetween(Exception):
    """The vehicle was armed while its log was fetched."""


class TransferSilent(Exception):
    """PX4 did not answer a request."""


class FileTransfer:
    """A client of PX4's file transfer.

    Args:
        link: link to PX4.
    """

    def __init__(self, link: LogLink) -> None:
        self._link = link
        self._sequence = 0

    def reset(self) -> None:
        """Close the session on this link.

        Raises:
            TransferSilent: PX4 does not answer, or has no file transfer.
            TransferRefused: PX4 refuses.
        """
        self._ask(_RESET)

    def folder(self, path: str) -> list[FileEntry]:
        """Return the entries of a folder.

        Raises:
            TransferRefused: there is no such folder.
            TransferSilent: PX4 does not answer.
        """
        entries: list[FileEntry] = []
        # index of the next entry; entries that are neither file nor folder count, too
        next_index = 0
        while next_index < _MAX_ENTRIES:
            try:
                answer = self._ask(_LIST, offset=next_index, data=path.encode("utf-8"))
            except TransferRefused as refused:
                if refused.error == END_OF_FILE:
                    break
                raise
            raw_entries = [raw for raw in answer.split(b"\0") if raw]
            if not raw_entries:
                break
            next_index += len(raw_entries)
            for raw in raw_entries:
                entry = _entry(raw)
                if entry is not None:
                    entries.append(entry)
        return entries

    def open(self, path: str) -> int:
        """Open a file; return its size.

        Raises:
            TransferRefused, TransferSilent: it cannot be opened.
        """
        self.reset()
        answer = self._ask(_OPEN, data=path.encode("utf-8"))
        return int.from_bytes(answer[:4], "little")

    def read(self, offset: int, size: int) -> Piece:
        """Return the bytes at an offset, as many as fit.

        Raises:
            TransferRefused, TransferSilent: they cannot be read.
        """
        answer = self._ask(_READ, offset=offset, size=min(size, _MAX_DATA))
        return Piece(offset, answer)

    def burst(self, offset: int) -> Iterator[Piece]:
        """Yield pieces from an offset on, until PX4 ends the burst or falls silent."""
        self._send(_BURST, offset=offset, data=b"", size=_MAX_DATA)
        while True:
            answer = self._next_answer(_BURST, _SILENT_S)
            if answer is None:
                return
            head = _head_of(answer)
            if head.operation != _ACK:
                return
            yield Piece(head.offset, _data_of(answer))
            if head.is_complete:
                return

    def _ask(
        self, operation: int, *, offset: int = 0, data: bytes = b"", size: int | None = None
    ) -> bytes:
        """Send a request until it is answered; return the data of the answer.

        Args:
            operation: number of the operation.
            offset: offset in the file, or index in the folder.
            data: data of the request.
            size: number of bytes that are requested; None: the number of bytes in ``data``.

        Raises:
            TransferRefused: the answer is an error.
            TransferSilent: there is no answer.
        """
        self._sequence = (self._sequence + 1) & 0xFFFF
        if size is None:
            size = len(data)
        for _ in range(_ATTEMPTS):
            # When a request comes again with the same number, PX4 repeats its answer instead of
            # acting twice. The answer has the next number.
            self._send_numbered(operation, offset, data, size)
            answer_number = (self._sequence + 1) & 0xFFFF
            answer = self._next_answer(operation, _ANSWER_S, sequence=answer_number)
            if answer is None:
                continue

            content = _data_of(answer)
            if _head_of(answer).operation != _NAK:
                return content
            error = 0  # its number, which is the first byte of the answer
            if content:
                error = content[0]
            raise TransferRefused(error)
        raise TransferSilent

    def _send(self, operation: int, *, offset: int, data: bytes, size: int) -> None:
        self._sequence = (self._sequence + 1) & 0xFFFF
        self._send_numbered(operation, offset, data, size)

    def _send_numbered(self, operation: int, offset: int, data: bytes, size: int) -> None:
        session = 0
        answered_operation = 0
        is_complete = 0
        head = _HEAD.pack(
            self._sequence, session, operation, size, answered_operation, is_complete, offset
        )
        payload = (head + data[:_MAX_DATA]).ljust(_PAYLOAD_BYTES, b"\0")
        network = 0
        self._link.send("file_transfer_protocol", network, payload)

    def _next_answer(
        self, operation: int, timeout_s: float, *, sequence: int | None = None
    ) -> bytes | None:
        """Return the next payload that answers an operation; None if none comes in time.

        With a sequence number, payloads with another number are passed over.
        """
        while True:
            message = self._link.next_message(("FILE_TRANSFER_PROTOCOL",), timeout_s)
            if message is None:
                return None
            payload = bytes(message.payload)
            head = _head_of(payload)
            is_answer = head.operation in (_ACK, _NAK)
            if not is_answer or head.answered_operation != operation:
                continue
            if sequence is None or head.sequence == sequence:
                return payload


def _head_of(payload: bytes) -> _Head:
    return _Head(*_HEAD.unpack_from(payload))


def _data_of(payload: bytes) -> bytes:
    size = min(_head_of(payload).size, _MAX_DATA)
    return payload[_HEAD.size : _HEAD.size + size]


def _entry(listed: bytes) -> FileEntry | None:
    """Return one entry of a listed folder; None if it is neither file nor folder."""
    kind = listed[:1]
    name, _, size = listed[1:].decode("utf-8", "replace").partition("\t")
    is_plain = name not in ("", ".", "..") and "/" not in name and name.isprintable()
    if kind not in (b"F", b"D") or not is_plain:
        return None
    size_bytes = 0
    if size.isdecimal():
        size_bytes = int(size)
    return FileEntry(name, size_bytes, is_folder=kind == b"D")


class LogData:
    """A client of LOG_DATA.

    Args:
        link: link to PX4.
    """

    def __init__(self, link: LogLink) -> None:
        self._link = link

    def entries(self) -> list[LogEntry]:
        """Return the logs that PX4 has; an empty list if it has none or does not answer."""
        entry_by_id: dict[int, LogEntry] = {}
        has_all = False

        for _ in range(_ATTEMPTS):
            first = 0
            self._link.send("log_request_list", first, _ALL_LOGS)
            while not has_all:
                message = self._link.next_message(("LOG_ENTRY",), _SILENT_S)
                if message is None or message.num_logs == 0:
                    break

                entry_by_id[message.id] = LogEntry(message.id, message.size, message.time_utc)
                has_all = len(entry_by_id) >= min(message.num_logs, _MAX_LOGS)
            if has_all:
                break
        return list(entry_by_id.values())

    def read(self, number: int, offset: int, size: int) -> Iterator[Piece]:
        """Yield pieces of a log until all requested bytes have come, or PX4 falls silent.

        Args:
            number: number of the log in the newest list.
            offset: offset of the first byte.
            size: number of bytes; at most _LOG_PART_BYTES of them are requested.
        """
        requested_bytes = min(size, _LOG_PART_BYTES)
        self._link.send("log_request_data", number, offset, requested_bytes)
        while True:
            message = self._link.next_message(("LOG_DATA",), _SILENT_S)
            if message is None:
                return
            if message.id != number:
                continue
            count = min(message.count, len(message.data))
            yield Piece(message.ofs, bytes(message.data[:count]))
            if count == 0 or message.ofs + count >= offset + requested_bytes:
                return

    def stop(self) -> None:
        """Ask PX4 to send no more of the log."""
        self._link.send("log_request_end")
