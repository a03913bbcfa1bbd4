"""The sources of corrections: a cable, an NTRIP caster, a TCP server, or a recording.

Each source is an iterator of bytes as they arrive. It ends with a SourceError that says what
happened and what to do. To continue, the reader must reopen the source.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable, Mapping
from functools import partial
from typing import Literal

from msgspec.structs import replace

from onboard.config.config_error import ConfigError
from onboard.config.corrections import PASSWORD_VARIABLE, CorrectionsConfig, beside
from onboard.config.earth import Origin
from onboard.config.file_reading import PASSWORD_FILE, RTCM_FILE, read_bytes, read_text
from onboard.config.fleet_config import FleetConfig
from onboard.corrections import rtcm
from onboard.corrections.relay.framing import FrameCutter
from onboard.corrections.relay.ntrip import NtripRequest, read_ntrip
from onboard.corrections.relay.source_error import SourceError
from onboard.corrections.relay.tcp_connection import (
    ANSWER_S,
    READ_BYTES,
    SILENCE_S,
    connected,
    reason,
)
from onboard.security.private_files import refuse_open_to_others
from onboard.serial_device import open_serial

# An epoch is a moment at which a base measures. It sends the observations in several frames.
EPOCH_S = 1.0  # from one epoch of a recording to the next
_WITHOUT_EPOCH_FRAMES = 8  # frames per second of a recording without observations


def source_of(fleet: FleetConfig, environment: Mapping[str, str]) -> AsyncIterator[bytes]:
    """Return the bytes of a fleet's source, from now on.

    Args:
        fleet: fleet file with a table of corrections.
        environment: variables of this process, which may contain the password.

    Raises:
        ConfigError: the password or the recording cannot be read.
    """
    corrections = fleet.corrections
    assert corrections is not None
    match corrections.source:
        case "serial":
            return read_serial(corrections.address, corrections.baud)
        case "tcp":
            return read_tcp(corrections.address)
        case "ntrip":
            return read_ntrip(_request(fleet, corrections, environment))
        case "file":
            return play(frames_of_file(beside(fleet.path, corrections.address)))
        case "mock":
            return play_mock(fleet)


def with_source(fleet: FleetConfig, source: Literal["mock"]) -> FleetConfig:
    """Return the fleet with a source other than the one in its file.

    Args:
        fleet: fleet file with a table of corrections.
        source: source that replaces the file's.
    """
    assert fleet.corrections is not None
    corrections = replace(fleet.corrections, source=source)
    return replace(fleet, corrections=corrections)


def words_of(corrections: CorrectionsConfig) -> str:
    """Return the name of a source for a sentence.

    Args:
        corrections: table of the fleet file.
    """
    if corrections.source == "ntrip":
        return f"{corrections.mountpoint} of {corrections.address}"
    if corrections.source == "mock":
        return "a base that is made up"
    return corrections.address


def password_of(
    corrections: CorrectionsConfig, fleet_path: str, environment: Mapping[str, str]
) -> str:
    """Return the password for a caster; empty if there is none.

    Args:
        corrections: table of the fleet file.
        fleet_path: path of the fleet file.
        environment: variables of this process.

    Raises:
        ConfigError: the password's file is empty, cannot be read, or is readable by other users.
    """
    if not corrections.password_file:
        return environment.get(PASSWORD_VARIABLE, "")

    path = beside(fleet_path, corrections.password_file)
    text = read_text(path, PASSWORD_FILE)
    refuse_open_to_others(path)
    first_line, _, _ = text.partition("\n")
    password = first_line.strip()
    if not password:
        raise ConfigError(f"{path} has no password in its first line. Write it there.")
    return password


def _request(
    fleet: FleetConfig, corrections: CorrectionsConfig, environment: Mapping[str, str]
) -> NtripRequest:
    """Return the request to a caster that the fleet file describes."""
    position: Callable[[], bytes] | None = None
    origin = fleet.fleet.global_origin
    if corrections.sends_position and origin is not None:
        position = partial(_gga_now, origin)

    return NtripRequest(
        address=corrections.address,
        mountpoint=corrections.mountpoint,
        user=corrections.user,
        password=password_of(corrections, fleet.path, environment),
        tls=corrections.tls,
        position=position,
    )


def _gga_now(position: Origin) -> bytes:
    """Return a line of NMEA with the fleet's position, for the present time."""
    return gga(position, time.gmtime())


def gga(position: Origin, now: time.struct_time) -> bytes:
    """Return a line of NMEA (GGA) with the fleet's position.

    Args:
        position: position of the fleet on Earth.
        now: the time, UTC.
    """
    latitude = _degrees_and_minutes(position.latitude_deg, 2)
    longitude = _degrees_and_minutes(position.longitude_deg, 3)
    north_south = "N" if position.latitude_deg >= 0.0 else "S"
    east_west = "E" if position.longitude_deg >= 0.0 else "W"
    clock = time.strftime("%H%M%S.00", now)
    text = (
        f"GPGGA,{clock},{latitude},{north_south},{longitude},{east_west},1,12,1.0,"
        f"{position.altitude_m:.1f},M,0.0,M,,"
    )
    checksum = 0
    for byte in text.encode():
        checksum ^= byte
    return f"${text}*{checksum:02X}".encode()


