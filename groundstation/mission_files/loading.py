"""Mission files: TOML steps with schema 1, checked whole before anything starts. Unknown keys are
errors.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any, cast

import msgspec

from groundstation.mission_files.expected_course import Stage, course
from groundstation.mission_files.python_file import read_python
from groundstation.mission_files.steps import (
    BLOCK_KEYS,
    STEP_BOUNDS,
    STEPS,
    ArmStep,
    DisarmStep,
    ExpectStep,
    FaultStep,
    FlyFormationStep,
    FollowPathStep,
    GoalStep,
    HoldStep,
    HomeStep,
    MissionStep,
    OnFailure,
    ReactStep,
    RotateStep,
    TakeoffStep,
    Until,
    WaitStep,
    YawStep,
)
from groundstation.paths.files import load_path
from groundstation.paths.lights import Light, load_lights
from groundstation.verdict.expectations import EXPECT_MOST_M, Expect
from onboard.config.example_files import existing_file
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    check_schema,
    convert,
    load_fleet,
    read_toml,
)
from onboard.config.formation_shape import FormationShape, problems, split
from onboard.config.toml_reading import table
from onboard.control.path import Path

_DEEPEST = 8  # lists within lists of steps


class Mission(msgspec.Struct, frozen=True):
    """A mission file, resolved; ``steps`` is empty for a Python mission, whose function runs
    instead.
    """

    path: str
    fleet: FleetConfig
    steps: tuple[MissionStep, ...]
    expect: Expect
    on_failure: OnFailure
    text: str
    is_python: bool = False
    arguments: Mapping[str, str] = {}  # of a Python mission's function, as they were written
    paths: Mapping[str, Path] = {}  # by the files that the steps name
    shapes: Mapping[str, FormationShape] = {}  # formations of the mission's own

    def course(self) -> Iterator[Stage]:
        """Yield the stages of the mission as it is expected to be flown; none of a Python mission."""
        return course(self.fleet, self.steps, self.paths_of, self.path)

    def paths_of(self, step: FollowPathStep) -> dict[str, Path]:
        """Return the path of each vehicle of a step."""
        return {vehicle: self.paths[file] for vehicle, file in step.paths.items()}

    def lights_of(self, step: FollowPathStep) -> dict[str, tuple[Light, ...]]:
        """Return the colours of each vehicle of a step that has some."""
        return {
            vehicle: load_lights(FilePath(self.path).parent / file)
            for vehicle, file in step.lights.items()
        }

    @property
    def name(self) -> str:
        """File name without its ending."""
        return FilePath(self.path).stem


def load_mission(path: str | os.PathLike[str], fleet: FleetConfig | str | None = None) -> Mission:
    """Read and check a mission, TOML or Python.

    Args:
        path: of the file, or the name of an example: ``paper``.
        fleet: instead of the fleet that the mission names.

    Returns:
        The mission with its fleet.

    Raises:
        ConfigError: missing file, unknown key, unknown vehicle or formation, goal outside the fence
            ...
    """
    name = existing_file(path, "mission file")
    if name.endswith(".py"):
        return _load_python(name, fleet)
    data, text, name = read_toml(name, "mission file")
    return mission_from_mapping(data, path=name, text=text, fleet=fleet)


def with_fleet(mission: Mission, fleet: FleetConfig) -> Mission:
    """Check a mission again for another fleet.

    Args:
        mission: as it was read.
        fleet: instead of its own.

    Returns:
        The same mission with that fleet.

    Raises:
        ConfigError: as :func:`load_mission`.
    """
    changed = msgspec.structs.replace(mission, fleet=with_shapes(fleet, mission.shapes))
    _check_steps(changed)
    return changed


def mission_from_mapping(
    data: dict[str, Any], *, path: str, text: str = "", fleet: FleetConfig | str | None = None
) -> Mission:
    """Resolve and check the content of a mission file; see :func:`load_mission`."""
    check_schema(data, path)
    if "vehicles" in data:
        raise ConfigError(
            f"{path} is a fleet file, not a mission. Fly a mission with it: covey fly MISSION --fleet {path}. "
            f"Look at it: covey check {path}. Fly it by hand: covey tui --fleet {path}"
        )
    known = {"schema", "fleet", "formations", "step", "expect", "on_failure"}
    for key in data:
        if key not in known:
            raise ConfigError(
                f"{path}: unknown key '{key}'. Known keys here: {', '.join(sorted(known))}."
            )
    shapes = _shapes(data.get("formations", {}), path)
    config = with_shapes(_fleet_of(data.get("fleet"), fleet, path), shapes)
    tables = data.get("step", [])
    if not isinstance(tables, list) or not tables:
        raise ConfigError(
            f"{path}: 'step' is missing or no list of tables. Add at least one [[step]] with do = ..."
        )
    steps = tuple(_step(one, f"step[{index}]", path) for index, one in enumerate(tables))
    expect = convert(data.get("expect", {}), Expect, path, "expect")
    _check_expect(expect, path, "expect")
    files = {
        file
        for step in _every(steps)
        if isinstance(step, FollowPathStep)
        for file in step.paths.values()
    }
    mission = Mission(
        path=path,
        fleet=config,
        steps=steps,
        expect=expect,
        on_failure=convert(data.get("on_failure", {}), OnFailure, path, "on_failure"),
        text=text,
        paths={file: load_path(FilePath(path).parent / file) for file in sorted(files)},
        shapes=shapes,
    )
    _check_steps(mission)
    return mission


def _shapes(data: Any, path: str) -> dict[str, FormationShape]:
    """Read formations of a mission; their files are relative to it."""
    slots, shapes = split(table(data, path, "formations"), path)
    for sentence in (
        *(f"'formations.{name}' needs a 'shape' here." for name in slots),
        *problems(shapes),
    ):
        raise ConfigError(f"{path}: {sentence}")
    folder = FilePath(path).absolute().parent
    return {
        name: msgspec.structs.replace(
            one, file=one.file and str(folder / one.file), font=one.font and str(folder / one.font)
        )
        for name, one in shapes.items()
    }


def with_shapes(fleet: FleetConfig, shapes: Mapping[str, FormationShape]) -> FleetConfig:
    """Return the fleet with a mission's own formations as well."""
    return msgspec.structs.replace(fleet, shapes={**fleet.shapes, **shapes}) if shapes else fleet


