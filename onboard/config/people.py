"""``[people]`` of a fleet file: persons with markers. The vehicles avoid them at every height."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping

import msgspec

from onboard.config.toml_reading import bound_problems

BOUNDS: dict[str, tuple[float, float]] = {
    "radius_m": (0.05, 5.0),
    "walk_m_s": (0.0, 3.0),
}
_LARGEST_M = 1e4  # largest coordinate of a walk


class Person(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[people.NAME]``: a person with a body in the motion capture."""

    mocap_body: str | None = None  # name of the body in the mocap; the person's own by default
    # radius of the circle around the body that contains arms and legs; vehicles keep the safety
    # distance from it
    radius_m: float = 0.4
    # where this person walks back and forth in covey sitl: [[east, north], ...]; by default nowhere
    walk_enu_m: tuple[tuple[float, float], ...] = ()
    walk_m_s: float = 1.0  # speed of that walk


def body_of(name: str, person: Person) -> str:
    """Return the name of a person's body in the motion capture."""
    if person.mocap_body:
        return person.mocap_body
    return name


def problems(
    people: Mapping[str, Person], vehicle_bodies: Mapping[str, str | None]
) -> Iterator[str]:
    """Check the persons of a fleet file. Their bodies are checked with those of the vehicles.

    Args:
        people: persons by name.
        vehicle_bodies: vehicle -> its body; None for a vehicle without a mocap.
    Yields:
        a sentence for each mistake.
    """
    if people and not any(vehicle_bodies.values()):
        yield (
            "'people' needs a motion capture, but every vehicle has mocap_required = false. Remove "
            "the table: vehicles without a mocap avoid nobody in it."
        )

    for name, person in people.items():
        key = f"people.{name}"
        yield from _name_problems(name, key, vehicle_bodies)

        for field, (low, high) in BOUNDS.items():
            yield from bound_problems(f"{key}.{field}", getattr(person, field), low, high)

        for point in person.walk_enu_m:
            if not all(abs(value) <= _LARGEST_M for value in point):  # also for NaN
                yield (
                    f"'{key}.walk_enu_m' has the point {list(point)}. Give metres, east and north."
                )


def _name_problems(name: str, key: str, vehicles: Collection[str]) -> Iterator[str]:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", name):
        yield f"'{key}': a name has 1 to 40 of the characters A-Z a-z 0-9 _ -. Rename the person."
    if name in vehicles:
        yield f"'{key}' has the name of a vehicle. Rename the person."
