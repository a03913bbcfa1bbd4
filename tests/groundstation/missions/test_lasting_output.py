"""Flights whose terminal or reader goes away: their lines are dropped, and they go on or land."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from groundstation.missions.lasting_output import end_signals, lasting_output


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


@pytest.mark.parametrize(
    ("handler", "is_caught"), [(signal.SIG_DFL, True), (signal.SIG_IGN, False)]
)
def test_a_flight_that_was_started_to_outlive_its_terminal_does_so(
    handler: signal.Handlers, is_caught: bool
) -> None:
    before = signal.signal(signal.SIGHUP, handler)
    try:
        assert (signal.SIGHUP in end_signals()) is is_caught
    finally:
        signal.signal(signal.SIGHUP, before)
