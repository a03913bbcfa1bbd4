"""Flights whose terminal or reader goes away: their lines are dropped, and they go on or land."""

from __future__ import annotations

import os
import sys

import pytest

from groundstation.missions.lasting_output import lasting_output


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_lines_that_nobody_reads_any_more_are_dropped(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "w", encoding="utf-8") as stream:
        monkeypatch.setattr(sys, name, stream)
        with lasting_output():
            print("read", file=getattr(sys, name), flush=True)
            assert os.read(reader, 100) == b"read\n"
            os.close(reader)
            for _ in range(3):
                print("nobody reads this", file=getattr(sys, name), flush=True)
        assert getattr(sys, name) is stream
