"""What an agent opens at its start, and what may come while a computer boots."""

from __future__ import annotations

import asyncio
import datetime
import os
import shutil
from pathlib import Path

import pytest

from groundstation.keys.secured_fleet import secure_fleet
from onboard.agent import start_attempts
from onboard.agent.start_attempts import started
from onboard.autopilot import LinkError
from onboard.px4.mavsdk_link import Px4Link
from onboard.security.credentials import credentials_of

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
NOW = datetime.datetime.now(datetime.UTC)


async def test_a_serial_device_that_comes_late_is_opened_and_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(start_attempts, "_RETRY_S", 0.01)
    device = tmp_path / "tty"
    link = Px4Link(f"serial://{device}:921600", 1)
    attempts = 0

    def start() -> None:
        nonlocal attempts
        attempts += 1
        if attempts == 3:
            device.symlink_to(os.ttyname(terminal))
        link.start()

    autopilot, terminal = os.openpty()
    try:
        assert await started("mav0", start, asyncio.Event())
    finally:
        link.stop()
        os.close(terminal)
        os.close(autopilot)
    assert attempts == 3
    assert capsys.readouterr().err.count("cannot be opened") == 1


async def test_a_clock_that_is_set_late_makes_the_certificate_valid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(start_attempts, "_RETRY_S", 0.01)
    file = tmp_path / "fleet.toml"
    shutil.copy(PAPER, file)
    fleet = secure_fleet(str(file), NOW)
    clock = [datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC), NOW]

    assert await started(
        "mav0", lambda: credentials_of(fleet, "mav0", clock.pop(0)), asyncio.Event()
    )
    assert not clock
    assert "clock says 1970-01-01. Set the clock" in capsys.readouterr().err


async def test_what_only_another_fleet_file_mends_is_not_waited_for() -> None:
    link = Px4Link("udpin://127.0.0.1:70000", 1)
    with pytest.raises(LinkError, match="70000 is no port"):
        await started("mav0", link.start, asyncio.Event())


async def test_a_request_to_stop_ends_the_wait_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_attempts, "_RETRY_S", 3600.0)
    link = Px4Link("serial:///dev/covey-absent:921600", 1)
    stop_requested = asyncio.Event()
    asyncio.get_running_loop().call_later(0.05, stop_requested.set)
    async with asyncio.timeout(20.0):
        assert not await started("mav0", link.start, stop_requested)
