"""What may be written over, and what remains of a file that could not be written."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.recording.output_file import refuse_other_file, write_together, written_beside
from onboard.config.fleet import ConfigError
from tests.groundstation.shows.made_shows import line_of, write_skyc


def _is_own(begin: bytes) -> bool:
    return begin.startswith(b"OWN")


@pytest.mark.parametrize("content", [None, b"", b"OWN 1"])
def test_a_new_an_empty_and_an_own_file_may_be_written(
    content: bytes | None, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    if content is not None:
        out.write_bytes(content)
    refuse_other_file(out, _is_own, other="is none of ours")


def test_a_file_of_somebody_else_is_refused_in_words(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.write_bytes(b"mine")
    with pytest.raises(ConfigError, match="there already and is none of ours, so it is not over"):
        refuse_other_file(out, _is_own, other="is none of ours")


def test_a_pipe_is_refused_because_it_would_be_replaced_by_a_file(tmp_path: Path) -> None:
    out = tmp_path / "pipe"
    os.mkfifo(out)
    with pytest.raises(ConfigError, match=r"a pipe.*Name a file with --csv\.$"):
        refuse_other_file(out, _is_own, other="is none of ours", option="--csv")


def _fail_in_the_middle(out: Path) -> None:
    with written_beside(out) as part:
        part.write_bytes(b"ne")
        raise OSError("full")


def test_a_file_is_replaced_when_the_new_one_is_whole_and_no_part_is_left(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.write_bytes(b"old")
    with pytest.raises(OSError, match="full"):
        _fail_in_the_middle(out)
    assert out.read_bytes() == b"old"
    with written_beside(out) as part:
        part.write_bytes(b"new")
        assert out.read_bytes() == b"old"
    assert out.read_bytes() == b"new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_folder_that_cannot_be_written_is_named_and_not_the_part(tmp_path: Path) -> None:
    folder = tmp_path / "removed"
    with pytest.raises(FileNotFoundError) as caught, written_beside(folder / "out") as part:
        part.write_text("new")
    assert caught.value.filename == str(folder)


def test_a_file_that_cannot_be_replaced_is_named_and_not_the_part(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(IsADirectoryError) as caught, written_beside(out) as part:
        part.write_text("new")
    assert caught.value.filename == str(out)
    assert list(tmp_path.iterdir()) == [out]


def test_a_symbolic_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    link = tmp_path / "out"
    link.symlink_to("elsewhere/file")
    for text in ("first", "second"):  # the file is new at first
        with written_beside(link) as part:
            part.write_text(text)
        assert link.is_symlink()
        assert (folder / "file").read_text() == text
    assert [path.name for path in folder.iterdir()] == ["file"]


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is full as soon as a mission is written."""
    write_bytes = Path.write_bytes

    def write(path: Path, data: bytes) -> int:
        if "mission" in path.name and ".part" in path.name:
            write_bytes(path, data[:10])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write_bytes(path, data)

    monkeypatch.setattr(Path, "write_bytes", write)


@pytest.mark.usefixtures("full_disk")
def test_files_that_are_written_together_are_all_written_or_none(tmp_path: Path) -> None:
    old = tmp_path / "old"
    old.write_bytes(b"old")
    contents = {old: b"new", tmp_path / "a" / "b" / "new": b"new"}

    with pytest.raises(OSError, match="No space left"):
        write_together({**contents, tmp_path / "a" / "mission": bytes(20)})
    assert list(tmp_path.iterdir()) == [old]
    assert old.read_bytes() == b"old"

    write_together(contents)
    assert all(path.read_bytes() == b"new" for path in contents)


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("command", ["init", "import"])
def test_a_full_disk_is_said_and_leaves_nothing_in_the_way(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    out = tmp_path / "out"
    words = ["init", str(out)]
    if command == "import":
        show = write_skyc(tmp_path / "show.skyc", line_of(2), 12.0)
        words = ["import", str(show), "--out", str(out)]

    assert main(words) == 2

    refusal = capsys.readouterr().err
    assert "nothing more can be written (No space left on device). Make room" in refusal
    assert not out.exists()
