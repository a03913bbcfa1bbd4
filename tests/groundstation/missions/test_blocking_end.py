"""A blocking script that is ended: while it waits for its vehicles, or while a coroutine flies.
Such a coroutine calls no blocking verbs.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import threading
from collections.abc import AsyncIterator, Coroutine
from typing import Any, NoReturn

import pytest

from groundstation.missions.api import Fleet
from groundstation.missions.blocking import BlockingFleet
from groundstation.missions.connection import RealTime, close_all, hosted
from onboard.config.fleet import ConfigError, FleetConfig


class EndedHost:
    """Runs the first call until it waits, and is then ended as by SIGTERM."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.calls = 0

    def call(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        self.calls += 1
        if self.calls > 1:
            return self.loop.run_until_complete(asyncio.wait_for(coroutine, 5.0))
        self.waiting = self.loop.create_task(coroutine)
        self.loop.run_until_complete(asyncio.sleep(0.01))
        raise SystemExit(143)

    def end_calls(self) -> None:
        self.waiting.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            self.loop.run_until_complete(self.waiting)
        self.loop.close()


def test_who_ends_it_while_it_waits_for_vehicles_sees_the_end_and_no_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    left: list[str] = []

    @contextlib.asynccontextmanager
    async def connect(*_: Any, **__: Any) -> AsyncIterator[None]:
        try:
            await asyncio.Event().wait()
            yield
        finally:
            left.append("the fleet")

    monkeypatch.setattr(Fleet, "connect", connect)
    host: Any = EndedHost()
    with hosted(host):
        with pytest.raises(SystemExit):
            BlockingFleet()
        close_all()
    assert left == ["the fleet"]
    assert host.loop.is_closed()


@pytest.mark.parametrize("end", [KeyboardInterrupt(), SystemExit(143)])
def test_the_end_of_a_script_waits_until_its_coroutine_is_cancelled(
    fleet: FleetConfig, end: BaseException
) -> None:
    host = RealTime(fleet)
    done: list[str] = []

    async def mission() -> None:
        main_thread = threading.main_thread().ident
        assert main_thread is not None
        signal.pthread_kill(main_thread, signal.SIGUSR1)
        try:
            await asyncio.sleep(60.0)
        finally:
            await asyncio.sleep(0.02)
            done.append("cancelled")

    async def finish() -> None:
        done.append("end")

    def raise_end(*_: object) -> NoReturn:
        raise end

    before = signal.signal(signal.SIGUSR1, raise_end)
    try:
        with pytest.raises(type(end)):
            host.call(mission())
        host.call(finish())
    finally:
        signal.signal(signal.SIGUSR1, before)
        host.end_calls()
    assert done == ["cancelled", "end"]


def test_a_coroutine_of_a_script_may_not_wait_for_its_own_thread(fleet: FleetConfig) -> None:
    host = RealTime(fleet)

    async def mission() -> None:
        host.call(asyncio.sleep(0.0))

    try:
        with pytest.raises(ConfigError, match="use the fleet that it gets, with await"):
            host.call(mission())
    finally:
        host.end_calls()


@pytest.mark.parametrize("is_in_task", [False, True])
def test_a_coroutine_that_calls_sys_exit_ends_the_script_and_its_end_can_land(
    fleet: FleetConfig, is_in_task: bool
) -> None:
    host = RealTime(fleet)
    done: list[str] = []

    async def leave() -> None:
        sys.exit(3)

    async def mission() -> None:
        await (asyncio.create_task(leave()) if is_in_task else leave())

    async def finish() -> None:
        done.append("end")

    def run() -> None:
        with pytest.raises(SystemExit, match="3"):
            host.call(mission())
        host.call(finish())

    script = threading.Thread(target=run, daemon=True)  # which would wait for ever
    script.start()
    script.join(5.0)
    host.end_calls()
    assert done == ["end"]


def test_a_call_of_another_thread_is_refused_when_the_calls_are_ended(fleet: FleetConfig) -> None:
    host = RealTime(fleet)
    waits = threading.Event()
    refusals: list[str] = []

    async def wait() -> None:
        waits.set()
        await asyncio.sleep(60.0)

    def run() -> None:
        with pytest.raises(ConfigError) as refusal:
            host.call(wait())
        refusals.append(str(refusal.value))

    script = threading.Thread(target=run, daemon=True)  # which would wait for ever
    script.start()
    assert waits.wait(5.0)
    host.end_calls()
    script.join(1.0)
    [sentence] = refusals
    assert sentence.startswith("The script's flight has ended during this call")
