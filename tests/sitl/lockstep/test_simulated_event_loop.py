"""The event loop in simulated time, without a simulation of vehicles."""

from __future__ import annotations

import asyncio

from sitl.lockstep.simulated_event_loop import VirtualLoop

_STEP_NS = 4_000_000


class Clock:
    """A simulation that has only a clock."""

    def __init__(self) -> None:
        self.now_ns = 0

    def advance(self) -> None:
        self.now_ns += _STEP_NS


def test_time_goes_on_while_a_coroutine_polls_without_waiting() -> None:
    clock = Clock()
    loop = VirtualLoop(lambda: clock.now_ns, clock.advance)

    async def poll() -> int:
        is_over = asyncio.Event()
        loop.call_later(0.02, is_over.set)
        polls = 0
        while not is_over.is_set() and polls < 100_000:
            polls += 1
            await asyncio.sleep(0)
        return polls

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        assert 5000 <= runner.run(poll()) < 5100
    assert clock.now_ns == 5 * _STEP_NS


def test_a_coroutine_that_yields_some_hundred_times_takes_no_time() -> None:
    clock = Clock()
    loop = VirtualLoop(lambda: clock.now_ns, clock.advance)

    async def yield_often() -> None:
        for _ in range(900):
            await asyncio.sleep(0)

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(yield_often())
    assert clock.now_ns == 0
