"""Flights whose terminal or reader goes away: their lines are dropped, and they go on or land."""

from __future__ import annotations

import asyncio
import os
import signal
import sys

import pytest

from groundstation.missions.lasting_output import cancelled_by_termination_signals, lasting_output


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


async def test_a_signal_cancels_every_task_that_is_connected_also_after_the_end_of_another() -> (
    None
):
    def handler(*_: object) -> None:
        """Stand for what the program does at the signal by itself."""

    async def connect(is_inside: bool) -> None:
        with cancelled_by_termination_signals():
            if is_inside:
                with cancelled_by_termination_signals():
                    await asyncio.sleep(0.0)
            await asyncio.sleep(60.0)

    before = signal.signal(signal.SIGTERM, handler)
    try:
        tasks = [asyncio.create_task(connect(is_inside)) for is_inside in (True, False)]
        with cancelled_by_termination_signals():
            await asyncio.sleep(0.02)
            signal.raise_signal(signal.SIGTERM)
            with pytest.raises(asyncio.CancelledError):
                await asyncio.sleep(1.0)
            ended = await asyncio.gather(*tasks, return_exceptions=True)
        assert [type(end) for end in ended] == [asyncio.CancelledError] * 2
        assert [task.cancelling() for task in tasks] == [1, 1]
        assert signal.getsignal(signal.SIGTERM) is handler
    finally:
        signal.signal(signal.SIGTERM, before)
