"""What may be written over, and what remains of a file that could not be written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from groundstation.recording.output_file import refuse_other_file, written_beside
from onboard.config.fleet import ConfigError


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
