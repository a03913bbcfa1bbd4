"""Waits of a ground whose computer is too busy to run it."""

from __future__ import annotations

import asyncio

import pytest

from groundstation.client.scheduled_wait import LONGEST_LATE_S, wait_scheduled
from sitl.lockstep.simulated_event_loop import VirtualLoop


class World:
    """Time, and a loop that stands still now and then."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.loop = VirtualLoop(lambda: self.now_ns, self.advance)
        self.stalls: dict[int, float] = {}  # at which time [ns] the loop stands still, for how long

    def advance(self) -> None:
        self.now_ns += 4_000_000
        stall_s = self.stalls.pop(self.now_ns, 0.0)
        if stall_s:
            self.loop.stand_still(stall_s)

    def wait(self, limit_s: float) -> tuple[float, float]:
        """Return how long a wait for nothing took, and how much of it was late."""
        with asyncio.Runner(loop_factory=lambda: self.loop) as runner:
            late_s = runner.run(wait_scheduled(asyncio.Event(), limit_s))
            return self.now_ns * 1e-9, late_s


def test_a_wait_of_a_ground_that_is_scheduled_takes_its_time() -> None:
    waited_s, late_s = World().wait(1.0)
    assert waited_s == pytest.approx(1.0, abs=0.01)
    assert late_s == 0.0


def test_what_a_ground_was_late_does_not_count() -> None:
    world = World()
    world.stalls = {200_000_000: 0.5, 900_000_000: 0.7}
    waited_s, late_s = world.wait(1.0)
    assert late_s == pytest.approx(1.2, abs=0.15)
    assert waited_s == pytest.approx(1.0 + late_s, abs=0.02)


def test_a_ground_that_is_always_late_stops_waiting_some_time() -> None:
    world = World()
    world.stalls = {n * 400_000_000: 0.39 for n in range(1, 60)}
    waited_s, late_s = world.wait(1.0)
    assert late_s < LONGEST_LATE_S + 1.0
    assert waited_s < 12.0
