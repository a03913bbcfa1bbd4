"""A pytest plugin with one fixture: ``lockstep`` makes flights in simulated time for a test.

The flights end with the test. The test fails if a vehicle with full thrust has touched down too
fast. A test in which this is expected sets ``flight.may_land_hard = True`` beforehand.

Example::

    pytest_plugins = ["sitl.lockstep.testing"]

    def test_the_formation_keeps_its_distance(lockstep):
        flight = lockstep("configs/fleets/paper.toml", seed=3)
        assert flight.fly("configs/missions/paper.toml").passed
        assert flight.min_separation_m > 0.8
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from sitl.lockstep.flight import Lockstep


@pytest.fixture
def lockstep() -> Iterator[Callable[..., Lockstep]]:
    """Make a :class:`Lockstep` with its own arguments: fleet, seed, law, bus, mocap, folder."""
    # import here, so that the plugin does not slow tests that do not use the fixture
    from sitl.lockstep.flight import Lockstep

    flights: list[Lockstep] = []

    def make(*args: Any, **options: Any) -> Lockstep:
        flight = Lockstep(*args, **options)
        flights.append(flight)
        return flight

    yield make

    hard: list[str] = []
    for flight in flights:
        if not flight.may_land_hard:
            hard.extend(flight.hard_touchdowns)
        flight.close()
    assert not hard, f"{'. '.join(hard)}."
