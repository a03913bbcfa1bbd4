"""The emulated PX4's own log: a ULog, given out by LOG_DATA and by file transfer."""

from __future__ import annotations

import io
import math
import struct

import numpy as np
import pytest
from pyulog import ULog

from sitl.emulator.emulator import Emulator
from sitl.mavlink.log_transfer import PAYLOAD_BYTES
from sitl.px4.flight_log import FOLDER
from sitl.px4.modes import Mode
from tests.sitl.sitl_flying import Client, emulator, run_for, until

TERMINATE, OPEN, READ, LIST, RESET, BURST, ACK, NAK = 1, 4, 5, 3, 2, 15, 128, 129
END_OF_FILE, INVALID_SESSION, NO_SESSION = 6, 4, 5
HEAD = struct.Struct("<HBBBBBxI")


@pytest.fixture(scope="module")
def flown() -> Emulator:
    """A vehicle that has taken off and landed, and lies disarmed."""
    emu = emulator()
    emu.keep_logs()
    run_for(emu, 5.0)
    px4 = emu.autopilots[0]
    px4.request_takeoff(emu.time_s, np.array([math.nan, math.nan, -2.5]))
    px4.request_arm(emu.time_s, True, 0.0)
    assert px4.is_armed
    run_for(emu, 6.0)
    px4.request(emu.time_s, Mode.LAND)
    until(emu, lambda: not px4.is_armed, 30.0)
    run_for(emu, 1.0)
    return emu


def content(emu: Emulator) -> bytes:
    assert emu.flight_logs is not None
    (file,) = emu.flight_logs[0].files
    return bytes(file.content)


def test_each_flight_is_a_ulog_of_what_px4_knew_from_arming_to_disarming(flown: Emulator) -> None:
    log = ULog(io.BytesIO(content(flown)))
    topics = {data.name: data.data for data in log.data_list}
    heights_m = -topics["vehicle_local_position"]["z"]
    assert heights_m[0] == pytest.approx(0.0, abs=0.3)
    assert heights_m.max() == pytest.approx(2.5, abs=0.4)
    quaternions = np.stack([topics["vehicle_attitude"][f"q[{part}]"] for part in range(4)])
    assert np.linalg.norm(quaternions, axis=0) == pytest.approx(1.0, abs=1e-5)
    assert topics["vehicle_status"]["arming_state"][0] == 2
    assert topics["vehicle_status"]["arming_state"][-1] == 1
    assert (np.diff(topics["vehicle_attitude"]["timestamp"].astype(float)) == 40_000).all()
    said = [text.message for text in log.logged_messages]
    assert any("Armed" in text for text in said)
    assert any("Disarmed" in text for text in said)
    assert log.initial_parameters["MAV_SYS_ID"] == 1
    assert log.msg_info_dict["sys_name"] == "PX4"


def test_a_vehicle_without_logs_says_that_there_are_none() -> None:
    client = Client(emulator())
    (entry,) = client.send("LOG_REQUEST_LIST", target_system=1, target_component=1, end=0xFFFF)
    assert (entry.name, entry.fields["num_logs"]) == ("LOG_ENTRY", 0)


def test_log_data_sends_the_part_that_is_asked_for(flown: Emulator) -> None:
    client = Client(flown)
    (entry,) = client.send("LOG_REQUEST_LIST", target_system=1, target_component=1, end=0xFFFF)
    whole = content(flown)
    assert entry.fields["size"] == len(whole)
    asked = {"target_system": 1, "target_component": 1, "id": entry.fields["id"]}
    client.send("LOG_REQUEST_DATA", **asked, ofs=1000, count=300)
    pieces = [one for one in client.collect(0.2) if one.name == "LOG_DATA"]
    assert [one.fields["ofs"] for one in pieces] == [1000, 1090, 1180, 1270]
    sent = b"".join(bytes(one.fields["data"])[: one.fields["count"]] for one in pieces)
    assert sent == whole[1000:1360]
    client.send("LOG_REQUEST_DATA", **asked, ofs=len(whole) - 10, count=300)
    (last,) = [one for one in client.collect(0.2) if one.name == "LOG_DATA"]
    assert last.fields["count"] == 10
    client.send("LOG_REQUEST_DATA", **asked, ofs=0, count=10**6)
    client.send("LOG_REQUEST_END", target_system=1, target_component=1)
    assert not [one for one in client.collect(0.2) if one.name == "LOG_DATA"]