def _every(steps: Iterable[MissionStep]) -> Iterator[MissionStep]:
    """Yield all steps, those within others too."""
    for step in steps:
        yield step
        for name in BLOCK_KEYS:
            inner = getattr(step, name, ())
            yield from _every(itertools.chain.from_iterable(inner) if name == "branches" else inner)


def _fleet_of(value: Any, override: FleetConfig | str | None, path: str) -> FleetConfig:
    if isinstance(override, FleetConfig):
        return override
    if override is not None:
        return load_fleet(override)
    if not isinstance(value, str):
        raise ConfigError(
            f"{path}: 'fleet' must be the path of a fleet file, relative to this file; or give --fleet."
        )
    beside = FilePath(path).parent / value
    return load_fleet(value if FilePath(value).name == value and not beside.exists() else beside)


def _step(data: Any, key: str, path: str) -> MissionStep:
    if not isinstance(data, dict) or not isinstance(data.get("do"), str):
        raise ConfigError(f"{path}: '{key}.do' is missing. It says what to do: {', '.join(STEPS)}.")
    kind = STEPS.get(data["do"])
    if kind is None:
        raise ConfigError(
            f"{path}: '{key}.do' is {data['do']!r}. A step can do: {', '.join(STEPS)}."
        )
    inner = {
        name: _inner_steps(data[name], f"{key}.{name}", path) for name in BLOCK_KEYS if name in data
    }
    step = cast(MissionStep, convert({**data, **dict.fromkeys(inner, ())}, kind, path, key))
    if inner:
        step = msgspec.structs.replace(step, **inner)
    for name, (low, high) in STEP_BOUNDS.items():
        value = getattr(step, name, None)
        if value is not None and not low <= value <= high:
            raise ConfigError(
                f"{path}: '{key}.{name}' is {value}; it must lie between {low:g} and {high:g}."
            )
    if isinstance(step, ExpectStep):
        _check_expect(step, path, key)
    if isinstance(step, WaitStep) and step.until is None and not step.duration_s:
        raise ConfigError(
            f"{path}: '{key}' waits for nothing. Give it duration_s or a condition: until = {{ ... }}."
        )
    until = getattr(step, "until" if isinstance(step, WaitStep) else "when", None)
    if isinstance(until, Until) and until in (Until(), Until(vehicles=until.vehicles)):
        raise ConfigError(
            f"{path}: '{key}' has an empty condition. Give it one: {{ battery_below_pct = 30 }}."
        )
    return step


