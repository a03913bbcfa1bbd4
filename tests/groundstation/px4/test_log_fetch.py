"""``covey log fetch``: PX4's logs come whole, whatever ends in the middle; of disarmed vehicles."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import random
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from groundstation.cli import main
from groundstation.client.autopilot_link import AutopilotLink
from groundstation.px4 import agent_log_link, log_fetch, log_transfer
from groundstation.px4.fetch_progress import FetchProgress
from groundstation.px4.log_fetch import IncompleteError, VehicleLog, listed
from groundstation.px4.log_transfer import ArmedInBetween
from groundstation.px4.vehicle_links import VehicleLink
from onboard.bus.protocol import BusError
from onboard.config.fleet import FleetConfig, load_fleet
from sitl.mavlink.log_transfer import FileServer, LogSender
from sitl.px4.flight_log import FlightLogs, LogFile, LogWriter
from tests.groundstation.px4.test_px4 import FLEET, free_port

SENDER = (255, 190)


class CardLink:
    """The emulator's server of logs, without sockets and without waiting.

    Args:
        logs: on the card.
        loses: numbers of messages from PX4 that are lost.
        has_files: whether PX4 has file transfer at all.
    """

    def __init__(
        self,
        logs: FlightLogs,
        loses: Callable[[int], bool] = lambda number: False,
        *,
        has_files: bool = True,
        has_data: bool = True,
    ) -> None:
        self.files = FileServer(logs)
        self.sender = LogSender(logs)
        self.sent: list[str] = []
        self.armed_after = 10**9  # messages
        self._loses = loses
        self.files_until = 10**9 if has_files else 0  # messages
        self._has_data = has_data
        self._waiting: list[tuple[str, Any]] = []
        self._count = 0

    def send(self, name: str, *values: Any) -> None:
        self.sent.append(name)
        if name == "file_transfer_protocol" and self._count < self.files_until:
            answer = self.files.answer(values[1], SENDER, 0.0)
            if answer is not None:
                self._put("FILE_TRANSFER_PROTOCOL", payload=answer)
        elif name == "log_request_list" and self._has_data:
            for entry in self.sender.listed():
                self._put("LOG_ENTRY", **entry)
        elif name == "log_request_data" and self._has_data:
            self.sender.request(*values)

    def _put(self, name: str, **fields: Any) -> None:
        self._count += 1
        if self._count > self.armed_after:
            raise ArmedInBetween
        if not self._loses(self._count):
            self._waiting.append((name, SimpleNamespace(**fields)))

    def next_message(self, names: Iterable[str], timeout_s: float) -> Any | None:
        for payload, _ in self.files.due(0.0):
            if self._count < self.files_until:
                self._put("FILE_TRANSFER_PROTOCOL", payload=payload)
        for number, offset, data in self.sender.due():
            self._put("LOG_DATA", id=number, ofs=offset, count=len(data), data=list(data))
        while self._waiting:
            name, message = self._waiting.pop(0)
            if name in names:
                return message
        return None


def card(*sizes: int) -> FlightLogs:
    """Logs of several flights, of these sizes."""
    logs = FlightLogs()
    for number, size in enumerate(sizes):
        writer = LogWriter(1000 + number, {}, {})
        writer.content += bytes((number + at) % 251 for at in range(size))
        logs.files.append(
            LogFile(
                path=f"/fs/microsd/log/2026-11-2{number}/05_21_29.ulg",
                unix_s=1.79e9 + number,
                writer=writer,
            )
        )
    return logs


def fetched(link: CardLink, log: VehicleLog, target: Path) -> str:
    return log_fetch._fetched(link, log, target, "mav0", lambda *_: None)


def test_the_newest_logs_are_found_by_their_folders(tmp_path: Path) -> None:
    link = CardLink(card(100, 200, 300))
    found = listed(link, 2)
    assert [one.name for one in found] == ["2026-11-22_05_21_29", "2026-11-21_05_21_29"]
    said = fetched(link, found[0], tmp_path / "mav0.ulg")
    assert said.endswith("in 0 s, 0.00 MB by file transfer")
    assert (tmp_path / "mav0.ulg").read_bytes() == link.files._files[2].content
    assert list(tmp_path.iterdir()) == [tmp_path / "mav0.ulg"]


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3])
def test_lost_messages_are_asked_for_again(tmp_path: Path, share: float) -> None:
    logs = card(40_000)
    rng = random.Random(3)
    link = CardLink(logs, lambda number: rng.random() < share)
    (log,) = listed(link, 1)
    fetched(link, log, tmp_path / "a.ulg")
    assert (tmp_path / "a.ulg").read_bytes() == logs.files[0].content


def test_a_transfer_that_dies_is_opened_again_and_goes_on_where_it_was(tmp_path: Path) -> None:
    logs = card(50_000)
    logs.session_limit_bytes = 9_000
    link = CardLink(logs)
    (log,) = listed(link, 1)
    assert "by file transfer, opened 6 times" in fetched(link, log, tmp_path / "a.ulg")
    assert (tmp_path / "a.ulg").read_bytes() == logs.files[0].content
    assert "log_request_data" not in link.sent


def test_where_file_transfer_brings_nothing_more_log_data_brings_the_rest(tmp_path: Path) -> None:
    logs = card(10_000, 10_000, 30_000)
    link = CardLink(logs)
    log = listed(link, 2)[1]  # of two logs of the same size
    link.files_until = 20  # messages
    said = fetched(link, log, tmp_path / "a.ulg")
    assert "0.00 MB by file transfer; 0.01 MB by LOG_DATA" in said
    assert (tmp_path / "a.ulg").read_bytes() == logs.files[1].content


def test_a_px4_without_file_transfer_gives_its_logs_by_log_data(tmp_path: Path) -> None:
    logs = card(100, 70_000)
    link = CardLink(logs, lambda number: number % 5 == 0, has_files=False)
    (log,) = listed(link, 1)
    assert (log.name, log.path) == ("2026-09-21_14_13_21", "")
    assert "0.07 MB by LOG_DATA" in fetched(link, log, tmp_path / "a.ulg")
    assert (tmp_path / "a.ulg").read_bytes() == logs.files[1].content


def test_a_fetch_that_ended_early_goes_on_where_it_was(tmp_path: Path) -> None:
    logs = card(50_000)
    whole = bytes(logs.files[0].content)
    link = CardLink(logs)
    (log,) = listed(link, 1)
    link.armed_after = 100
    with pytest.raises(ArmedInBetween):
        fetched(link, log, tmp_path / "a.ulg")
    part = (tmp_path / "a.ulg.part").read_bytes()
    assert 10_000 < len(part) < len(whole)
    assert part == whole[: len(part)]
    assert not (tmp_path / "a.ulg").exists()
    said = fetched(CardLink(logs), log, tmp_path / "a.ulg")
    assert f"{len(part) / 1e6:.2f} MB were here; " in said
    assert (tmp_path / "a.ulg").read_bytes() == whole
    assert "is here already" in fetched(CardLink(logs), log, tmp_path / "a.ulg")


def test_the_part_of_another_flight_is_not_continued(tmp_path: Path) -> None:
    logs = card(5_000)
    (tmp_path / "a.ulg.part").write_bytes(card(0, 5_000).files[1].content[:3_000])
    link = CardLink(logs)
    said = fetched(link, listed(link, 1)[0], tmp_path / "a.ulg")
    assert "were here" not in said
    assert (tmp_path / "a.ulg").read_bytes() == logs.files[0].content


def test_a_part_is_kept_when_px4_is_silent_as_the_fetch_begins(tmp_path: Path) -> None:
    logs = card(50_000)
    (log,) = listed(CardLink(logs), 1)
    part = bytes(logs.files[0].content[:30_000])
    (tmp_path / "a.ulg.part").write_bytes(part)

    silent = CardLink(logs, has_files=False, has_data=False)
    with pytest.raises(IncompleteError, match="has 30000 of"):
        fetched(silent, log, tmp_path / "a.ulg")

    assert (tmp_path / "a.ulg.part").read_bytes() == part


def test_a_log_of_another_flight_with_the_same_name_is_kept(tmp_path: Path) -> None:
    # a PX4 that does not know the date begins again with sess001/log001 on a new card
    target = tmp_path / "mav0-sess001_log001.ulg"
    old = card(0, 3_000).files[1].content
    target.write_bytes(old)
    logs = card(5_000)
    link = CardLink(logs)
    (log,) = listed(link, 1)
    said = fetched(link, log, target)
    new_target = tmp_path / "mav0-sess001_log001-2.ulg"
    assert said.startswith(f"{new_target}: ")
    assert target.read_bytes() == old
    assert new_target.read_bytes() == logs.files[0].content
    assert fetched(link, log, target) == f"{new_target}: is here already"
    assert len(list(tmp_path.iterdir())) == 2


def test_a_log_that_has_grown_since_is_fetched_anew(tmp_path: Path) -> None:
    logs = card(5_000)
    link = CardLink(logs)
    (log,) = listed(link, 1)
    (tmp_path / "a.ulg").write_bytes(logs.files[0].content[:3_000])
    fetched(link, log, tmp_path / "a.ulg")
    assert (tmp_path / "a.ulg").read_bytes() == logs.files[0].content
    assert list(tmp_path.iterdir()) == [tmp_path / "a.ulg"]


def test_what_px4_does_not_give_out_is_said_and_kept_as_a_part(tmp_path: Path) -> None:
    logs = card(20_000)
    link = CardLink(logs, has_data=False)
    (log,) = listed(link, 1)
    logs.files[0].writer.content = logs.files[0].writer.content[:8_000]
    with pytest.raises(IncompleteError, match=r"has 8000 of 20\d+ bytes"):
        fetched(link, log, tmp_path / "a.ulg")
    assert (tmp_path / "a.ulg.part").stat().st_size == 8_000


def test_names_from_the_card_never_leave_the_folder() -> None:
    for listed_name in (b"F../../etc/passwd.ulg\t9", b"F..\t9", b"Fa\x1b[2J.ulg\t9", b"S", b"F\t9"):
        assert log_transfer._entry(listed_name) is None
    assert log_transfer._entry(b"Fa.ulg\tmany") == ("a.ulg", 0, False)


def test_progress_in_a_file_is_a_line_at_each_tenth() -> None:
    stream = io.StringIO()
    progress = FetchProgress(stream)
    for percent in range(0, 101, 2):
        progress.show("mav0", percent * 10_000, 1_000_000)
    progress.end()
    lines = stream.getvalue().splitlines()
    assert len(lines) == 11
    assert lines[5] == "mav0: 50 % of 1.00 MB"


# -- the command -----------------------------------------------------------------------------------


def fleet_file(folder: Path, **changes: str) -> FleetConfig:
    text = FLEET.format(agent=24_000, port=free_port(), direct=free_port())
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "fleet.toml").write_text(text, encoding="utf-8")
    return load_fleet(folder / "fleet.toml")


class ClosedBus:
    """A bus that cannot be opened."""

    def start(self) -> None:
        raise BusError("There is no network.")


def test_logs_behind_a_companions_serial_device_without_its_agent_are_refused_with_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(agent_log_link, "session", lambda *_: ClosedBus())
    fleet = fleet_file(tmp_path)
    text = (tmp_path / "fleet.toml").read_text(encoding="utf-8")
    vehicle = fleet.vehicles["solo"]
    assert vehicle.direct is not None
    text = text.replace(vehicle.autopilot, "serial:///dev/ttyAMA0:921600")
    text = text.replace(f'direct = "{vehicle.direct}"', "").replace("tcp/127.0.0.1", "tcp/10.9.9.9")
    (tmp_path / "fleet.toml").write_text(text, encoding="utf-8")
    assert main(["log", "fetch", str(tmp_path)]) == 10
    said = capsys.readouterr().out
    assert "Its PX4 is at /dev/ttyAMA0 of 10.9.9.9" in said
    assert "covey log fetch DIR --vehicles solo" in said


def test_a_folder_without_a_fleet_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "fetch", str(tmp_path)]) == 2
    assert "Give one with --fleet FILE" in capsys.readouterr().err


def test_a_full_disk_is_said_of_the_vehicle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(log_fetch, "_fetched", full)
    monkeypatch.setattr(log_fetch, "listed", lambda *_: [VehicleLog("a", 9)])
    fleet = fleet_file(tmp_path)
    link = VehicleLink(fleet.vehicles["solo"], link=SimpleNamespace())  # type: ignore[arg-type]
    (report,) = log_fetch.fetch([link], {}, tmp_path, newest=1, progress=lambda *_: None)
    assert not report.is_fine
    assert "No space left on device" in report.headline
    assert "Make room" in report.headline


@pytest.fixture
def emulated(tmp_path: Path) -> Iterator[FleetConfig]:
    fleet = fleet_file(tmp_path)
    command = [sys.executable, "-m", "sitl", "--fleet", fleet.path, "--no-bus"]
    command += ["--ftp-dies-after-kb", "9"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        yield fleet
        process.terminate()
        process.wait(5)


@pytest.mark.realtime
def test_the_log_of_a_flight_is_fetched_once_it_is_disarmed(
    emulated: FleetConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle = emulated.vehicles["solo"]
    assert vehicle.direct is not None
    link = AutopilotLink(vehicle.direct, vehicle.system_id)
    end_s = time.monotonic() + 12.0
    while not link.is_armed(2.0):
        assert time.monotonic() < end_s
        link.command(22, 0.0)
        link.command(400, 1.0)
    assert main(["log", "fetch", str(tmp_path)]) == 1
    assert "it is armed" in capsys.readouterr().out
    assert not (tmp_path / "px4").exists()
    link.command(21, 0.0)
    while link.is_armed(2.0):
        assert time.monotonic() < end_s + 30.0
    link.stop()
    assert main(["log", "fetch", str(tmp_path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["solo"]
    (path,) = (tmp_path / "px4").iterdir()
    assert path.name.startswith("solo-20")
    assert path.read_bytes().startswith(b"ULog")
    assert "opened" in said["rows"][0]


def fly_shortly(fleet: FleetConfig) -> None:
    """Arm and disarm the vehicle over its own link, so that its PX4 writes a log."""
    vehicle = fleet.vehicles["solo"]
    link = AutopilotLink(vehicle.autopilot, vehicle.system_id, is_own=True)
    end_s = time.monotonic() + 40.0
    while not link.is_armed(2.0):
        assert time.monotonic() < end_s
        link.command(400, 1.0)
    link.command(400, 0.0)
    while link.is_armed(2.0):
        assert time.monotonic() < end_s
        link.command(400, 0.0)
    link.stop()


def wait_for_listener(port: int) -> None:
    """Wait until somebody listens on a TCP port of this computer."""
    end_s = time.monotonic() + 40.0
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        assert time.monotonic() < end_s
        time.sleep(0.1)


@pytest.mark.long
def test_a_log_comes_through_the_agent_where_nothing_else_reaches_px4(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agent_port = free_port(socket.SOCK_STREAM)
    fleet = fleet_file(tmp_path, **{"tcp/127.0.0.1:24000": f"tcp/127.0.0.1:{agent_port}"})
    text = Path(fleet.path).read_text(encoding="utf-8")
    without_direct = "\n".join(
        line for line in text.splitlines() if not line.startswith("direct =")
    )
    emulator = [sys.executable, "-m", "sitl", "--fleet", fleet.path, "--no-bus"]
    agent = [sys.executable, "-m", "onboard", "--fleet", fleet.path, "--vehicle", "solo"]

    with subprocess.Popen(
        [*emulator, "--ftp-dies-after-kb", "9"], stdout=subprocess.PIPE, text=True
    ) as sitl_process:
        try:
            assert sitl_process.stdout is not None
            assert sitl_process.stdout.readline().startswith("ready")
            fly_shortly(fleet)
            Path(fleet.path).write_text(without_direct, encoding="utf-8")

            with subprocess.Popen(agent, stderr=subprocess.DEVNULL) as agent_process:
                try:
                    wait_for_listener(agent_port)  # by then the agent has taken PX4's link
                    assert main(["log", "fetch", str(tmp_path)]) == 0, capsys.readouterr().out
                finally:
                    agent_process.kill()
        finally:
            sitl_process.terminate()

    assert "through its agent" in capsys.readouterr().out
    (path,) = (tmp_path / "px4").iterdir()
    assert path.read_bytes().startswith(b"ULog")
