"""Records that end anywhere: cut at every byte, on a full disk, by SIGKILL, by a power cut."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.recording import timeline as timeline_module
from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RecordFiles, RecordWriter, write_json
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK, EXIT_WRONG_INPUT
from tests.groundstation.recorded import FLEET, messages, record

COMMANDS = (
    ("report",),
    ("log", "info"),
    ("replay", "--headless"),
    ("incident", "--quick"),
    ("plot",),
)
_EVERY = 97  # bytes between two cuts of the commands, which take longer


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flights") / "whole", 0.5, flush_s=0.2)


def cut(whole: Path, folder: Path, size: int) -> Path:
    """The same flight with so many bytes of its record."""
    folder.mkdir(exist_ok=True)
    shutil.copy(whole / "fleet.toml", folder)
    (folder / "flight.mcap").write_bytes((whole / "flight.mcap").read_bytes()[:size])
    return folder


class BadDisk(io.BytesIO):
    """A file with one byte that the disk cannot read any more."""

    def __init__(self, data: bytes, bad_byte: int) -> None:
        super().__init__(data)
        self._bad_byte = bad_byte

    def read(self, size: int | None = -1) -> bytes:
        begin = self.tell()
        data = super().read(size)
        if begin <= self._bad_byte < begin + len(data):
            raise OSError(errno.EIO, "Input/output error")
        return data


def test_a_byte_that_the_disk_cannot_read_costs_a_piece_of_the_record_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = record(tmp_path / "flight", 10.0)
    data = (flown / "flight.mcap").read_bytes()
    with contextlib.closing(Timeline(flown)) as timeline:
        length_s = timeline.length_s
        middle = timeline._chunks[timeline.chunk_count // 2]

    in_content = middle.offset + middle.size // 2
    in_index = middle.offset + middle.size + 40
    for bad_byte in (in_content, in_index):
        disk = BadDisk(data, bad_byte)
        monkeypatch.setattr(timeline_module, "opened", lambda path, kind, disk=disk: disk)
        with contextlib.closing(Timeline(flown)) as timeline:
            reading = timeline.read(-1, frozenset(("telemetry",)))
            names = {recorded.name for recorded in reading.until(1 << 62)}
            assert names == {"mav0", "mav1", "mav2"}
            assert timeline.length_s <= length_s
            assert timeline.events
            assert timeline.broken


def opened(folder: Path) -> int:
    """Open a record in every way; returns how many messages it has, -1 when it is refused."""
    try:
        timeline = Timeline(folder)
    except ConfigError:
        return -1
    with contextlib.closing(timeline):
        count = timeline.count_messages()
        assert count == len(list(timeline.samples(timeline.topics)))
        reading = timeline.read(-1, timeline.topics)
        assert sum(1 for _ in reading.until(1 << 62)) == count
    return count


@pytest.mark.parametrize(
    "step",
    [
        pytest.param(101, id="some"),
        pytest.param(1, id="all", marks=(pytest.mark.long, pytest.mark.timeout(1500))),
    ],
)
def test_a_record_that_is_cut_at_any_byte_opens_in_part_or_is_refused(
    whole: Path, tmp_path: Path, step: int
) -> None:
    size = (whole / "flight.mcap").stat().st_size
    folder = cut(whole, tmp_path / "cut", size)
    counts = []
    for end in range(size, -1, -step):
        os.truncate(folder / "flight.mcap", end)
        counts.append(opened(folder))
    assert counts == sorted(counts, reverse=True), "a shorter piece has more messages"
    assert counts[0] > 0
    assert opened(cut(whole, folder, 0)) == -1


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_opens_a_cut_record_in_part_or_refuses_it_in_a_sentence(
    whole: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    command: tuple[str, ...],
) -> None:
    path = whole / "flight.mcap"
    size = path.stat().st_size
    ends = sorted({*range(0, size, _EVERY), size - 1, size})
    for end in ends:
        folder = cut(whole, tmp_path / "cut", end)
        status = main([command[0], *command[1:], str(folder)])
        shown = capsys.readouterr()
        assert status in (EXIT_OK, EXIT_WRONG_INPUT), (end, shown)
        assert "Traceback" not in shown.err, (end, shown.err)
        if status == EXIT_WRONG_INPUT:
            assert str(folder) in shown.err, (end, shown.err)


@pytest.mark.parametrize("size", [20, 200, 1000])
def test_nothing_is_promised_of_a_record_that_is_cut_before_its_first_whole_piece(
    whole: Path, tmp_path: Path, size: int
) -> None:
    with pytest.raises(ConfigError) as refused:
        Timeline(cut(whole, tmp_path / "cut", size))
    assert str(refused.value).endswith(
        "nothing of a flight can be read. The record was cut off in the middle of a piece."
    )


def test_a_zip_of_a_flight_is_refused_with_the_advice_to_unpack_it(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    packed = shutil.make_archive(str(tmp_path / "flight"), "zip", whole)
    assert main(["log", "info", packed]) == EXIT_WRONG_INPUT
    assert f"{packed}: this is a ZIP file. Unpack it, and give" in capsys.readouterr().err


class SmallDisk(io.FileIO):
    """A file on a disk that has room for some bytes."""

    def __init__(self, path: Path, room: int) -> None:
        super().__init__(path, "wb")
        self._room = room

    def write(self, data: bytes) -> int:  # type: ignore[override]
        taken = min(len(data), self._room)
        self._room -= taken
        super().write(data[:taken])
        if taken < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return taken


def test_a_full_disk_leaves_all_that_came_to_it_before(whole: Path, tmp_path: Path) -> None:
    size = (whole / "flight.mcap").stat().st_size
    for room in range(size // 10, size, size // 10):
        folder = tmp_path / str(room)
        folder.mkdir()
        shutil.copy(FLEET, folder / "fleet.toml")
        synced = 0
        with contextlib.suppress(OSError):
            files = RecordFiles(
                folder, SmallDisk(folder / "flight.mcap", room), begin_ns=0, begin="a test"
            )
            for at_ns, topic, name, message in messages(2.0, {}):
                files.write(topic, name, message, at_ns)
                if files.written % 7 == 0:
                    files.flush()
                    synced = files.written
            pytest.fail("the disk was not full")
        assert max(0, opened(folder)) >= synced


_RECORDING = """
import sys, time
from pathlib import Path
from groundstation.recording.writer import RecordWriter
from tests.groundstation.recorded import messages

writer = RecordWriter(Path(sys.argv[1]))
writer.start()
for at_ns, topic, name, message in messages(600.0, {}):
    writer.put(topic, name, message, at_ns)
    time.sleep(0.001)
    print(writer.written, flush=True)
"""


@pytest.mark.realtime
def test_what_was_on_the_disk_is_whole_after_a_kill(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    with subprocess.Popen(
        [sys.executable, "-c", _RECORDING, str(folder)], stdout=subprocess.PIPE, text=True
    ) as recording:
        assert recording.stdout is not None
        written = 0
        while written < 1000:
            written = int(recording.stdout.readline())
        recording.send_signal(signal.SIGKILL)
        recording.wait()
    assert opened(folder) >= written


def test_names_of_new_files_reach_the_disk_as_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []

    def note(descriptor: int) -> None:
        synced.append(os.readlink(f"/proc/self/fd/{descriptor}"))

    monkeypatch.setattr("os.fsync", note)
    writer = RecordWriter(tmp_path)
    writer.start()
    writer.stop()
    assert synced == [str(tmp_path)]

    assert write_json(tmp_path / "verdict.json", {"passed": True}) is None
    assert synced[1:] == [str(tmp_path / "verdict.part"), str(tmp_path)]