def _inner_steps(tables: Any, key: str, path: str) -> tuple[Any, ...]:
    """Read steps within a step, or lists of them."""
    if not isinstance(tables, list) or not tables:
        raise ConfigError(f"{path}: '{key}' must be a list of steps, and not empty.")
    if key.count("[") > _DEEPEST:
        raise ConfigError(
            f"{path}: '{key}': steps within steps within steps. Write them one after the other."
        )
    if key.endswith(".branches"):
        return tuple(_inner_steps(one, f"{key}[{k}]", path) for k, one in enumerate(tables))
    return tuple(_step(one, f"{key}[{k}]", path) for k, one in enumerate(tables))


def _check_expect(expect: Expect, path: str, key: str) -> None:
    for name, high in EXPECT_MOST_M.items():
        value = getattr(expect, name)
        if value is not None and not 0.0 < value <= high:
            raise ConfigError(
                f"{path}: '{key}.{name}' is {value}; it must lie above 0 and at most {high:g} m."
            )


def _check_steps(mission: Mission) -> None:
    """Check every order of the mission as if it were given now, so that no mission starts that must
    fail later.
    """
    fleet = mission.fleet
    for stage in mission.course():
        step, where = stage.step, f"{mission.path}: '{stage.key}"
        flying = stage.flying if stage.is_known else fleet.enabled_names
        if isinstance(step, FaultStep):
            _check_fault(step, fleet, where)
        elif isinstance(step, WaitStep):
            _check_until(step.until, fleet, f"{where}.until'")
        elif isinstance(step, FollowPathStep):
            mission.lights_of(step)  # files that cannot be read are found before take-off
            _check_paths((*step.paths, *step.lights), fleet, flying, f"{where}.paths'")
        elif isinstance(step, FlyFormationStep):
            _check_paths(stage.paths, fleet, flying, f"{where}.name'")
        if stage.planned is None:
            continue
        reason = next(iter(stage.planned.refusals.values()), "")
        if not reason and stage.is_known:
            reason = _out_of_order(step, stage.planned.intent.vehicles, stage.flying)
        if reason:
            raise ConfigError(f"{where}' ({step.do}): {reason}")
    for index, step in enumerate(mission.steps):
        if isinstance(step, ReactStep):
            _check_until(step.when, fleet, f"{mission.path}: 'step[{index}].when'")


def _out_of_order(step: MissionStep, vehicles: Sequence[str], flying: Collection[str]) -> str:
    """Return a sentence on a step that comes too early or too late."""
    grounded = ", ".join(name for name in vehicles if name not in flying)
    up = ", ".join(name for name in vehicles if name in flying)
    if isinstance(step, GoalStep | RotateStep | YawStep | HoldStep | HomeStep) and grounded:
        return (
            f'{grounded} would be on the ground at this step. Put a step do = "takeoff" before it.'
        )
    if isinstance(step, ArmStep | TakeoffStep | DisarmStep) and up:
        return (
            f'{up} would fly already at this step. Put a step do = "land" before it, or remove it.'
        )
    return ""


def _check_paths(
    names: Collection[str], fleet: FleetConfig, flying: Collection[str], where: str
) -> None:
    """Check the vehicles of paths; the findings of a mission check the paths themselves."""
    wrong = [name for name in names if name not in fleet.enabled_names or name not in flying]
    if wrong or not names:
        raise ConfigError(
            f"{where} must name vehicles that fly at this step, each with a file; it has {', '.join(wrong) or 'none'}."
        )


def _check_until(until: Until | None, fleet: FleetConfig, where: str) -> None:
    for vehicles in (
        ()
        if until is None
        else (until.vehicles, until.landed, until.flying, list(until.reached) or None)
    ):
        try:
            fleet.select(vehicles)
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from None


def _check_fault(step: FaultStep, fleet: FleetConfig, where: str) -> None:
    """Check a fault without an emulator; the emulator checks the rest before the mission's first
    step.
    """
    misplaced = set(step.parameters) & set(FaultStep.__struct_fields__)
    if misplaced:
        raise ConfigError(
            f"{where}.parameters' has '{min(misplaced)}', which is a key of the step. Move it up."
        )
    try:
        fleet.select(step.vehicles)
    except ConfigError as error:
        raise ConfigError(f"{where}.vehicles': {error}") from None


def _load_python(name: str, fleet: FleetConfig | str | None) -> Mission:
    text, constants = read_python(name)
    expect = convert(constants.get("EXPECT", {}), Expect, name, "EXPECT")
    _check_expect(expect, name, "EXPECT")
    config = _fleet_of(constants.get("FLEET"), fleet, name)
    shapes = _shapes(constants.get("FORMATIONS", {}), name)
    config = with_shapes(config, shapes)
    return Mission(name, config, (), expect, OnFailure(), text, is_python=True, shapes=shapes)
