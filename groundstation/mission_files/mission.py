"""A mission as it is loaded: its steps, its fleet, and the files that its steps name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path as FilePath

import msgspec

from groundstation.mission_files.expected_course import CourseStep, course, inner_steps
from groundstation.mission_files.steps import (
    BlockStep,
    FollowPathStep,
    MissionStep,
    OnFailure,
    ReactStep,
    Until,
    WaitStep,
)
from groundstation.paths.lights import TimedColour, load_lights
from groundstation.verdict.expectations import Expect
from onboard.config.fleet import FleetConfig
from onboard.config.formation_shape import FormationShape
from onboard.control.path import Path


class Mission(msgspec.Struct, frozen=True):
    """A mission file with its fleet and the files that its steps name.

    ``steps`` is empty for a Python mission, whose function is run instead.
    """

    path: str
    fleet: FleetConfig  # the fleet file, with the mission's own formations
    steps: tuple[MissionStep, ...]
    expect: Expect
    on_failure: OnFailure
    text: str  # content of the file
    is_python: bool = False
    arguments: Mapping[str, str] = {}  # arguments of a Python mission's function, as written
    paths: Mapping[str, Path] = {}  # file that a step names -> path
    shapes: Mapping[str, FormationShape] = {}  # the mission's own formations
    original_path: str = ""  # path of the file of which `path` is a copy

    def course(self) -> Iterator[CourseStep]:
        """Yield the steps as they are expected to be flown; a Python mission yields none."""
        return course(self.fleet, self.steps, self.paths_of, self.path)

    def conditions(self) -> Iterator[tuple[str, Until]]:
        """Yield the conditions of waits and reacts, each with its key in the file."""
        for index, step in enumerate(self.steps):
            yield from _conditions(step, f"step[{index}]")

    def paths_of(self, step: FollowPathStep) -> dict[str, Path]:
        """Return the path of each vehicle of a step."""
        return {vehicle: self.paths[file] for vehicle, file in step.paths.items()}

    def lights_of(self, step: FollowPathStep) -> dict[str, tuple[TimedColour, ...]]:
        """Return the colours of each vehicle for which a step names a file of colours."""
        folder = FilePath(self.path).parent
        return {vehicle: load_lights(folder / file) for vehicle, file in step.lights.items()}

    @property
    def name(self) -> str:
        """The name of the original file without its ending."""
        path = self.original_path
        if not path:
            path = self.path
        return FilePath(path).stem


def _conditions(step: MissionStep, key: str) -> Iterator[tuple[str, Until]]:
    """Yield the conditions of a step and of the steps inside it."""
    if isinstance(step, WaitStep) and step.until is not None:
        yield f"{key}.until", step.until
    if isinstance(step, ReactStep):
        yield f"{key}.when", step.when
    if isinstance(step, BlockStep):
        for inner in inner_steps(step, key):
            yield from _conditions(inner.step, inner.key)


def with_shapes(fleet: FleetConfig, shapes: Mapping[str, FormationShape]) -> FleetConfig:
    """Return the fleet with a mission's own formations as well.

    A formation of the mission counts instead of one of the same name in the fleet file. The hash of
    the file stays, because only the ground uses shapes.
    """
    return msgspec.structs.replace(fleet, shapes={**fleet.shapes, **shapes})
