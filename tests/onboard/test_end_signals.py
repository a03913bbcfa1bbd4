"""Signals that ask a process to end in order: SIGTERM, and SIGHUP of a closed terminal."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from onboard.end_signals import end_signals

ROOT = Path(__file__).parents[2]
SENDERS = {"groundstation/processes/supervisor.py"}  # they send SIGTERM and do not handle it


@pytest.mark.parametrize(
    ("handler", "is_caught"), [(signal.SIG_DFL, True), (signal.SIG_IGN, False)]
)
def test_a_process_that_was_started_to_outlive_its_terminal_does_so(
    handler: signal.Handlers, is_caught: bool
) -> None:
    before = signal.signal(signal.SIGHUP, handler)
    try:
        assert (signal.SIGHUP in end_signals()) is is_caught
    finally:
        signal.signal(signal.SIGHUP, before)


def test_every_program_that_handles_sigterm_handles_the_sighup_of_a_closed_terminal() -> None:
    without_sighup = set()
    for package in ("groundstation", "onboard", "sitl"):
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if "signal.SIGTERM" in text and "signal.SIGHUP" not in text:
                without_sighup.add(path.relative_to(ROOT).as_posix())
    assert without_sighup == SENDERS
