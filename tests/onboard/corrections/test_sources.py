"""The sources of corrections on sockets, a pseudo-terminal and files of this computer."""

from __future__ import annotations

import asyncio
import base64
import os
import pty
import time
import tty
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing, asynccontextmanager
from pathlib import Path

import pytest

from onboard.config.config_error import ConfigError
from onboard.config.corrections import CorrectionsConfig
from onboard.config.fleet import Origin
from onboard.corrections.relay.ntrip import NtripRequest, read_ntrip
from onboard.corrections.relay.source_error import SourceError
from onboard.corrections.relay.sources import (
    frames_of_file,
    gga,
    password_of,
    play,
    read_serial,
    read_tcp,
)
from tests.onboard.corrections.rtcm_frames import epoch, recording

pytestmark = pytest.mark.realtime

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
STREAM = recording(3)
LATER = b"<later>"  # what follows it in a caster's answer is sent a moment later


@asynccontextmanager
async def serving(serve: Serve) -> AsyncIterator[str]:
    """A server on a free port of this computer."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await serve(reader, writer)
        except (ConnectionError, asyncio.CancelledError):
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(handle, "127.0.0.1", 0)
    try:
        yield f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()


class Caster:
    """Answers a request with bytes, and keeps what was asked."""

    def __init__(self, answer: bytes, *, hangs: bool = False) -> None:
        self.answer = answer
        self.hangs = hangs
        self.asked = b""
        self.told = b""  # behind the request
        self.is_told = asyncio.Event()

    async def __call__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.asked = await reader.readuntil(b"\r\n\r\n")
        for part in self.answer.split(LATER):
            writer.write(part)
            await writer.drain()
            await asyncio.sleep(0.05)
        if self.hangs:
            self.told = await reader.read(1000)
            self.is_told.set()
            await reader.read()


def request(address: str, *, user: str = "me", password: str = "secret", **more) -> NtripRequest:
    values = {"mountpoint": "NEAR", "tls": False, "position": None, **more}
    return NtripRequest(address=address, user=user, password=password, **values)


async def read(source: AsyncIterator[bytes], enough: int = 10**9) -> tuple[bytes, str]:
    """What a source sends, up to so many bytes, and the sentence of its end."""
    data = b""
    try:
        async with aclosing(source) as stream:  # type: ignore[type-var]
            async for more in stream:
                data += more
                if len(data) >= enough:
                    return data, ""
    except SourceError as error:
        return data, str(error)
    return data, ""


def chunked(data: bytes, size: int = 700) -> bytes:
    pieces = [data[begin : begin + size] for begin in range(0, len(data), size)]
    return b"".join(f"{len(piece):x}\r\n".encode() + piece + b"\r\n" for piece in pieces)


@pytest.mark.parametrize(
    "answer",
    [
        b"ICY 200 OK\r\n\r\n" + STREAM,
        b"ICY 200 OK\r\n" + STREAM,
        b"ICY 200 OK\r\n" + LATER + b"\r\n" + LATER + STREAM,
        b"ICY 200 OK\r\nServer: caster\r\nDate: today\r\n\r\n" + STREAM,
        b"ICY 200 OK\r\n" + LATER + b"Server: cas" + LATER + b"ter\r" + LATER + b"\n\r\n" + STREAM,
        b"ICY 200 OK\r\nServer: caster\r\n" + STREAM,
        b"HTTP/1.0 200 OK\r\nContent-Type: gnss/data\r\n\r\n" + STREAM,
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + chunked(STREAM),
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + chunked(STREAM, 1),
    ],
)
async def test_a_caster_of_either_version_is_read(answer):
    caster = Caster(answer, hangs=True)
    async with serving(caster) as address:
        data, _ = await read(read_ntrip(request(address)), enough=len(STREAM))

    assert data == STREAM
    assert caster.asked.startswith(b"GET /NEAR HTTP/1.1\r\n")
    assert b"Ntrip-Version: Ntrip/2.0\r\n" in caster.asked
    assert base64.b64encode(b"me:secret") in caster.asked


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", "wants another password"),
        (b"HTTP/1.0 401 Unauthorized\r\n\r\n", "wants another password"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "has no mountpoint NEAR"),
        (b"SOURCETABLE 200 OK\r\n\r\nSTR;OTHER;", "has no mountpoint NEAR"),
        (b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\nSTR;", "has no mountpoint"),
        (b"HTTP/1.1 503 Busy\r\n\r\n", "refuses NEAR with status 503"),
        (b"SSH-2.0-OpenSSH\r\n", "is no caster of NTRIP"),
        (b"HTTP/1.1 200 OK\r\n" + 500 * b"X-Junk: 123456789012\r\n", "its answer has no end"),
        (b"", "before it has said anything"),
        (b"HTTP/1.1 200 OK\r\n\r\n" + STREAM, "has ended the stream"),
        (
            b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nnonsense\r\n",
            "a chunk has no size",
        ),
        (
            b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nfffffff\r\n",
            "a chunk has no size",
        ),
    ],
)
async def test_a_caster_that_sends_no_stream_is_refused_in_a_sentence(answer, sentence):
    async with serving(Caster(answer)) as address:
        _, said = await read(read_ntrip(request(address)))
    assert sentence in said
    assert "secret" not in said


async def test_a_caster_that_wants_a_password_and_gets_none_says_so():
    caster = Caster(b"HTTP/1.1 401 Unauthorized\r\n\r\n")
    async with serving(caster) as address:
        _, said = await read(read_ntrip(request(address, user="", password="")))
    assert "wants a user and a password" in said
    assert b"Authorization" not in caster.asked


async def test_a_caster_that_hangs_before_its_answer_is_left():
    async with serving(Caster(b"", hangs=True)) as address:
        _, said = await read(read_ntrip(request(address), answer_s=0.1))
    assert "took the request and says nothing for 0.1 s" in said


async def test_a_caster_that_hangs_in_its_stream_is_left():
    async with serving(Caster(b"ICY 200 OK\r\n\r\n" + STREAM, hangs=True)) as address:
        data, said = await read(read_ntrip(request(address), silence_s=0.1))
    assert data == STREAM
    assert "sends nothing for 0.1 s" in said


async def test_a_caster_that_speaks_no_tls_is_refused_in_a_sentence():
    async with serving(Caster(b"ICY 200 OK\r\n\r\n", hangs=True)) as address:
        _, said = await read(read_ntrip(request(address, tls=True), answer_s=0.3))
    assert "cannot be reached" in said or "does not answer" in said


async def test_nobody_at_the_address_is_a_sentence():
    async with serving(Caster(b"")) as address:
        pass
    for source in (read_ntrip(request(address)), read_tcp(address)):
        _, said = await read(source)
        assert f"{address} cannot be reached" in said


@pytest.mark.parametrize("host", ["caster..example.org", f"{'x' * 64}.example.org"])
async def test_a_host_that_cannot_be_a_name_is_a_sentence(host: str):
    with pytest.raises(SourceError, match="cannot be reached"):
        await anext(read_tcp(f"{host}:2101"))

    _, said = await read(read_tcp(f"{host}:2101"))
    assert "cannot be reached" in said


async def test_a_caster_is_told_where_the_fleet_is():
    caster = Caster(b"ICY 200 OK\r\n\r\n" + STREAM, hangs=True)
    line = b"$GPGGA,here*00"
    async with serving(caster) as address:
        source = read_ntrip(request(address, position=lambda: line))
        reading = asyncio.create_task(read(source))
        async with asyncio.timeout(5.0):
            await caster.is_told.wait()
        reading.cancel()

    assert b"Ntrip-GGA: $GPGGA,here*00\r\n" in caster.asked
    assert caster.told == line + b"\r\n"


async def test_a_server_of_tcp_is_read_until_it_ends():
    async def serve(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(STREAM)
        await writer.drain()

    async with serving(serve) as address:
        data, said = await read(read_tcp(address))
    assert data == STREAM
    assert "has ended the stream" in said


async def test_a_server_of_tcp_that_hangs_is_left():
    async def serve(reader: asyncio.StreamReader, _writer: asyncio.StreamWriter) -> None:
        await reader.read()

    async with serving(serve) as address:
        _, said = await read(read_tcp(address, silence_s=0.1))
    assert "sends nothing for 0.1 s" in said


async def test_a_cable_is_read_and_its_end_is_told():
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    device = os.ttyname(theirs)
    source = read_serial(device, 115200, silence_s=5.0)
    reading = asyncio.create_task(read(source, enough=1000))
    await asyncio.sleep(0)
    os.write(ours, STREAM[:1000])
    data, _ = await reading
    assert data == STREAM[:1000]

    reading = asyncio.create_task(read(read_serial(device, 115200, silence_s=0.1)))
    _, said = await reading
    assert "sends nothing for 0.1 s" in said
    assert "Is corrections.baud right" in said
    os.close(ours)
    os.close(theirs)


async def test_a_device_that_is_none_is_a_sentence(tmp_path: Path):
    _, said = await read(read_serial(str(tmp_path / "ttyUSB9"), 115200))
    assert "cannot be opened" in said
    (tmp_path / "file").write_text("no device")
    _, said = await read(read_serial(str(tmp_path / "file"), 115200))
    assert "is no serial device" in said


async def test_a_recording_is_played_over_and_over_moment_by_moment(tmp_path: Path):
    path = tmp_path / "base.rtcm3"
    path.write_bytes(recording(2))
    frames = frames_of_file(str(path))

    played: list[bytes] = []
    async with aclosing(play(frames, epoch_s=0.0)) as stream:  # type: ignore[type-var]
        async for frame in stream:
            played.append(frame)
            if len(played) == 2 * len(frames):
                break
    assert played == 2 * frames
    assert frames[1:4] == epoch(0)


@pytest.mark.parametrize("content", [b"", b"no RTCM at all", epoch(0)[0][:-1]])
def test_a_recording_without_a_frame_is_refused(tmp_path: Path, content: bytes):
    path = tmp_path / "base.rtcm3"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="has no frame of RTCM 3"):
        frames_of_file(str(path))


def test_the_password_comes_from_a_private_file_or_the_environment(tmp_path: Path):
    fleet = str(tmp_path / "fleet.toml")
    table = CorrectionsConfig(source="ntrip", address="x:1", mountpoint="A", user="me")
    assert password_of(table, fleet, {"COVEY_NTRIP_PASSWORD": "env"}) == "env"
    assert password_of(table, fleet, {}) == ""

    named = CorrectionsConfig(
        source="ntrip", address="x:1", mountpoint="A", user="me", password_file="ntrip.txt"
    )
    with pytest.raises(ConfigError, match="there is no such file with a password"):
        password_of(named, fleet, {"COVEY_NTRIP_PASSWORD": "env"})

    secret = tmp_path / "ntrip.txt"
    secret.write_text("from the file\nsecond line\n")
    secret.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        password_of(named, fleet, {})
    secret.chmod(0o600)
    assert password_of(named, fleet, {}) == "from the file"
    secret.write_text("\n")
    with pytest.raises(ConfigError, match="has no password in its first line"):
        password_of(named, fleet, {})


@pytest.mark.parametrize(
    ("place", "line"),
    [
        (
            Origin(latitude_deg=47.285233, longitude_deg=8.565265, altitude_m=499.6),
            b"$GPGGA,092725.00,4717.11398,N,00833.91590,E,1,12,1.0,499.6,M,0.0,M,,*54",
        ),
        (
            Origin(latitude_deg=-0.5, longitude_deg=-179.999999999, altitude_m=0.0),
            b"$GPGGA,092725.00,0030.00000,S,18000.00000,W,1,12,1.0,0.0,M,0.0,M,,*55",
        ),
    ],
)
def test_a_place_is_written_as_nmea_has_it(place: Origin, line: bytes):
    now = time.struct_time((2026, 1, 1, 9, 27, 25, 0, 1, 0))
    said = gga(place, now)
    assert said[:-2] == line[:-2]
    checksum = 0
    for byte in said[1:-3]:
        checksum ^= byte
    assert said[-2:] == f"{checksum:02X}".encode()
