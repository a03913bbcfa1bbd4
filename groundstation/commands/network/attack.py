"""``covey attack``: what gets into a fleet, tried on an emulated copy of it that flies meanwhile.

Examples:
  covey attack fleet.toml
  covey attack paper --long
  covey attack fleet.toml --json

The copy has ports, a folder and keys of its own; whatever runs already is left alone. Each try is
made twice: on a copy with keys, and on one without any, where it has to get in. docs/threats.md
says what is not tried. Exit status: 0 nothing got in; 1 something did, or a try proved nothing; 2
wrong input; 130 interrupted.
"""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from json import dumps
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.network.fleet_copy import Flight, copy_of, flying
from groundstation.commands.network.intruder import Intruders
from groundstation.commands.network.tries import NoProofError, Stage, spare_vehicle, tries
from groundstation.processes.supervisor import ProcessError
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_OK

_LATE_MS = 25.0  # p99 of a loop's period; it is 20 ms
_WORDS = {True: "GOT IN", False: "stopped"}


@dataclass(frozen=True, slots=True)
class Result:
    """One try, with and without keys; None where it could not be made."""

    name: str
    with_keys: bool | None
    without_keys: bool | None
    is_right: bool
    remark: str = ""


def attack(
    fleet: Annotated[str, Parameter(name="FLEET")],
    /,
    *,
    long: bool = False,
    json: bool = False,
) -> int:
    """Try to get into an emulated copy of a fleet from outside and inside, while it flies; say what
    got in.

    Args:
        fleet: the fleet file
        long: floods and bad frames for minutes instead of seconds
        json: one object instead of lines
    """
    config = load_fleet(fleet)
    if len(config.enabled_names) < 2:
        raise ConfigError(
            f"{config.path}: an attack needs two vehicles, one of which loses its key. Enable another."
        )
    say = (lambda _: None) if json else _say
    if not config.has_keys:
        say(
            f"{config.path} itself has no keys: whoever reaches its bus gets in. Lock it: covey secure {config.path}"
        )
    with tempfile.TemporaryDirectory(prefix="covey-attack-") as folder:
        try:
            outcomes, figures = asyncio.run(_attack(config, Path(folder), long, say))
        except ProcessError as error:
            raise ConfigError(f"The copy of the fleet does not fly: {error}") from None
    results = _results(outcomes)
    is_right = all(result.is_right for result in results) and bool(figures["is_right"])
    if json:
        print(dumps({"tries": [asdict(result) for result in results], **figures}, indent=2))
    else:
        print(_report(results, figures))
    return EXIT_OK if is_right else EXIT_FAILED


def _say(line: str) -> None:
    print(line, flush=True)


# with keys or not -> try -> whether it got in, or why it proves nothing
Outcomes = dict[bool, dict[str, bool | str]]


async def _attack(
    config: FleetConfig, folder: Path, is_long: bool, say: Callable[[str], None]
) -> tuple[Outcomes, dict[str, object]]:
    outcomes: Outcomes = {}
    figures: dict[str, object] = {}
    for is_locked in (False, True):
        copy = copy_of(config, folder / ("locked" if is_locked else "open"), is_locked=is_locked)
        say(
            f"\nA copy of {len(copy.enabled_names)} vehicles {'with' if is_locked else 'without'} keys takes off."
        )
        async with flying(copy) as flight:
            outcomes[is_locked] = await _try_all(
                flight, Intruders(copy, folder), is_long, is_locked, say
            )
            flight.measure()
            if is_locked:
                figures = _figures(flight)
    return outcomes, figures


async def _try_all(
    flight: Flight, intruders: Intruders, is_long: bool, is_locked: bool, say: Callable[[str], None]
) -> dict[str, bool | str]:
    stage = Stage(flight, intruders, is_long)
    found: dict[str, bool | str] = {}
    spare = await asyncio.to_thread(spare_vehicle, stage)
    try:
        for one in tries(flight.names):
            if one.is_stopped_without_keys and not is_locked:
                continue
            try:
                found[one.name] = await asyncio.to_thread(one.gets_in, stage)
            except NoProofError as error:
                found[one.name] = str(error)
            outcome = found[one.name]
            say(f"  {_WORDS[outcome] if isinstance(outcome, bool) else 'NO PROOF'}  {one.name}")
    finally:
        await asyncio.to_thread(spare.stop)
    return found


def _results(outcomes: Outcomes) -> list[Result]:
    results = []
    for name, locked in outcomes[True].items():
        control = outcomes[False].get(name)
        is_right = locked is False and control in (True, None)
        remark = next((one for one in (locked, control) if isinstance(one, str)), "")
        if control is False:
            remark = "it does not get in without keys either: this try proves nothing"
        known = [one if isinstance(one, bool) else None for one in (locked, control)]
        results.append(Result(name, known[0], known[1], is_right, remark))
    return results


def _figures(flight: Flight) -> dict[str, object]:
    limit_m, loop_ms = (
        flight.fleet.fleet.safety_distance_m,
        max(flight.worst_loop_ms.values(), default=0.0),
    )
    return {
        "separation_m": round(flight.separation_m, 3),
        "safety_distance_m": limit_m,
        "loop_p99_ms": round(loop_ms, 1),
        "neighbour_age_ms": round(flight.worst_age_ms, 1),
        "is_right": flight.separation_m >= limit_m and loop_ms <= _LATE_MS,
    }


def _report(results: list[Result], figures: dict[str, object]) -> str:
    lines = ["", f"{'with keys':10s} {'without':10s} try"]
    for one in results:
        columns = [
            f"{'-' if value is None else _WORDS[value]:10s}"
            for value in (one.with_keys, one.without_keys)
        ]
        lines.append(
            f"{columns[0]} {columns[1]} {one.name}{': ' + one.remark if one.remark else ''}"
        )
    wrong = [one for one in results if not one.is_right]
    lines.append(f"\n{len(results) - len(wrong)} of {len(results)} tries were stopped.")
    lines.append(
        f"Meanwhile the fleet with keys flew: smallest distance {figures['separation_m']} m "
        f"(safety distance {figures['safety_distance_m']} m), loops' period {figures['loop_p99_ms']} ms (p99), "
        f"oldest state of a neighbour {figures['neighbour_age_ms']} ms."
    )
    return "\n".join(lines)
