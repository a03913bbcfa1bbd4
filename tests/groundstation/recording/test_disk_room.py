"""Room on the disk for the record of a long wait."""

from __future__ import annotations

import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from groundstation.recording.disk_room import room_warning

_Usage = namedtuple("_Usage", "total used free")


def test_a_wait_whose_record_does_not_fit_on_the_disk_is_warned_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: _Usage(10**12, 0, 20 * 10**9))
    assert room_warning(tmp_path, wait_s=6 * 3600.0, vehicles=3) == ""
    warning = room_warning(tmp_path, wait_s=6 * 3600.0, vehicles=50)
    assert "has 20000 MB free" in warning
    assert "about 37500 MB until the start" in warning
