"""A pytest plugin with one fixture: ``lockstep`` makes flights in simulated time for a test.

The flights end with the test.

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
    # here, so that the plugin costs nothing where it is not used
    from sitl.lockstep.flight import Lockstep

    flights: list[Lockstep] = []

    def make(*args: Any, **options: Any) -> Lockstep:
        flight = Lockstep(*args, **options)
        flights.append(flight)
        return flight

    yield make

    for flight in flights:
        flight.close()
