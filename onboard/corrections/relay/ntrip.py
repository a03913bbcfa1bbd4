"""A small client for NTRIP, versions 1 and 2: one request, its answer, then a stream of bytes.

Version 2 is HTTP, with or without a chunked body. Version 1 answers "ICY 200 OK", sometimes without
a blank line after it, which no HTTP library can read. If a caster does not have the mountpoint, it
answers with the list of its mountpoints.

Connecting, answering and silence have time limits. An answer's head and a chunk have size limits.

The protocol: RTCM 10410.1.
"""

from __future__ import annotations

import asyncio
import base64
import ssl
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import NamedTuple

from onboard.corrections.relay.source_error import SourceError
from onboard.corrections.relay.tcp_connection import (
    ANSWER_S,
    READ_BYTES,
    SILENCE_S,
    connected,
    reason,
)

_MAX_HEAD_BYTES = 8192
_MAX_CHUNK_BYTES = 65_536
_POSITION_S = 10.0  # from one position sent to the caster to the next

_OK_OF_VERSION_1 = b"ICY 200"
_LIST_OF_VERSION_1 = b"SOURCETABLE 200"
_LIST_TYPE = "gnss/sourcetable"


class NtripRequest(NamedTuple):
    """One request to a caster."""

    address: str  # HOST:PORT
    mountpoint: str
    user: str
    password: str
    tls: bool
    # returns a line of NMEA with the fleet's position; None: no position is sent
    position: Callable[[], bytes] | None


class _Answer(NamedTuple):
    """Head of an answer."""

    status: int
    headers: dict[str, str]  # name in lower case -> value
    rest: bytes  # first bytes after the head, read together with it
    is_version_1: bool = False  # True: more lines of the head may follow in ``rest`` and later


async def read_ntrip(
    request: NtripRequest, *, answer_s: float = ANSWER_S, silence_s: float = SILENCE_S
) -> AsyncIterator[bytes]:
    """Yield the bytes that a caster sends for a mountpoint.

    Args:
        request: mountpoint, user and position.
        answer_s: longest time to connect, and then to answer.
        silence_s: longest time without a byte.

    Raises:
        SourceError: the caster cannot be reached, refuses, sends nothing, or ends the stream.
    """
    context: ssl.SSLContext | None = None
    if request.tls:
        context = ssl.create_default_context()
    async with connected(request.address, answer_s=answer_s, context=context) as (reader, writer):
        sending: asyncio.Task[None] | None = None
        try:
            writer.write(_head(request))
            try:
                async with asyncio.timeout(answer_s):
                    answer = await _read_answer(reader)
            except TimeoutError:
                raise SourceError(
                    f"{request.address} took the request and says nothing for {answer_s:g} s."
                ) from None
            _check_answer(request, answer)

            if request.position is not None:
                sending = asyncio.create_task(_send_positions(writer, request.position))
            body = _Body(reader, answer.rest, silence_s)
            is_chunked = answer.headers.get("transfer-encoding", "").lower() == "chunked"
            if answer.is_version_1:
                stream = body.without_lines()
            elif is_chunked:
                stream = body.chunks()
            else:
                stream = body.plain()
            async for data in stream:
                yield data
            raise SourceError(f"{request.address} has ended the stream.")
        except (OSError, asyncio.IncompleteReadError) as error:
            raise SourceError(
                f"The connection to {request.address} broke: {reason(error)}."
            ) from None
        finally:
            if sending is not None:
                sending.cancel()


def _head(request: NtripRequest) -> bytes:
    """Return the bytes of a request that casters of both versions understand."""
    lines = [
        f"GET /{request.mountpoint} HTTP/1.1",
        f"Host: {request.address}",
        "Ntrip-Version: Ntrip/2.0",
        "User-Agent: NTRIP covey",
        "Connection: close",
    ]
    if request.user:
        pair = f"{request.user}:{request.password}".encode()
        lines.append(f"Authorization: Basic {base64.b64encode(pair).decode()}")

    head = "\r\n".join(lines).encode() + b"\r\n"
    if request.position is not None:
        head += b"Ntrip-GGA: " + request.position() + b"\r\n"
    return head + b"\r\n"


async def _read_answer(reader: asyncio.StreamReader) -> _Answer:
    """Read the head of an answer.

    Raises:
        SourceError: the answer does not come from a caster, or is too long.
    """
    data = b""
    while b"\r\n" not in data:
        data = await _more(reader, data)
    first, _, rest = data.partition(b"\r\n")

    if first.startswith(_OK_OF_VERSION_1):
        return _Answer(status=200, headers={}, rest=rest, is_version_1=True)
    if first.startswith(_LIST_OF_VERSION_1):
        return _Answer(status=200, headers={"content-type": _LIST_TYPE}, rest=b"")

    version, _, after_version = first.decode("ascii", "replace").strip().partition(" ")
    status, _, _ = after_version.strip().partition(" ")
    is_http = version.startswith("HTTP/1.") and status.isdigit() and len(status) == 3
    if not is_http:
        raise SourceError("What answers is no caster of NTRIP: correct corrections.address.")

    while b"\r\n\r\n" not in data:
        data = await _more(reader, data)
    head, _, rest = data.partition(b"\r\n\r\n")
    headers: dict[str, str] = {}
    _, *header_lines = head.decode("ascii", "replace").split("\r\n")
    for line in header_lines:
        name, _, value = line.partition(":")
        headers[name.strip().lower()] = value.strip()
    return _Answer(status=int(status), headers=headers, rest=rest)


