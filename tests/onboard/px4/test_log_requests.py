"""Which requests for PX4's own logs an agent passes on: those that only read logs."""

from __future__ import annotations

import struct

import pytest

from onboard.autopilot import AUTOPILOT_COMPONENT
from onboard.px4.log_requests import is_allowed
from onboard.px4.packets import Packet, cut, packed

SYSTEM_ID = 3
GROUND = (255, 190)

# operations of file transfer
LIST, OPEN_TO_READ, READ, CREATE, WRITE, REMOVE, MAKE_FOLDER, OPEN_TO_WRITE = (
    3,
    4,
    5,
    6,
    7,
    8,
    9,
    11,
)
TRUNCATE, RENAME, CHECKSUM, BURST = 12, 13, 14, 15
TERMINATE, RESET, REMOVE_FOLDER = 1, 2, 10


def packet_of(number: int, payload: bytes) -> Packet:
    (packet,) = cut(packed(number, payload, 0, *GROUND))
    assert isinstance(packet, Packet)
    return packet


def file_transfer(
    operation: int, path: str = "", *, system_id: int = SYSTEM_ID, component_id: int = 1
) -> Packet:
    data = path.encode()
    head = struct.pack("<HBBBBBxI", 7, 0, operation, len(data), 0, 0, 0)
    ids = bytes((0, system_id, component_id))
    return packet_of(110, ids + head + data)


def allowed(packet: Packet) -> bool:
    return is_allowed(packet, SYSTEM_ID)


@pytest.mark.parametrize("operation", [TERMINATE, RESET, READ, BURST])
def test_what_reads_or_closes_the_open_log_is_passed_on(operation: int) -> None:
    assert allowed(file_transfer(operation))


@pytest.mark.parametrize("path", ["/log", "/log/2026-11-26", "/fs/microsd/log", "/log/sess001/"])
def test_folders_of_logs_are_listed(path: str) -> None:
    assert allowed(file_transfer(LIST, path))


@pytest.mark.parametrize(
    "path", ["/", "", "/fs/microsd", "/logs", "/log/../etc", "/etc", "log", "/fs/mtd_params"]
)
def test_other_folders_are_not_listed(path: str) -> None:
    assert not allowed(file_transfer(LIST, path))


@pytest.mark.parametrize(
    ("path", "is_log"),
    [
        ("/log/2026-11-26/05_21_29.ulg", True),
        ("/fs/microsd/log/sess001/log002.ulg", True),
        ("/fs/microsd/params", False),
        ("/log/notes.txt", False),
        ("/log/../params.ulg", False),
        ("/params.ulg", False),
    ],
)
def test_a_log_is_opened_and_no_other_file(path: str, is_log: bool) -> None:
    assert allowed(file_transfer(OPEN_TO_READ, path)) is is_log


@pytest.mark.parametrize(
    "operation",
    [CREATE, WRITE, REMOVE, MAKE_FOLDER, REMOVE_FOLDER, OPEN_TO_WRITE, TRUNCATE, RENAME, CHECKSUM],
)
def test_nothing_is_written_or_deleted(operation: int) -> None:
    assert not allowed(file_transfer(operation, "/log/2026-11-26/05_21_29.ulg"))


def test_requests_for_another_vehicle_or_component_are_not_passed_on() -> None:
    assert not allowed(file_transfer(READ, system_id=SYSTEM_ID + 1))
    assert not allowed(file_transfer(READ, component_id=AUTOPILOT_COMPONENT + 1))


@pytest.mark.parametrize(
    ("number", "before_ids"), [(117, b"\0\0\xff\xff"), (119, bytes(10)), (122, b"")]
)
def test_the_requests_of_log_data_are_passed_on_to_the_own_autopilot(
    number: int, before_ids: bytes
) -> None:
    assert allowed(packet_of(number, before_ids + bytes((SYSTEM_ID, AUTOPILOT_COMPONENT))))
    assert not allowed(packet_of(number, before_ids + bytes((SYSTEM_ID + 1, 1))))


@pytest.mark.parametrize("number", [0, 20, 23, 48, 76, 82])
def test_no_other_message_is_passed_on(number: int) -> None:
    """Among them COMMAND_LONG and PARAM_SET."""
    assert not allowed(packet_of(number, bytes((SYSTEM_ID, AUTOPILOT_COMPONENT)) * 8))


def test_a_packet_with_a_wrong_checksum_is_not_passed_on() -> None:
    packet = file_transfer(READ)
    broken = packet._replace(data=packet.data[:-1] + bytes((packet.data[-1] ^ 1,)))
    assert not allowed(broken)
