"""Mission files: TOML steps with schema 1, checked whole before anything starts. Unknown keys are errors."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any, Literal, cast

import msgspec

from groundstation.missions.python_file import read_python
from groundstation.missions.steps import (
    EXPECT_MOST_M,
    STEP_BOUNDS,
    STEPS,
    ArmStep,
    DisarmStep,
    Expect,
    ExpectStep,
    FaultStep,
    FollowPathStep,
    FormationStep,
    HoldStep,
    LandStep,
    MoveStep,
    OnFailure,
    OrderStep,
    Step,
    TakeoffStep,
    WaitStep,
)
from groundstation.orders.grammar import Intent, default_formation
from groundstation.orders.plan import HeldFormation, plan_order
from groundstation.paths.files import load_path
from groundstation.paths.lights import Light, load_lights
from onboard.config.example_files import existing_file
from onboard.config.fleet import ConfigError, FleetConfig, check_schema, convert, load_fleet, read_toml
from onboard.control.path import Path


class Mission(msgspec.Struct, frozen=True):
    """A mission file, resolved; ``steps`` is empty for a Python mission, whose function runs instead."""

    path: str
    fleet: FleetConfig
    steps: tuple[Step, ...]
    expect: Expect
    on_failure: OnFailure
    text: str
    is_python: bool = False
    paths: Mapping[str, Path] = {}  # by the files that the steps name

    def paths_of(self, step: FollowPathStep) -> dict[str, Path]:
        """Return the path of each vehicle of a step."""
        return {vehicle: self.paths[file] for vehicle, file in step.paths.items()}

    def lights_of(self, step: FollowPathStep) -> dict[str, tuple[Light, ...]]:
        """Return the colours of each vehicle of a step that has some."""
        return {vehicle: load_lights(FilePath(self.path).parent / file) for vehicle, file in step.lights.items()}

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
        ConfigError: missing file, unknown key, unknown vehicle or formation, goal outside the fence ...
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
    changed = msgspec.structs.replace(mission, fleet=fleet)
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
    known = {"schema", "fleet", "step", "expect", "on_failure"}
    for key in data:
        if key not in known:
            raise ConfigError(f"{path}: unknown key '{key}'. Known keys here: {', '.join(sorted(known))}.")
    config = _fleet_of(data.get("fleet"), fleet, path)
    tables = data.get("step", [])
    if not isinstance(tables, list) or not tables:
        raise ConfigError(f"{path}: 'step' is missing or no list of tables. Add at least one [[step]] with do = ...")
    steps = tuple(_step(table, f"step[{index}]", path) for index, table in enumerate(tables))
    expect = convert(data.get("expect", {}), Expect, path, "expect")
    _check_expect(expect, path, "expect")
    files = {file for step in steps if isinstance(step, FollowPathStep) for file in step.paths.values()}
    mission = Mission(
        path=path,
        fleet=config,
        steps=steps,
        expect=expect,
        on_failure=convert(data.get("on_failure", {}), OnFailure, path, "on_failure"),
        text=text,
        paths={file: load_path(FilePath(path).parent / file) for file in sorted(files)},
    )
    _check_steps(mission)
    return mission


def intent_of(step: OrderStep, fleet: FleetConfig) -> Intent:
    """Return the order that a step gives.

    Args:
        step: of a mission file.
        fleet: the fleet file.

    Returns:
        Its intent.

    Raises:
        ConfigError: a vehicle is unknown.
    """
    names = fleet.select(step.vehicles)
    if isinstance(step, TakeoffStep):
        return Intent("takeoff", names, height_m=step.height_m)
    if isinstance(step, MoveStep):
        return Intent("move", names, position_enu_m=step.position_enu_m, duration_s=step.duration_s)
    if isinstance(step, FormationStep):
        if step.vehicles in ("all", ["all"]):
            names = tuple(name for name in names if name in fleet.formations.get(step.name, {}))
        return Intent(
            "formation",
            names,
            position_enu_m=step.position_enu_m,
            formation=step.name,
            duration_s=step.duration_s,
        )
    return Intent(cast(Literal["arm", "hold", "land", "disarm"], step.do), names)


def _fleet_of(value: Any, override: FleetConfig | str | None, path: str) -> FleetConfig:
    if isinstance(override, FleetConfig):
        return override
    if override is not None:
        return load_fleet(override)
    if not isinstance(value, str):
        raise ConfigError(f"{path}: 'fleet' must be the path of a fleet file, relative to this file; or give --fleet.")
    beside = FilePath(path).parent / value
    return load_fleet(value if FilePath(value).name == value and not beside.exists() else beside)


def _step(table: Any, key: str, path: str) -> Step:
    if not isinstance(table, dict) or not isinstance(table.get("do"), str):
        raise ConfigError(f"{path}: '{key}.do' is missing. It says what to do: {', '.join(STEPS)}.")
    kind = STEPS.get(table["do"])
    if kind is None:
        raise ConfigError(f"{path}: '{key}.do' is {table['do']!r}. A step can do: {', '.join(STEPS)}.")
    step = cast(Step, convert(table, kind, path, key))
    for name, (low, high) in STEP_BOUNDS.items():
        value = getattr(step, name, None)
        if value is not None and not low <= value <= high:
            raise ConfigError(f"{path}: '{key}.{name}' is {value}; it must lie between {low:g} and {high:g} s.")
    if isinstance(step, ExpectStep):
        _check_expect(step, path, key)
    return step


def _check_expect(expect: Expect, path: str, key: str) -> None:
    for name, high in EXPECT_MOST_M.items():
        value = getattr(expect, name)
        if value is not None and not 0.0 < value <= high:
            raise ConfigError(f"{path}: '{key}.{name}' is {value}; it must lie above 0 and at most {high:g} m.")


def _check_steps(mission: Mission) -> None:
    """Check every order of the mission as if it were given now, so that no mission starts that must fail later."""
    fleet, held = mission.fleet, HeldFormation(default_formation(mission.fleet))
    flying: set[str] = set()
    is_known = True  # who flies; a fault may land anybody
    for index, step in enumerate(mission.steps):
        key = f"step[{index}]"
        if isinstance(step, (WaitStep, ExpectStep)):
            continue
        if isinstance(step, FaultStep):
            _check_fault(step, fleet, f"{mission.path}: '{key}")
            is_known = False
            continue
        if isinstance(step, FollowPathStep):
            mission.lights_of(step)  # files that cannot be read are found before take-off
            _check_paths(step, fleet, flying if is_known else fleet.enabled_names, f"{mission.path}: '{key}.paths'")
            continue
        if isinstance(step, FormationStep) and step.name not in fleet.formations:
            raise ConfigError(
                f"{mission.path}: '{key}.name' is {step.name!r}, no formation of fleet '{fleet.fleet.name}' "
                f"({', '.join(fleet.formations) or 'it has none'}). Correct the name or add the formation."
            )
        try:
            intent = intent_of(step, fleet)
        except ConfigError as error:
            raise ConfigError(f"{mission.path}: '{key}.vehicles': {error}") from None
        planned = plan_order(intent, fleet, None, held=held, author="check", now_ns=0)
        held = planned.held
        if planned.refusals:
            reason = next(iter(planned.refusals.values()))
            raise ConfigError(f"{mission.path}: '{key}' ({step.do}): {reason}")
        reason = _out_of_order(step, intent.vehicles, flying) if is_known else ""
        if reason:
            raise ConfigError(f"{mission.path}: '{key}' ({step.do}): {reason}")


def _out_of_order(step: OrderStep, vehicles: Sequence[str], flying: set[str]) -> str:
    """Return a sentence on a step that comes too early or too late; keeps the set of those that fly."""
    grounded = ", ".join(name for name in vehicles if name not in flying)
    up = ", ".join(name for name in vehicles if name in flying)
    if isinstance(step, (MoveStep, FormationStep, HoldStep)) and grounded:
        return f'{grounded} would be on the ground at this step. Put a step do = "takeoff" before it.'
    if isinstance(step, (ArmStep, TakeoffStep, DisarmStep)) and up:
        return f'{up} would fly already at this step. Put a step do = "land" before it, or remove it.'
    if isinstance(step, TakeoffStep):
        flying.update(vehicles)
    elif isinstance(step, LandStep):
        flying.difference_update(vehicles)
    return ""


def _check_paths(step: FollowPathStep, fleet: FleetConfig, flying: Collection[str], where: str) -> None:
    """Check the vehicles of paths; the findings of a mission check the paths themselves."""
    wrong = [name for name in (*step.paths, *step.lights) if name not in fleet.enabled_names or name not in flying]
    if wrong or not step.paths:
        raise ConfigError(
            f"{where} must name vehicles that fly at this step, each with a file; it has {', '.join(wrong) or 'none'}."
        )


def _check_fault(step: FaultStep, fleet: FleetConfig, where: str) -> None:
    """Check a fault without an emulator; the emulator checks the rest before the mission's first step."""
    misplaced = set(step.parameters) & set(FaultStep.__struct_fields__)
    if misplaced:
        raise ConfigError(f"{where}.parameters' has '{min(misplaced)}', which is a key of the step. Move it up.")
    try:
        fleet.select(step.vehicles)
    except ConfigError as error:
        raise ConfigError(f"{where}.vehicles': {error}") from None


def _load_python(name: str, fleet: FleetConfig | str | None) -> Mission:
    text, constants = read_python(name)
    expect = convert(constants.get("EXPECT", {}), Expect, name, "EXPECT")
    _check_expect(expect, name, "EXPECT")
    config = _fleet_of(constants.get("FLEET"), fleet, name)
    return Mission(name, config, (), expect, OnFailure(), text, is_python=True)
