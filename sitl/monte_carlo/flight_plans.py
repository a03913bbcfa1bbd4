"""What a campaign flies: a scenario by its name, or a scene that was read from a file."""

from __future__ import annotations

from sitl.monte_carlo import scenarios
from sitl.monte_carlo.open_benchmark import scene_plans
from sitl.monte_carlo.open_benchmark.scene_file import Scene

Subject = str | Scene  # name of a scenario, or a scene


def plan(subject: Subject, seed: int, *, scale: float = 1.0) -> scenarios.FlightPlan:
    """Return the flight of a scenario or a scene, and a seed.

    Args:
        subject: scenario or scene.
        seed: the seed of all random numbers.
        scale: factor of all horizontal positions of a scenario; a scene is flown as it is.
    """
    if isinstance(subject, Scene):
        return scene_plans.plan(subject, seed)
    return scenarios.plan(subject, seed, scale=scale)


def name(subject: Subject) -> str:
    """Return the name of a scenario or a scene, which its flights bear."""
    if isinstance(subject, Scene):
        return subject.name
    return subject


def vehicle_count(subject: Subject) -> int:
    """Return the number of vehicles of a scenario or a scene."""
    if isinstance(subject, Scene):
        return scene_plans.vehicle_count(subject)
    return scenarios.vehicle_count(subject)


def is_stacked(subject: Subject) -> bool:
    """Return whether vehicles start at different heights; those of a scene do not."""
    return isinstance(subject, str) and scenarios.is_stacked(subject)