class Ftp:
    """A client of the file transfer."""

    def __init__(self, emu: Emulator) -> None:
        self.client = Client(emu)
        self.sequence = 0

    def ask(
        self,
        operation: int,
        *,
        offset: int = 0,
        data: bytes = b"",
        size: int | None = None,
        session: int = 0,
        component: int = 1,
    ) -> tuple[int, bytes]:
        """Send a request; operation and data of its answer (0 when there is none at once)."""
        self.sequence += 1
        head = HEAD.pack(
            self.sequence, session, operation, len(data) if size is None else size, 0, 0, offset
        )
        payload = list((head + data).ljust(PAYLOAD_BYTES, b"\0"))
        answers = self.client.send(
            "FILE_TRANSFER_PROTOCOL", target_system=1, target_component=component, payload=payload
        )
        if not answers:
            return 0, b""
        answer = bytes(answers[0].fields["payload"])
        sequence, _, kind, count, answered, _, _ = HEAD.unpack_from(answer)
        assert (sequence, answered) == (self.sequence + 1, operation)
        return kind, answer[HEAD.size : HEAD.size + count]

    def burst(self, offset: int) -> tuple[bytes, int]:
        """Bytes of one burst, and the operation that it ends with."""
        self.ask(BURST, offset=offset)
        sent = b""
        kind = 0
        for message in self.client.collect(2.0):
            if message.name != "FILE_TRANSFER_PROTOCOL":
                continue
            payload = bytes(message.fields["payload"])
            _, _, kind, count, _, is_complete, at = HEAD.unpack_from(payload)
            if kind == ACK:
                assert at == offset + len(sent)
                sent += payload[HEAD.size : HEAD.size + count]
            if is_complete:
                break
        return sent, kind


def path_of(ftp: Ftp) -> bytes:
    _, dates = ftp.ask(LIST, data=FOLDER.encode())
    folder = f"{FOLDER}/{dates[1:-1].decode()}"
    _, files = ftp.ask(LIST, data=folder.encode())
    name, _, _ = files[1:-1].decode().partition("\t")
    return f"{folder}/{name}".encode()


def test_a_log_is_found_opened_and_read_by_file_transfer(flown: Emulator) -> None:
    ftp = Ftp(flown)
    whole = content(flown)
    kind, size = ftp.ask(OPEN, data=path_of(ftp))
    assert (kind, int.from_bytes(size, "little")) == (ACK, len(whole))
    assert ftp.ask(OPEN, data=path_of(ftp)) == (NAK, bytes((NO_SESSION,)))
    assert ftp.ask(READ, offset=500, size=100) == (ACK, whole[500:600])
    assert ftp.ask(READ, offset=len(whole), size=9) == (NAK, bytes((END_OF_FILE,)))
    first, _ = ftp.burst(0)
    assert 0 < len(first) < len(whole)
    assert first == whole[: len(first)]
    last, kind = ftp.burst(len(whole) - 1000)
    assert (last, kind) == (whole[-1000:], NAK)
    assert ftp.ask(RESET)[0] == ACK
    assert ftp.ask(READ, offset=0, size=9) == (NAK, bytes((INVALID_SESSION,)))


def test_a_file_transfer_may_die_in_the_middle_without_a_word(flown: Emulator) -> None:
    assert flown.flight_logs is not None
    flown.flight_logs[0].session_limit_bytes = 3000
    try:
        ftp = Ftp(flown)
        path = path_of(ftp)
        ftp.ask(OPEN, data=path)
        sent, kind = ftp.burst(0)
        assert (kind, 2700 < len(sent) <= 3000) == (ACK, True)
        assert ftp.ask(READ, offset=0, size=9) == (NAK, bytes((INVALID_SESSION,)))
        assert ftp.ask(OPEN, data=path)[0] == ACK  # and is begun anew
    finally:
        flown.flight_logs[0].session_limit_bytes = 0


def test_the_session_of_a_client_that_has_gone_is_open_to_another_after_ten_seconds(
    flown: Emulator,
) -> None:
    ftp = Ftp(flown)
    path = path_of(ftp)
    assert ftp.ask(OPEN, data=path)[0] == ACK
    ftp.client.collect(9.5)
    assert ftp.ask(OPEN, data=path) == (NAK, bytes((NO_SESSION,)))
    ftp.client.collect(10.5)
    assert ftp.ask(READ, offset=0, size=9) == (NAK, bytes((INVALID_SESSION,)))
    assert ftp.ask(OPEN, data=path)[0] == ACK


@pytest.mark.parametrize("operation", [TERMINATE, READ, BURST])
def test_a_session_that_is_not_open_is_neither_read_nor_ended(
    flown: Emulator, operation: int
) -> None:
    ftp = Ftp(flown)
    ftp.ask(OPEN, data=path_of(ftp))
    assert ftp.ask(operation, size=9, session=7) == (NAK, bytes((INVALID_SESSION,)))
    assert ftp.ask(READ, offset=0, size=9)[0] == ACK
    assert ftp.ask(TERMINATE)[0] == ACK
    assert ftp.ask(operation, size=9) == (NAK, bytes((INVALID_SESSION,)))


def test_a_file_request_for_another_component_is_not_answered(flown: Emulator) -> None:
    assert Ftp(flown).ask(RESET, component=100) == (0, b"")
    assert Ftp(flown).ask(RESET, component=0)[0] == ACK


@pytest.mark.parametrize("operation", [0, 6, 7, 8, 14, 77])
def test_whatever_would_write_is_refused(flown: Emulator, operation: int) -> None:
    assert Ftp(flown).ask(operation, data=b"/fs/microsd/log/x")[0] == NAK
