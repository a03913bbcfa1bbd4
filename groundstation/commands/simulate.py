"""``covey simulate``: the law over many perturbed flights on the emulator's physics.

Examples:
  covey simulate form3 --seeds 0:100
  covey simulate swap8x --seeds 0:1 --plot swap8.png
  covey simulate mix --seeds 200:242 --set law.rotation=never --json
  covey simulate circle.json --law my_law:law
  covey simulate --suite open --law my_law:law --jobs 2 --keep my_law.jsonl
  covey simulate --map --jobs 2

NAME.json is a scene: a file of yours, or one of Covey's (docs/open-benchmark.md).

With --map: a map of the law, whose cells are combinations of delay, loss, top speed and number of
vehicles. Each cell begins with a screening by few flights. A map can be interrupted; the same
command continues it. --cells AXIS=VALUES flies a part of the map (vehicles, speed_m_s, delay_ms,
loss_pct, errors).

With --suite: all scenes of the open benchmark, as a table with exact intervals.

Exit status: 0 all flights succeed by their own law, without violation or collision, and no cell of
a map fails; 1 otherwise; 2 wrong input.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import File, Folder, LawName
from onboard.config.fleet import ConfigError
from onboard.config.law import BUILT_IN
from onboard.exit_status import EXIT_FAILED, EXIT_OK
from sitl.monte_carlo import campaign_settings, flight_plans, results, scenarios, worlds
from sitl.monte_carlo.command import run
from sitl.monte_carlo.law_map.map_command import fly_map
from sitl.monte_carlo.open_benchmark import scene_file, scene_plans, suite_command

_LAWS = ", ".join(BUILT_IN)
_ERRORS = ", ".join(campaign_settings.ERRORS)

MORE_HELP = f"""\
Scenarios: {scenarios.KNOWN}.

Laws: {_LAWS}, or your own as module:function. Classes of errors: {_ERRORS}.

