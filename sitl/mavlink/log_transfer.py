"""Transfer of the logs of a PX4: by file transfer (MAVLink FTP), and by LOG_DATA.

FTP gives access to files by messages. Each request has a sequence number, and its answer has the
next one. A burst is a request with many answers, each a piece of the file, until the file ends or
PX4 ends the burst. LOG_REQUEST_LIST and LOG_REQUEST_DATA are older: logs have numbers, and a
request has a number, an offset and a count of bytes. Both are read-only here.

Layout of a payload of FTP: sequence (2 bytes), session, operation, size, operation that is
answered, whether a burst is complete, padding, offset (4 bytes), data (up to 239 bytes).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from sitl.mavlink.codec import text_of
from sitl.px4.flight_log import FOLDER, FlightLogs, LogFile

PAYLOAD_BYTES = 251
_HEAD = struct.Struct("<HBBBBBxI")
_SIZE_BYTE = 4  # index of the size in a payload
_MAX_DATA = PAYLOAD_BYTES - _HEAD.size
LOG_DATA_BYTES = 90
# An answer with at most this much data is stored and sent again for a repeated request. A repeated
# request with a larger answer is carried out again.
_REPEATED_BYTES = 4
_PIECES_PER_POLL = 8
_BURST_PIECES = 60  # number of pieces after which a burst is complete
_IDLE_S = 10.0  # a session ends after this time without a request, as PX4's does

# Operations.
_TERMINATE = 1
_RESET = 2
_LIST = 3
_OPEN = 4
_READ = 5
_BURST = 15
_ACK = 128
_NAK = 129

# Errors.
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
    """A request is answered with an error."""

    def __init__(self, error: int) -> None:
        super().__init__(error)
        self.error = error


@dataclass(slots=True)
class _Burst:
    """The present burst of a file server."""

    sequence: int  # sequence number of the next piece
    offset: int  # offset of the next piece in the file
    pieces_left: int
    receiver: tuple[int, int]  # system and component


class FileServer:
    """The file transfer of one link.

    Args:
        logs: flight logs of the vehicle; None where flights are not logged.
    """

    def __init__(self, logs: FlightLogs | None) -> None:
        self._logs = logs
        self._file: LogFile | None = None  # file of the only session; None without a session
        self._sent_bytes = 0  # bytes that this session has sent
        self._used_s = 0.0  # time of the last request or piece
        self._burst: _Burst | None = None
        self._last_answer = b""

    def answer(self, payload: bytes, sender: tuple[int, int], now_s: float) -> bytes | None:
        """Return the answer to a payload.

        It is None for a payload that is itself an answer, and for the request of a burst, whose
        pieces :meth:`due` returns.

        Args:
            payload: payload of the request.
            sender: system and component of the sender.
            now_s: present time.
        """
        sequence, session, operation, size, _, _, offset = _HEAD.unpack_from(payload)
        if operation in (_ACK, _NAK):
            return None
        self._end_idle_session(now_s)
        self._used_s = now_s

        data = payload[_HEAD.size : _HEAD.size + min(size, _MAX_DATA)]
        request = _Request(
            sequence=sequence,
            session=session,
            operation=operation,
            size=size,
            offset=offset,
            data=data,
        )
        if self._last_answer[:2] == _answer_sequence(sequence):
            return self._last_answer  # the request is repeated, because its answer was lost

        try:
            answer_data = self._carry_out(request, sender)
        except _Refused as refused:
            answer = _packed(request, _NAK, bytes((refused.error,)))
        else:
            if answer_data is None:
                return None
            answer = _packed(request, _ACK, answer_data)

        is_small = answer[_SIZE_BYTE] <= _REPEATED_BYTES
        self._last_answer = b""
        if is_small:
            self._last_answer = answer
        return answer

    def due(self, now_s: float) -> list[tuple[bytes, tuple[int, int]]]:
        """Return the next pieces of a burst at the present time, each with its receiver."""
        pieces: list[tuple[bytes, tuple[int, int]]] = []
        if self._burst is not None:
            self._used_s = now_s
        while self._burst is not None and len(pieces) < _PIECES_PER_POLL:
            burst = self._burst
            content = b""
            if self._file is not None:
                content = bytes(self._file.content[burst.offset : burst.offset + _MAX_DATA])
            if self._reaches_limit(len(content)):
                break

            # An answer has the sequence number of its request plus one. A piece therefore answers a
            # request with the number before its own.
            burst.pieces_left -= 1
            is_complete = burst.pieces_left == 0
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

    def _carry_out(self, request: _Request, sender: tuple[int, int]) -> bytes | None:
        """Carry out a request; return the data of the answer, or None for a burst.

        Raises:
            _Refused: the answer is an error.
        """
        if request.operation == _RESET:
            self._close()
            return b""
        if request.operation == _TERMINATE:
            self._file_of(request)
            self._close()
            return b""

        if request.operation == _LIST:
            return self._list(request)
        if request.operation == _OPEN:
            return self._open(request)
        if request.operation == _READ:
            return self._read(request)
        if request.operation == _BURST:
            self._file_of(request)
            first = (request.sequence + 1) & 0xFFFF
            self._burst = _Burst(first, request.offset, _BURST_PIECES, sender)
            return None

        raise _Refused(_UNKNOWN_COMMAND)

    def _list(self, request: _Request) -> bytes:
        """Return the entries of a folder from an index on, as many as fit into an answer."""
        folder = text_of(request.data).rstrip("/")
        entries = self._entries(folder)
        is_known = folder == FOLDER or bool(entries)
        if self._logs is None or not is_known:
            raise _Refused(_NOT_FOUND)
        if request.offset >= len(entries):
            raise _Refused(_END_OF_FILE)

        listed = b""
        for entry in entries[request.offset :]:
            if len(listed) + len(entry) > _MAX_DATA:
                break
            listed += entry
        return listed

    def _entries(self, folder: str) -> list[bytes]:
        files = self._files
        if folder == FOLDER:
            dates = dict.fromkeys(PurePosixPath(file.path).parent.name for file in files)
            return [f"D{date}\0".encode("ascii") for date in dates]

        entries = []
        for file in files:
            file_folder, _, name = file.path.rpartition("/")
            if file_folder == folder:
                entries.append(f"F{name}\t{len(file.content)}\0".encode("ascii"))
        return entries

    def _open(self, request: _Request) -> bytes:
        if self._file is not None:
            raise _Refused(_NO_SESSION)
        path = text_of(request.data)
        for file in self._files:
            if file.path == path:
                self._file = file
                self._sent_bytes = 0
                return len(file.content).to_bytes(4, "little")
        raise _Refused(_NOT_FOUND)

    def _read(self, request: _Request) -> bytes:
        file = self._file_of(request)
        if request.offset >= len(file.content):
            raise _Refused(_END_OF_FILE)
        end = request.offset + min(request.size, _MAX_DATA)
        content = bytes(file.content[request.offset : end])
        if self._reaches_limit(len(content)):
            raise _Refused(_INVALID_SESSION)
        return content

    def _file_of(self, request: _Request) -> LogFile:
        """Return the open file of a request's session.

        Raises:
            _Refused: this session is not open.
        """
        if self._file is None or request.session != 0:
            raise _Refused(_INVALID_SESSION)
        return self._file

    def _end_idle_session(self, now_s: float) -> None:
        """End a session whose client has been silent, so that others can open one."""
        if self._file is not None and now_s - self._used_s > _IDLE_S:
            self._close()
            self._last_answer = b""

    def _reaches_limit(self, count: int) -> bool:
        """Add sent bytes to the session; at its limit, end it silently and return True."""
        self._sent_bytes += count
        limit_bytes = 0
        if self._logs is not None:
            limit_bytes = self._logs.session_limit_bytes
        if not limit_bytes or self._sent_bytes <= limit_bytes:
            return False
        self._close()
        return True

    def _close(self) -> None:
        self._file = None
        self._burst = None

    @property
    def _files(self) -> Sequence[LogFile]:
        if self._logs is None:
            return ()
        return self._logs.files


def _answer_sequence(sequence: int) -> bytes:
    """Return the first bytes of the answer to a request, which are its sequence number."""
    return ((sequence + 1) & 0xFFFF).to_bytes(2, "little")


def _packed(request: _Request, operation: int, data: bytes, *, is_complete: bool = False) -> bytes:
    """Return the payload of the answer to a request."""
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
        logs: flight logs of the vehicle; None where flights are not logged.
    """

    def __init__(self, logs: FlightLogs | None) -> None:
        self._logs = logs
        self._listed: list[LogFile] = []  # logs in the order of the newest list
        self._file: LogFile | None = None
        self._number = 0
        self._offset = 0
        self._end = 0

    def listed(self) -> list[dict[str, int]]:
        """Number the logs; return the fields of LOG_ENTRY for each."""
        self._listed = []
        if self._logs is not None:
            self._listed = list(self._logs.files)
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
        """Begin to send a part of a log; a request for an unknown log is ignored."""
        self._file = None
        if number < len(self._listed):
            self._file = self._listed[number]
            self._number = number
            self._offset = offset
            self._end = min(offset + count, len(self._file.content))

    def stop(self) -> None:
        """Stop sending, as requested by LOG_REQUEST_END."""
        self._file = None

    def due(self) -> list[tuple[int, int, bytes]]:
        """Return the next pieces: number of the log, offset, bytes."""
        pieces: list[tuple[int, int, bytes]] = []
        while self._file is not None and len(pieces) < _PIECES_PER_POLL:
            if self._offset >= self._end:
                self._file = None
                break
            # like PX4, whole pieces: the last one may reach beyond the count that was requested
            end = min(self._offset + LOG_DATA_BYTES, len(self._file.content))
            pieces.append(
                (self._number, self._offset, bytes(self._file.content[self._offset : end]))
            )
            self._offset = end
        return pieces
