"""The console's benchmark measures what it says; its limits are told in words."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace

import pytest

from groundstation.cli import main
from onboard.bus.codec import decode, encode
from onboard.bus.schema import Telemetry
from tests.bench.console import _ESCAPES, Measured, Terminal, text
from tests.bench.console_memory import run
from tests.bench.telemetry_source import telemetry

GOOD = Measured(
    vehicles=10, cpu_pct=7.0, key_p50_ms=20.0, key_p99_ms=60.0, burst_key_max_ms=80.0, land_ms=12.0,
    land_in_preview_ms=30.0, land_worst_ms=41.0, bytes_per_s=9e4, rss_mib=80.0, growth_mib=0.4,
    load=0.2,
)  # fmt: skip


def test_what_a_terminal_shows_is_found_between_its_control_sequences() -> None:
    told = b"\x1b[?25l\x1b[1;38;2;99;189;240mqz\x1b[0;3mx\x1b[7m \x1b[0m\x1b]0;title\x07\x1b[H"
    assert _ESCAPES.sub(b"", told) == b"qzx "


def test_a_key_is_timed_until_what_it_changes_comes_out() -> None:
    echo = "import sys, tty, os, time; tty.setraw(0); os.write(1, b'up')\n"
    echo += "while (c := os.read(0, 9)) != b'q': "
    terminal = Terminal(
        [sys.executable, "-c", f"{echo}time.sleep(0.2); os.write(1, b'\\x1b[1m<' + c + b'>')"], {}
    )
    try:
        assert terminal.wait(b"up", 0.0, 20.0) is not None
        since_s = terminal.press(b"a")
        past_s = terminal.wait(b"<a>", since_s, 20.0)
        assert past_s is not None
        assert past_s >= 0.2
        assert terminal.wait(b"<b>", since_s, 0.05) is None
    finally:
        terminal.end()
    assert terminal.process.returncode is not None


def test_the_verdict_names_what_is_over_its_limit() -> None:
    assert all(is_met for _, is_met, _ in GOOD.verdict())
    bad = replace(GOOD, vehicles=100, cpu_pct=26.0, land_in_preview_ms=math.inf)
    missed = [name for name, is_met, _ in bad.verdict() if not is_met]
    assert len(missed) == 2
    assert "✖ processor" in text([bad])
    assert "26.0 (limit 25)" in text([bad])


def test_the_crowds_telemetry_is_what_the_bus_carries() -> None:
    told = telemetry("mav3", 3, (1.0, 2.0, 0.0), 7.5, 42)
    assert repr(decode(encode(told), Telemetry)) == repr(told)


async def test_the_console_in_fast_motion_does_not_grow() -> None:
    found = await run(3, 0.5)
    assert found["steps"] == 300
    assert found["growth_mib"] < 8.0
    json.dumps(found)


@pytest.mark.parametrize("words", [["--vehicles", "0"], ["--vehicles", "ten"], ["--seconds", "0"]])
def test_a_benchmark_that_makes_no_sense_is_refused_in_words(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "console", *words]) == 2
    assert capsys.readouterr().err.startswith("covey: ")
