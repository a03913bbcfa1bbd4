"""Reads mission files: TOML with steps, or Python.

The whole file is checked before anything starts. Unknown keys are errors: otherwise a mission with
a misspelt limit would fly without that limit.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator
from pathlib import Path as FilePath
from typing import Any, cast

import msgspec

from groundstation.mission_files.degree_keys import in_metres
from groundstation.mission_files.mission import Mission, with_shapes
from groundstation.mission_files.python_file import read_python
from groundstation.mission_files.step_checks import check_steps
from groundstation.mission_files.steps import (
    BLOCK_KEYS,
    STEP_BOUNDS,
    STEPS,
    ExpectStep,
    FollowPathStep,
    MissionStep,
    OnFailure,
    ReactStep,
    RepeatStep,
    Until,
    WaitStep,
    file_keys,
)
from groundstation.mission_files.wall_time import check_wall_time
from groundstation.orders.intents import GoalIntent, Intent
from groundstation.paths.path_files import load_path
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
from onboard.config.toml_reading import table, unknown_key
from onboard.plain_text import meant_words

_KEYS = ("schema", "fleet", "formations", "step", "expect", "on_failure")
_DEEPEST = 8  # largest depth of lists of steps inside steps


def load_mission(path: str | os.PathLike[str], fleet: FleetConfig | str | None = None) -> Mission:
    """Read and check a mission, TOML or Python.

    Args:
        path: path of the file, or the name of an example: ``paper``.
        fleet: fleet to use instead of the one that the mission names.

    Returns:
        The mission with its fleet.

    Raises:
        ConfigError: the file is missing or not valid, for instance because of an unknown key, an
            unknown vehicle or a goal outside the fence.
    """
    name = existing_file(path, "mission file")
    if name.endswith(".py"):
        return _load_python(name, fleet)

    data, text, name = read_toml(name, "mission file")
    return mission_from_mapping(data, path=name, text=text, fleet=fleet)


def with_fleet(mission: Mission, fleet: FleetConfig) -> Mission:
    """Check a mission again for another fleet.

    Args:
        mission: mission as it was read.
        fleet: fleet to use instead of the mission's own.

    Returns:
        The same mission with that fleet.

    Raises:
        ConfigError: see :func:`load_mission`.
    """
    changed = msgspec.structs.replace(mission, fleet=with_shapes(fleet, mission.shapes))
    check_steps(changed)
    return changed


def mission_from_mapping(
    data: dict[str, Any], *, path: str, text: str = "", fleet: FleetConfig | str | None = None
) -> Mission:
    """Resolve and check the content of a mission file; see :func:`load_mission`."""
    check_schema(data, path)
    _check_keys(data, path)

    shapes = _shapes(data.get("formations", {}), path)
    config = with_shapes(_fleet_of(data.get("fleet"), fleet, path), shapes)

    tables = data.get("step", [])
    if not isinstance(tables, list) or not tables:
        raise ConfigError(
            f"{path}: 'step' is missing or no list of tables. "
            "Add at least one [[step]] with do = ..."
        )
    tables = in_metres(tables, config, path)
    steps = tuple(
        _step(step_table, f"step[{index}]", path) for index, step_table in enumerate(tables)
    )

    expect = convert(data.get("expect", {}), Expect, path, "expect")
    _check_expect(expect, path, "expect")

    path_files: set[str] = set()
    for step in _all_steps(steps):
        if isinstance(step, FollowPathStep):
            path_files.update(step.paths.values())
    folder = FilePath(path).parent

    mission = Mission(
        path=path,
        fleet=config,
        steps=steps,
        expect=expect,
        on_failure=convert(data.get("on_failure", {}), OnFailure, path, "on_failure"),
        text=text,
        paths={file: load_path(folder / file) for file in sorted(path_files)},
        shapes=shapes,
    )
    check_steps(mission)
    return mission


def _load_python(name: str, fleet: FleetConfig | str | None) -> Mission:
    """Read a Python mission, whose steps are not known before it flies."""
    text, constants = read_python(name)
    expect = convert(constants.get("EXPECT", {}), Expect, name, "EXPECT")
    _check_expect(expect, name, "EXPECT")

    config = _fleet_of(constants.get("FLEET"), fleet, name)
    shapes = _shapes(constants.get("FORMATIONS", {}), name)

    return Mission(
        path=name,
        fleet=with_shapes(config, shapes),
        steps=(),
        expect=expect,
        on_failure=OnFailure(),
        text=text,
        is_python=True,
        shapes=shapes,
    )


def _check_keys(data: dict[str, Any], path: str) -> None:
    """Refuse a fleet file, and unknown keys."""
    if "vehicles" in data:
        raise ConfigError(
            f"{path} is a fleet file, not a mission. "
            f"Fly a mission with it: covey fly MISSION --fleet {path}. "
            f"Look at it: covey check {path}. Fly it by hand: covey tui --fleet {path}"
        )

    for key in data:
        if key not in _KEYS:
            raise unknown_key(path, key, key, sorted(_KEYS))


def _fleet_of(value: Any, override: FleetConfig | str | None, path: str) -> FleetConfig:
    """Return the given fleet, or the fleet that a mission names if none is given."""
    if isinstance(override, FleetConfig):
        return override
    if override is not None:
        return load_fleet(override)

    if not isinstance(value, str):
        key = "fleet"
        if path.endswith(".py"):
            key = "FLEET"
        raise ConfigError(
            f"{path}: '{key}' must be the path of a fleet file, relative to this file; "
            "or give --fleet."
        )
    # A name without a folder may be an example, if no such file is beside the mission.
    file = FilePath(path).parent / value
    is_example = FilePath(value).name == value and not file.exists()
    if is_example:
        return load_fleet(value)
    return load_fleet(_without_dots(file))


def _without_dots(file: FilePath) -> FilePath:
    """Return the path without ``..``, unless a symbolic link makes that another file."""
    plain = FilePath(os.path.normpath(file))
    if plain.exists() and file.exists() and plain.samefile(file):
        return plain
    return file


def _shapes(data: Any, path: str) -> dict[str, FormationShape]:
    """Return the formations of a mission; paths in them are relative to the mission file."""
    slots, shapes = split(table(data, path, "formations"), path)
    sentences = [f"'formations.{name}' needs a 'shape' here." for name in slots]
    sentences += problems(shapes)
    if sentences:
        raise ConfigError(f"{path}: {sentences[0]}")

    folder = FilePath(path).absolute().parent
    resolved = {}
    for name, shape in shapes.items():
        resolved[name] = msgspec.structs.replace(
            shape,
            file=_in_folder(folder, shape.file),
            font=_in_folder(folder, shape.font),
        )
    return resolved


def _in_folder(folder: FilePath, file: str | None) -> str | None:
    """Return the path of a file that is named relative to a folder; None if none is named."""
    if not file:
        return None
    return str(folder / file)


# -- steps -----------------------------------------------------------------------------------------


def _step(data: Any, key: str, path: str) -> MissionStep:
    """Return one step of a file, with the steps inside it."""
    verbs = ", ".join(STEPS)
    if not isinstance(data, dict) or not isinstance(data.get("do"), str):
        raise ConfigError(f"{path}: '{key}.do' is missing. It says what to do: {verbs}.")
    kind = STEPS.get(data["do"])
    if kind is None:
        meant = meant_words(data["do"], tuple(STEPS))
        raise ConfigError(f"{path}: '{key}.do' is {data['do']!r}.{meant} A step can do: {verbs}.")

    values = dict(data)
    blocks = {}
    for name in BLOCK_KEYS:
        if name in data:
            blocks[name] = _inner_steps(data[name], f"{key}.{name}", path)
            values[name] = ()  # `_inner_steps` has converted these already
    if issubclass(kind, Intent):
        del values["do"]  # an intent has no such field; its class stands for it
        _check_order_keys(values, kind, key, path)

    step = cast(MissionStep, convert(values, kind, path, key))
    if blocks:
        step = msgspec.structs.replace(step, **blocks)
    _check_step(step, key, path)
    return step


def _check_order_keys(values: dict[str, Any], kind: type[Intent], key: str, path: str) -> None:
    """Refuse unknown keys of an order, and those for fields that only the planning may fill in."""
    known = file_keys(kind)
    for name in values:
        if name not in known:
            raise unknown_key(path, f"{key}.{name}", name, known)


def _check_step(step: MissionStep, key: str, path: str) -> None:
    """Refuse values outside their bounds, two lengths of a flight, and a wait for nothing."""
    _check_bounds(step, key, path)
    if isinstance(step, ExpectStep):
        _check_expect(step, path, key)
    _check_time(step, key, path)

    if isinstance(step, GoalIntent) and step.speed_m_s is not None and step.duration_s:
        raise ConfigError(
            f"{path}: '{key}' has a duration_s and a speed_m_s, which is instead of a duration. "
            "Remove one of them."
        )
    if isinstance(step, ReactStep):
        _check_condition(step.when, f"{key}.when", path)
    if not isinstance(step, WaitStep):
        return

    if step.until is not None:
        _check_condition(step.until, f"{key}.until", path)
    elif not step.duration_s and not step.at:
        raise ConfigError(
            f"{path}: '{key}' waits for nothing. Give it a duration_s above 0, "
            'a condition, until = { ... }, or a time: at = "21:30:00".'
        )


def _check_condition(condition: Until, key: str, path: str) -> None:
    """Refuse a condition with nothing to hold, and values outside their bounds."""
    if not condition.reached and condition.within_m != Until().within_m:
        raise ConfigError(
            f"{path}: '{key}.within_m' is the distance from the positions in 'reached', which is "
            "missing. Add reached = { mav0 = [0, 0, 1] }, or remove within_m."
        )
    if condition == Until(vehicles=condition.vehicles):
        raise ConfigError(
            f"{path}: '{key}' is an empty condition. Give it one: {{ battery_below_pct = 30 }}."
        )
    if condition.event is not None and not condition.event.strip():
        raise ConfigError(
            f"{path}: '{key}.event' is empty, and no event has an empty code. Write the code as in "
            'events.txt of a record, such as "battery-low", or "*" for any warning or worse.'
        )
    _check_bounds(condition, key, path)


def _check_bounds(values: MissionStep | Until, key: str, path: str) -> None:
    """Refuse numbers of a step or a condition outside their bounds."""
    for name, (low, high) in STEP_BOUNDS.items():
        value = getattr(values, name, None)
        if value is not None and not low <= value <= high:
            raise ConfigError(
                f"{path}: '{key}.{name}' is {value}; it must lie between {low:g} and {high:g}."
            )


def _check_time(step: MissionStep, key: str, path: str) -> None:
    """Refuse a time that is not valid, and a time inside a repetition."""
    written = getattr(step, "at", "")
    if written:
        try:
            check_wall_time(written)
        except ConfigError as error:
            raise ConfigError(f"{path}: '{key}.at': {error}") from None

    if isinstance(step, RepeatStep):
        for inner in _all_steps(step.steps):
            repeated = getattr(inner, "at", "")
            if repeated:
                raise ConfigError(
                    f"{path}: '{key}' repeats a step with at = \"{repeated}\", and that time comes "
                    "once. Take the step out of the repetition."
                )


def _inner_steps(tables: Any, key: str, path: str) -> tuple[Any, ...]:
    """Return the steps inside a step; for branches, one tuple of steps for each branch."""
    if not isinstance(tables, list) or not tables:
        raise ConfigError(f"{path}: '{key}' must be a list of steps, and not empty.")
    if key.count("[") > _DEEPEST:  # each list has a bracket in the key
        raise ConfigError(
            f"{path}: '{key}': steps within steps within steps. Write them one after the other."
        )

    if key.endswith(".branches"):
        return tuple(
            _inner_steps(branch, f"{key}[{index}]", path) for index, branch in enumerate(tables)
        )
    return tuple(_step(data, f"{key}[{index}]", path) for index, data in enumerate(tables))


def _all_steps(steps: Iterable[MissionStep]) -> Iterator[MissionStep]:
    """Yield all steps, including those inside other steps."""
    for step in steps:
        yield step
        for name in BLOCK_KEYS:
            inner = getattr(step, name, ())
            if name == "branches":
                inner = itertools.chain.from_iterable(inner)
            yield from _all_steps(inner)


def _check_expect(expect: Expect, path: str, key: str) -> None:
    """Refuse expectations outside their bounds."""
    for name, most_m in EXPECT_MOST_M.items():
        value_m = getattr(expect, name)
        if value_m is not None and not 0.0 < value_m <= most_m:
            raise ConfigError(
                f"{path}: '{key}.{name}' is {value_m}; it must lie above 0 and at most {most_m:g}"
                " m."
            )
