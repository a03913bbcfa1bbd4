"""The physics of a campaign, by name: Covey's emulator or a third-party library."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from onboard.arrays import Array, IntArray
from onboard.config.fleet import ConfigError
from sitl.monte_carlo import rotorpy_vehicles, vehicles
from sitl.monte_carlo.campaign_settings import Setup
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
# keys of --set that have no effect in a physics
_UNUSED = {DEFAULT: vehicles.UNUSED, "rotorpy": rotorpy_vehicles.UNUSED}


def refuse_unused(name: str, setup: Setup) -> None:
    """Refuse settings with values that have no effect in a physics.

    An error that is set to 0 is accepted, because a physics without this error has none of it.

    Args:
        name: name of the physics.
        setup: the settings of the flights.

    Raises:
        ConfigError: a value of ``--set``, or of "set" of a scene, has no effect.
    """
    for key in setup.changed_keys:
        is_without_error = getattr(setup.perturbation, key, None) == 0.0
        if key not in _UNUSED.get(name, ()) or is_without_error:
            continue
        remedy = "Leave it out of --set, or of 'set' of the scene"
        if key not in _UNUSED[DEFAULT]:
            remedy += f", or fly with --physics {DEFAULT}"
        raise ConfigError(f"{key} is set, and it has no effect with --physics {name}. {remedy}.")


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