Keys of --set: {", ".join(campaign_settings.keys(with_aliases=True))}."""

_DEFAULT_SEEDS = "0:10"
_SUITE_SEEDS = "1000:1020"  # about an hour on two cores for a law in Python
_DEFAULT_ERRORS = "mocap"
_DEFAULT_SCALE = 1.0
_MAP_FILE = Path("law-map.jsonl")
_FLIGHTS_OF_CELL = 500

# Names of the options that go with --suite and with --map, besides --jobs.
_SUITE_OPTIONS = ("--law", "--seeds", "--physics", "--scheduler", "--keep", "--anew")
_MAP_OPTIONS = ("--map-file", "--cells", "--flights", "--scheduler", "--anew")

_KEEP_IS_FOR_SUITE = "--keep is for --suite; --json prints the flights of scenarios."


def simulate(
    *scenario: Annotated[str, Parameter(name="SCENARIO")],
    seeds: Annotated[str | None, Parameter(metavar="A:B")] = None,
    law: LawName = None,
    errors: Annotated[str | None, Parameter(metavar="CLASS")] = None,
    type: Annotated[str | None, Parameter(metavar="NAME[,NAME]")] = None,
    fleet: File | None = None,
    scale: Annotated[float | None, Parameter(metavar="X")] = None,
    set: Annotated[tuple[str, ...], Parameter(metavar="KEY=VALUE")] = (),
    physics: Annotated[str | None, Parameter(metavar="NAME")] = None,
    jobs: Annotated[int, Parameter(metavar="N")] = 1,
    json: bool = False,
    trace: Folder | None = None,
    plot: Annotated[Folder | None, Parameter(metavar="FILE_OR_DIR")] = None,
    map: bool = False,
    map_file: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    cells: Annotated[tuple[str, ...], Parameter(metavar="AXIS=VALUES")] = (),
    flights: Annotated[int | None, Parameter(metavar="N")] = None,
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS")] = None,
    suite: Annotated[str | None, Parameter(metavar="NAME")] = None,
    keep: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    anew: bool = False,
) -> int:
    """Fly a scenario once per seed, and say how often it succeeds and how near vehicles come.

    The flights run the drone's own control code on the emulator's vehicles, with errors of the
    estimate, late and lost messages, gusts, and vehicles that differ from their type. The same seed
    gives the same digits.

    Args:
        scenario: one or several, or one file with a scene
        seeds: half-open range, or one seed (default 0:10, for the suite 1000:1020)
        law: avoidance law, or your own as module:function (default covey)
        errors: class of errors of the estimate (default mocap)
        type: vehicle types, which the vehicles get in turn (default sih)
        fleet: take types, law and distances from this fleet file (no obstacles, no fence)
        scale: factor on every spacing (default 1)
        set: change one value; repeatable
        physics: the emulator's (default), or that of a library: rotorpy (extra 'bench')
        jobs: number of processes
        json: one JSON object per flight on standard output
        trace: write one .npz per flight
        plot: a picture (PNG, SVG, PDF) of a flight, or of each
        map: fly the map of the law in place of scenarios, or continue it
        map_file: file that keeps the map (default law-map.jsonl)
        cells: only these cells of the map; repeatable
        flights: number of flights in each cell of the map that does not fail (default 500)
        suite: judge a law over all scenes of a benchmark; there is one benchmark, named open
        keep: file that keeps the flights of the suite, from which the same command goes on
        scheduler: fly the map or the suite on a Dask cluster (extra 'cluster')
        anew: begin the map or the suite anew; the old file is kept as .old, .old2 and so on
    """
    if jobs < 1:
        raise ConfigError(f"--jobs is {jobs}; it must be 1 or more.")

    given = _given(
        {
            "--seeds": seeds,
            "--law": law,
            "--errors": errors,
            "--type": type,
            "--fleet": fleet,
            "--scale": scale,
            "--set": set,
            "--physics": physics,
            "--json": json,
            "--trace": trace,
            "--plot": plot,
            "--map": map,
            "--map-file": map_file,
            "--cells": cells,
            "--flights": flights,
            "--scheduler": scheduler,
            "--suite": suite,
            "--keep": keep,
            "--anew": anew,
        }
    )
    physics_name = worlds.DEFAULT
    if physics is not None:
        physics_name = physics

    if suite is not None:
        _check_suite_options(suite, scenario, given)
        return _fly_suite(
            law=law,
            seeds=seeds,
            physics=physics_name,
            jobs=jobs,
            scheduler=scheduler,
            keep=keep,
            is_anew=anew,
        )

    if map:
        _check_map_options(scenario, given)
        return _fly_map(
            map_file,
            cells=cells,
            flights=flights,
            jobs=jobs,
            scheduler=scheduler,
            is_anew=anew,
        )

    _check_scenario_options(scenario, given)
    subjects, setup = _flown_subjects(
        scenario, law=law, types=type, fleet_path=fleet, errors=errors, scale=scale, changes=set
    )
    records = run(
        subjects,
        _seeds(_DEFAULT_SEEDS if seeds is None else seeds),
        setup,
        jobs=jobs,
        is_json=json,
        physics=physics_name,
        trace_folder=trace,
        picture=plot,
    )
    is_flawless = all(results.is_flawless(record) for record in records)
    return EXIT_OK if is_flawless else EXIT_FAILED


# -- what goes together ----------------------------------------------------------------------------


def _given(options: Mapping[str, object]) -> list[str]:
    """Return the names of the options that the command line has, with whatever value."""
    names = []
    for name, value in options.items():
        is_missing = value is None or value is False or value == ()
        if not is_missing:
            names.append(name)
    return names


def _check_suite_options(suite: str, scenario: Sequence[str], given: Sequence[str]) -> None:
    """Refuse another suite, and what the suite does not take."""
    if suite != "open":
        raise ConfigError(f"--suite is '{suite}'; there is only the suite 'open'.")

    _check_extra("--suite", "scenes", _SUITE_OPTIONS, scenario, given)
    if "--anew" in given and "--keep" not in given:
        raise ConfigError(
            "--anew begins the file of --keep anew, and no file is named. Add --keep FILE, or "
            "leave --anew out."
        )


def _check_map_options(scenario: Sequence[str], given: Sequence[str]) -> None:
    """Refuse what the map of the law does not take."""
    if "--keep" in given:
        raise ConfigError(_KEEP_IS_FOR_SUITE)

    hint = " Its cells are chosen with --cells, for instance --cells errors=vision."
    _check_extra("--map", "scenarios", _MAP_OPTIONS, scenario, given, hint)


def _check_extra(
    option: str,
    what: str,
    taken: Sequence[str],
    scenario: Sequence[str],
    given: Sequence[str],
    hint: str = "",
) -> None:
    """Refuse scenarios, and options that do not go with another one."""
    extra = [*scenario, *(name for name in given if name not in (option, *taken))]
    if extra:
        raise ConfigError(
            f"{option} flies its own {what} and values: leave out {', '.join(extra)}. Of the other "
            f"options it takes --jobs, {', '.join(taken[:-1])} and {taken[-1]}.{hint}"
        )


def _check_scenario_options(scenario: Sequence[str], given: Sequence[str]) -> None:
    """Refuse what only the suite and the map take, and a command line without a scenario."""
    if "--keep" in given:
        raise ConfigError(_KEEP_IS_FOR_SUITE)
    if any(name in _MAP_OPTIONS for name in given):
        raise ConfigError(
            "--map-file, --cells and --flights are for --map; --scheduler and --anew are for --map "
            "and --suite."
        )
    if not scenario:
        raise ConfigError(f"name a scenario, or --map. Known: {scenarios.KNOWN}.")


# -- the suite and the map -------------------------------------------------------------------------


def _fly_suite(
    *,
    law: str | None,
    seeds: str | None,
    physics: str,
    jobs: int,
    scheduler: str | None,
    keep: Path | None,
    is_anew: bool,
) -> int:
    are_flawless = suite_command.judge(
        law or "covey",
        _seeds(_SUITE_SEEDS if seeds is None else seeds),
        physics=physics,
        jobs=jobs,
        scheduler=scheduler,
        keep=keep,
        is_anew=is_anew,
    )
    return EXIT_OK if are_flawless else EXIT_FAILED


def _fly_map(
    map_file: Path | None,
    *,
    cells: Sequence[str],
    flights: int | None,
    jobs: int,
    scheduler: str | None,
    is_anew: bool,
) -> int:
    has_no_failure = fly_map(
        map_file or _MAP_FILE,
        selection=cells,
        least_flights=_FLIGHTS_OF_CELL if flights is None else flights,
        jobs=jobs,
        scheduler=scheduler,
        is_anew=is_anew,
    )
    return EXIT_OK if has_no_failure else EXIT_FAILED


# -- scenarios and scenes --------------------------------------------------------------------------


def _flown_subjects(
    scenario: Sequence[str],
    *,
    law: str | None,
    types: str | None,
    fleet_path: str | None,
    errors: str | None,
    scale: float | None,
    changes: Sequence[str],
) -> tuple[Sequence[flight_plans.Subject], campaign_settings.Setup]:
    """Return the scenarios, or the scene, of a command line, and the settings of their flights.

    Raises:
        ConfigError: a name is unknown, or an option does not go with a scene.
    """
    if not any(scene_file.is_scene(name) for name in scenario):
        setup = campaign_settings.setup_for(
            law=law,
            types=types,
            fleet_path=fleet_path,
            errors=_DEFAULT_ERRORS if errors is None else errors,
            scale=_DEFAULT_SCALE if scale is None else scale,
            changes=changes,
        )
        return _names(scenario), setup

    if len(scenario) > 1:
        raise ConfigError(
            "a scene has settings of its own: name one file with a scene, and nothing else."
        )
    if _given({"--type": types, "--errors": errors, "--scale": scale}):
        raise ConfigError(
            f"{scenario[0]} says types, errors and places itself. Leave --type, --errors and "
            "--scale out; --set changes a value."
        )
    scene = scene_file.load(scenario[0])
    setup = scene_plans.setup(scene, law=law, changes=changes, fleet_path=fleet_path)
    return [scene], setup


def _names(scenario: Sequence[str]) -> list[str]:
    """Return the names of scenarios of a command line.

    Raises:
        ConfigError: a name is unknown, or names a mission file.
    """
    for name in scenario:
        if name.endswith((".toml", ".py")):
            raise ConfigError(
                f"{name} is a file, and this command flies scenarios of its own. Fly a mission in "
                f"simulated time with: covey fly {name} --lockstep"
            )
        if name in scene_file.names():
            raise ConfigError(f"{name} is the name of a scene. Write {name}.json to fly it.")
    return scenarios.expand(scenario)


def _seeds(text: str) -> range:
    """Return the seeds of ``A:B``, or of one number."""
    match = re.fullmatch(r"(\d{1,9})(?::(\d{1,9}))?", text)
    if not match:
        raise ConfigError(
            f"--seeds is '{text}'; write it as A:B with 0 <= A < B, or as one number."
        )

    first = int(match[1])
    end = first + 1
    if match[2]:
        end = int(match[2])
    if end <= first:
        raise ConfigError(
            f"--seeds is '{text}', which holds no seed; "
            "write it as A:B with A < B (B is not flown)."
        )
    return range(first, end)
