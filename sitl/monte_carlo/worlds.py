"""The physics of a campaign, by name: Covey's emulator or a third-party library."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from onboard.arrays import Array, IntArray
from onboard.config.fleet import ConfigError
from sitl.monte_carlo.rotorpy_vehicles import RotorPyPhysics
from sitl.monte_carlo.vehicles import Physics, TrueMotions


class World(Protocol):
    """All vehicles of a batch of flights."""

    def truth(self) -> TrueMotions:
        """Return the true motion of the flights under way."""

    def advance(self, quaternion_wxyz: Array, thrust_frac: Array, normals: Array) -> None:
        """Fly one tick."""

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""


MakeWorld = Callable[..., World]  # called with the arguments of vehicles.Physics, by keyword

DEFAULT = "emulator"
WORLDS: dict[str, MakeWorld] = {DEFAULT: Physics, "rotorpy": RotorPyPhysics}


def world_of(name: str) -> MakeWorld:
    """Return what makes a world.

    Raises:
        ConfigError: there is no physics of that name.
    """
    if name not in WORLDS:
        raise ConfigError(
            f"--physics is '{name}', but there are only {', '.join(WORLDS)}. Name one of these."
        )
    return WORLDS[name]