def _degrees_and_minutes(value_deg: float, digits: int) -> str:
    """Return an angle as NMEA writes it: whole degrees, then minutes with five decimals."""
    hundred_thousandths = round(abs(value_deg) * 60 * 1e5)
    degrees, rest = divmod(hundred_thousandths, 60 * 100_000)
    return f"{degrees:0{digits}d}{rest / 1e5:08.5f}"


async def read_tcp(
    address: str, *, answer_s: float = ANSWER_S, silence_s: float = SILENCE_S
) -> AsyncIterator[bytes]:
    """Yield the bytes that a server sends.

    Args:
        address: HOST:PORT.
        answer_s: longest time to connect.
        silence_s: time without a byte after which the connection is closed.

    Raises:
        SourceError: the server cannot be reached, sends nothing, or ends the stream.
    """
    async with connected(address, answer_s=answer_s) as (reader, _):
        while True:
            try:
                async with asyncio.timeout(silence_s):
                    data = await reader.read(READ_BYTES)
            except TimeoutError:
                raise SourceError(f"{address} sends nothing for {silence_s:g} s.") from None
            except OSError as error:
                raise SourceError(f"The connection to {address} broke: {reason(error)}.") from None
            if not data:
                raise SourceError(f"{address} has ended the stream.")
            yield data


async def read_serial(
    device: str, baud: int, *, silence_s: float = SILENCE_S
) -> AsyncIterator[bytes]:
    """Yield the bytes that arrive over a cable.

    Args:
        device: path of the serial device.
        baud: rate of the line.
        silence_s: time without a byte after which the device is closed.

    Raises:
        SourceError: the device cannot be opened, sends nothing, or is unplugged.
    """
    try:
        descriptor = open_serial(f"serial://{device}:{baud}")
    except (OSError, ValueError) as error:
        raise SourceError(f"{device} cannot be opened: {error}.") from None

    loop = asyncio.get_running_loop()
    is_readable = asyncio.Event()
    loop.add_reader(descriptor, is_readable.set)
    try:
        while True:
            try:
                async with asyncio.timeout(silence_s):
                    await is_readable.wait()
            except TimeoutError:
                raise SourceError(
                    f"{device} sends nothing for {silence_s:g} s. Is corrections.baud right, and "
                    "does the receiver send RTCM 3 on this port?"
                ) from None
            is_readable.clear()
            try:
                data = os.read(descriptor, READ_BYTES)
            except BlockingIOError:
                continue
            except OSError as error:
                raise SourceError(f"{device} is gone: {error.strerror}.") from None
            if not data:
                raise SourceError(f"{device} is gone.")
            yield data
    finally:
        loop.remove_reader(descriptor)
        os.close(descriptor)


def frames_of_file(path: str) -> list[bytes]:
    """Return the frames of a recording.

    Args:
        path: path of the recording.

    Raises:
        ConfigError: the recording cannot be read, or contains no frame.
    """
    frames = FrameCutter().feed(read_bytes(path, RTCM_FILE))
    if not frames:
        raise ConfigError(
            f"{path} has no frame of RTCM 3. Give a recording of what a base sends, byte by byte."
        )
    return frames


async def play_mock(fleet: FleetConfig, *, epoch_s: float = EPOCH_S) -> AsyncIterator[bytes]:
    """Yield the bytes of a made-up base.

    Args:
        fleet: fleet file with the position of the base.
        epoch_s: time from one epoch to the next.
    """
    # imported here, because only trials need it
    from onboard.corrections.relay.mock_base import mock_base_of

    base = mock_base_of(fleet)
    second = 0
    while True:
        yield b"".join(base.frames(second))
        second += 1
        await asyncio.sleep(epoch_s)


async def play(frames: list[bytes], *, epoch_s: float = EPOCH_S) -> AsyncIterator[bytes]:
    """Yield the frames of a recording as a base would send them, over and over.

    Args:
        frames: one frame or more.
        epoch_s: time from one epoch to the next.
    """
    has_epochs = any(map(rtcm.ends_epoch, frames))
    while True:
        for number, frame in enumerate(frames, start=1):
            yield frame
            is_last_of_epoch = rtcm.ends_epoch(frame)
            if not has_epochs:
                is_last_of_epoch = number % _WITHOUT_EPOCH_FRAMES == 0 or number == len(frames)
            if is_last_of_epoch:
                await asyncio.sleep(epoch_s)