async def _more(reader: asyncio.StreamReader, data: bytes) -> bytes:
    """Read more of an answer's head; return ``data`` with the new bytes at its end."""
    more = await reader.read(READ_BYTES)
    if not more:
        raise SourceError("What answers ends the connection before it has said anything.")
    if len(data) + len(more) > _MAX_HEAD_BYTES:
        raise SourceError("What answers is no caster of NTRIP: its answer has no end.")
    return data + more


def _check_answer(request: NtripRequest, answer: _Answer) -> None:
    """Check that an answer starts a stream.

    Raises:
        SourceError: the caster refuses the request.
    """
    if answer.status == 401:
        password = "a user and a password"
        if request.user:
            password = "another password"
        raise SourceError(
            f"{request.address} wants {password} for {request.mountpoint} (401). Correct "
            "corrections.user, and the password in corrections.password_file or "
            "COVEY_NTRIP_PASSWORD.",
            is_refusal=True,
        )
    is_list = answer.headers.get("content-type", "").lower().startswith(_LIST_TYPE)
    if answer.status == 404 or is_list:
        raise SourceError(
            f"{request.address} has no mountpoint {request.mountpoint}. Correct "
            "corrections.mountpoint: the caster's list names those that it has.",
            is_refusal=True,
        )
    if answer.status != 200:
        raise SourceError(
            f"{request.address} refuses {request.mountpoint} with status {answer.status}.",
            is_refusal=True,
        )


class _Body:
    """The bytes after the head of an answer."""

    def __init__(self, reader: asyncio.StreamReader, first: bytes, silence_s: float) -> None:
        self._reader = reader
        self._buffer = first
        self._silence_s = silence_s

    async def plain(self) -> AsyncIterator[bytes]:
        """Yield the bytes of a body without chunks, as they arrive."""
        while True:
            if not self._buffer and not await self._fill():
                return
            data = self._buffer
            self._buffer = b""
            yield data

    async def without_lines(self) -> AsyncIterator[bytes]:
        """Yield the bytes of a body of version 1, without the rest of its head.

        Some casters send header lines, some a blank line, and some neither. These lines may come
        later than the status. An RTCM frame starts with a byte that no text contains.
        """
        while True:
            line, end, rest = self._buffer.partition(b"\r\n")
            if not line.rstrip(b"\r").isascii() or len(line) > _MAX_HEAD_BYTES:
                break  # a frame has begun
            if end:
                self._buffer = rest
                if not line:
                    break  # a blank line ends the head
                continue
            if not await self._fill():
                return

        async for data in self.plain():
            yield data

    async def chunks(self) -> AsyncIterator[bytes]:
        """Yield the bytes of a chunked HTTP/1.1 body. Each chunk starts with its size."""
        while True:
            line = await self._line()
            size_text, _, _ = line.partition(b";")
            try:
                size = int(size_text.strip(), 16)
            except ValueError:
                size = -1
            if not 0 <= size <= _MAX_CHUNK_BYTES:
                raise SourceError("The caster's stream is damaged: a chunk has no size.")
            if size == 0:
                return

            while len(self._buffer) < size + 2:  # a chunk and its line ending
                if not await self._fill():
                    return
            yield self._buffer[:size]
            self._buffer = self._buffer[size + 2 :]

    async def _line(self) -> bytes:
        """Read the next line, which holds the size of a chunk."""
        while b"\r\n" not in self._buffer:
            is_too_long = len(self._buffer) > READ_BYTES
            if not await self._fill() or is_too_long:
                raise SourceError("The caster's stream is damaged: a chunk has no size.")
        line, _, self._buffer = self._buffer.partition(b"\r\n")
        return line

    async def _fill(self) -> bool:
        """Read more into the buffer; return False at the end of the stream.

        Raises:
            SourceError: nothing arrives within ``silence_s``.
        """
        try:
            async with asyncio.timeout(self._silence_s):
                data = await self._reader.read(READ_BYTES)
        except TimeoutError:
            raise SourceError(f"The caster sends nothing for {self._silence_s:g} s.") from None
        self._buffer += data
        return data != b""


async def _send_positions(writer: asyncio.StreamWriter, position: Callable[[], bytes]) -> None:
    """Send the fleet's position to the caster at regular intervals."""
    while True:
        writer.write(position() + b"\r\n")
        with suppress(OSError):  # the reading task reports a broken connection
            await writer.drain()
        await asyncio.sleep(_POSITION_S)
