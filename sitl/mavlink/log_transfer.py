"""How a PX4 gives out the logs of its flights: by file transfer (MAVLink FTP), and by LOG_DATA.

FTP is a small file system by messages. Each request bears a sequence number, and its answer the
next one. A burst is one request that is answered by many pieces, one after the other, until the
file ends or PX4 ends it. LOG_REQUEST_LIST and LOG_REQUEST_DATA are older: logs have numbers, and a
request names a log, an offset and a count of bytes. Both are read-only here.

Layout of a payload of FTP: sequence (2 bytes), session, operation, size, operation that is
answered, whether a burst is complete, padding, offset (4 bytes), data (up to 239 bytes).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from sitl.px4.flight_log import FOLDER, FlightLogs, LogFile

PAYLOAD_BYTES = 251
_HEAD = struct.Struct("<HBBBBBxI")
_MOST_DATA = PAYLOAD_BYTES - _HEAD.size
LOG_DATA_BYTES = 90
_KEPT_BYTES = 4  # of data; a larger answer is not kept, and its request is answered anew
_PIECES_PER_POLL = 8
_BURST_PIECES = 60  # of one burst; then it says that it is complete

# operations
_TERMINATE = 1
_RESET = 2
_LIST = 3
_OPEN = 4
_READ = 5
_BURST = 15
_ACK = 128
_NAK = 129

# errors
_FAIL = 1
_INVALID_SESSION = 4
_NO_SESSION = 5
_END_OF_FILE = 6
_UNKNOWN_COMMAND = 7
_NOT_FOUND = 10


@dataclass(frozen=True, slots=True)
class _Request:
    sequence: int
    session: int
    operation: int
    size: int
    offset: int
    data: bytes


class _Refused(Exception):
    def __init__(self, error: int) -> None:
        super().__init__(error)
        self.error = error


@dataclass(slots=True)
class _Burst:
    """A burst under way, and who gets it."""

    sequence: int  # of its next piece
    offset: int
    left: int  # pieces
    receiver: tuple[int, int]


class FileServer:
    """The file transfer of one link.

    Args:
        logs: flight logs of the vehicle; None where it keeps none.
    """

    def __init__(self, logs: FlightLogs | None) -> None:
        self._logs = logs
        self._file: LogFile | None = None  # of the only session
        self._sent = 0  # bytes of this session
        self._burst: _Burst | None = None
        self._last_answer = b""

    def answer(self, payload: bytes, sender: tuple[int, int]) -> bytes | None:
        """Return the payload that answers one; None when it has no answer, or a later one.

        Args:
            payload: payload of the request.
            sender: system and component.
        """
        sequence, session, operation, size, _, _, offset = _HEAD.unpack_from(payload)
        if operation in (_ACK, _NAK):
            return None
        data = payload[_HEAD.size : _HEAD.size + min(size, _MOST_DATA)]
        request = _Request(
            sequence=sequence,
            session=session,
            operation=operation,
            size=size,
            offset=offset,
            data=data,
        )
        if self._last_answer[:2] == _answer_sequence(sequence):
            return self._last_answer  # the same request again: its answer was lost

        try:
            answered = self._answered(request, sender)
        except _Refused as refused:
            answer = _packed(request, _NAK, bytes((refused.error,)))
        else:
            if answered is None:
                return None
            answer = _packed(request, _ACK, answered)

        is_small = answer[4] <= _KEPT_BYTES
        self._last_answer = answer if is_small else b""
        return answer

    def due(self) -> list[tuple[bytes, tuple[int, int]]]:
        """Return the next pieces of a burst, each with its receiver."""
        pieces: list[tuple[bytes, tuple[int, int]]] = []
        while self._burst is not None and len(pieces) < _PIECES_PER_POLL:
            burst = self._burst
            content = b""
            if self._file is not None:
                content = bytes(self._file.content[burst.offset : burst.offset + _MOST_DATA])
            if self._has_died(len(content)):
                break

            burst.left -= 1
            is_complete = burst.left == 0
            piece = _Request(
                sequence=burst.sequence - 1,
                session=0,
                operation=_BURST,
                size=0,
                offset=burst.offset,
                data=b"",
            )
            if content:
                payload = _packed(piece, _ACK, content, is_complete=is_complete)
            else:
                payload = _packed(piece, _NAK, bytes((_END_OF_FILE,)))
                is_complete = True
            pieces.append((payload, burst.receiver))

            burst.sequence = (burst.sequence + 1) & 0xFFFF
            burst.offset += len(content)
            if is_complete:
                self._burst = None
        return pieces

    def _answered(self, request: _Request, sender: tuple[int, int]) -> bytes | None:
        if request.operation in (_TERMINATE, _RESET):
            self._close()
            return b""

        if request.operation == _LIST:
            return self._listed(request)
        if request.operation == _OPEN:
            return self._opened(request)
        if request.operation == _READ:
            return self._read(request)
        if request.operation == _BURST:
            if self._file is None:
                raise _Refused(_INVALID_SESSION)
            first = (request.sequence + 1) & 0xFFFF
            self._burst = _Burst(first, request.offset, _BURST_PIECES, sender)
            return None

        raise _Refused(_UNKNOWN_COMMAND)

    def _listed(self, request: _Request) -> bytes:
        """Return entries of a folder from a number on, as many as fit."""
        folder = request.data.split(b"\0", 1)[0].decode("ascii", "replace").rstrip("/")
        entries = self._entries(folder)
        is_known = folder == FOLDER or bool(entries)
        if self._logs is None or not is_known:
            raise _Refused(_NOT_FOUND)
        if request.offset >= len(entries):
            raise _Refused(_END_OF_FILE)

        listed = b""
        for entry in entries[request.offset :]:
            if len(listed) + len(entry) > _MOST_DATA:
                break
            listed += entry
        return listed

    def _entries(self, folder: str) -> list[bytes]:
        files = self._files
        if folder == FOLDER:
            dates = dict.fromkeys(file.path.split("/")[-2] for file in files)
            return [f"D{date}\0".encode("ascii") for date in dates]
        return [
            f"F{file.path.rpartition('/')[2]}\t{len(file.content)}\0".encode("ascii")
            for file in files
            if file.path.rpartition("/")[0] == folder
        ]

    def _opened(self, request: _Request) -> bytes:
        if self._file is not None:
            raise _Refused(_NO_SESSION)
        path = request.data.split(b"\0", 1)[0].decode("ascii", "replace")
        for file in self._files:
            if file.path == path:
                self._file = file
                self._sent = 0
                return len(file.content).to_bytes(4, "little")
        raise _Refused(_NOT_FOUND)

    def _read(self, request: _Request) -> bytes:
        if self._file is None:
            raise _Refused(_INVALID_SESSION)
        if request.offset >= len(self._file.content):
            raise _Refused(_END_OF_FILE)
        end = request.offset + min(request.size, _MOST_DATA)
        content = bytes(self._file.content[request.offset : end])
        if self._has_died(len(content)):
            raise _Refused(_INVALID_SESSION)
        return content

    def _has_died(self, count: int) -> bool:
        """Count bytes of this session; end it without a word at its limit."""
        self._sent += count
        limit = 0 if self._logs is None else self._logs.session_limit_bytes
        if not limit or self._sent <= limit:
            return False
        self._close()
        return True

    def _close(self) -> None:
        self._file = None
        self._burst = None

    @property
    def _files(self) -> Sequence[LogFile]:
        return () if self._logs is None else self._logs.files


def _answer_sequence(sequence: int) -> bytes:
    """Return the first bytes of what answers a request."""
    return ((sequence + 1) & 0xFFFF).to_bytes(2, "little")


def _packed(request: _Request, operation: int, data: bytes, *, is_complete: bool = False) -> bytes:
    """Return the payload that answers a request."""
    head = _HEAD.pack(
        (request.sequence + 1) & 0xFFFF,
        request.session,
        operation,
        len(data),
        request.operation,
        is_complete,
        request.offset,
    )
    return (head + data).ljust(PAYLOAD_BYTES, b"\0")


class LogSender:
    """LOG_DATA of one link.

    Args:
        logs: flight logs of the vehicle; None where it keeps none.
    """

    def __init__(self, logs: FlightLogs | None) -> None:
        self._logs = logs
        self._listed: list[LogFile] = []  # as the newest list numbers them
        self._file: LogFile | None = None
        self._number = 0
        self._offset = 0
        self._end = 0

    def listed(self) -> list[dict[str, int]]:
        """Number the logs; return the fields of LOG_ENTRY for each."""
        self._listed = [] if self._logs is None else list(self._logs.files)
        last = max(0, len(self._listed) - 1)
        return [
            {
                "id": number,
                "num_logs": len(self._listed),
                "last_log_num": last,
                "time_utc": int(file.unix_s),
                "size": len(file.content),
            }
            for number, file in enumerate(self._listed)
        ]

    def request(self, number: int, offset: int, count: int) -> None:
        """Begin to send a part of a log; an unknown one is met with silence."""
        self._file = None
        if number < len(self._listed):
            self._file = self._listed[number]
            self._number = number
            self._offset = offset
            self._end = min(offset + count, len(self._file.content))

    def stop(self) -> None:
        """LOG_REQUEST_END."""
        self._file = None

    def due(self) -> list[tuple[int, int, bytes]]:
        """Return the next pieces: number of the log, offset, bytes."""
        pieces: list[tuple[int, int, bytes]] = []
        while self._file is not None and len(pieces) < _PIECES_PER_POLL:
            if self._offset >= self._end:
                self._file = None
                break
            end = min(self._offset + LOG_DATA_BYTES, len(self._file.content))
            pieces.append(
                (self._number, self._offset, bytes(self._file.content[self._offset : end]))
            )
            self._offset = end
        return pieces
