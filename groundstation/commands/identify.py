"""``covey identify``: what a vehicle really is, from a short manoeuvre or from any recorded flight.

Flies one vehicle through quick and slow moves in a box about its start, or reads a record, and proposes the values of
the vehicle's type with their uncertainty, beside what the fleet file says.
"""

from __future__ import annotations

import argparse
import asyncio
import datetime
import json
import math
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from groundstation.commands.flight import Flight, clock_say, prepare
from groundstation.identification.flight_log import TooLittleFlown
from groundstation.identification.identify import identify
from groundstation.identification.record import logs_of
from groundstation.identification.report import Flown, page, rows
from groundstation.missions.verdict import EXIT_FAILED, EXIT_OK, EXIT_WRONG_INPUT
from groundstation.processes.free_ports import toml_text
from groundstation.recording.reader import record_path
from groundstation.recording.writer import RECORD_NAME
from onboard.config.fleet import ConfigError, FleetConfig, Vec3, load_fleet, parking_distance_m

BOX_M, HEIGHT_M, MOVES = 0.6, 1.0, 14
_MOVE_TIMEOUT_S, _LEG_S = 8.0, 2.2


def main(argv: Sequence[str] | None = None) -> int:
    """Fly and identify, or identify from a record; the exit status."""
    options = _parser().parse_args(argv)
    try:
        if options.record_dir is not None:
            if options.sitl:
                raise ConfigError("--sitl flies; a recorded flight needs no flying. Give one of them.")
            return report(Path(options.record_dir), options.fleet, options.vehicle, options.json)
        return _fly(options)
    except ConfigError as error:
        print(f"covey: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="covey identify",
        description="Identify a vehicle's hover throttle, lag, drag and tilt error, and propose values for its type.",
        epilog="Exit status: 0 identified; 1 the flight failed or showed too little; 2 wrong input.",
    )
    parser.add_argument("record_dir", metavar="RECORD", nargs="?", help="folder of a recorded flight: nothing is flown")
    parser.add_argument("--fleet", metavar="FILE", help="fleet file (default for a record: the one in its folder)")
    parser.add_argument("--vehicle", metavar="NAME", help="who flies; for a record, whom to identify (default: all)")
    parser.add_argument("--sitl", action="store_true", help="start the emulator and the agent too, on free ports")
    parser.add_argument("--headless", action="store_true", help="no console: progress in lines")
    parser.add_argument("--record", metavar="DIR", help="flight folder (default: flights/<time>)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the manoeuvre, and of the emulator (default 0)")
    parser.add_argument(
        "--box", type=float, default=BOX_M, metavar="METRES", help=f"half its width (default {BOX_M:g})"
    )
    parser.add_argument("--json", action="store_true", help="a list with one object for each vehicle")
    return parser


def _fly(options: argparse.Namespace) -> int:
    if options.fleet is None or options.vehicle is None:
        raise ConfigError("Give --fleet FILE and --vehicle NAME to fly, or the folder of a recorded flight.")
    if options.seed < 0:
        raise ConfigError(f"--seed is {options.seed}; it must be 0 or more.")
    if not options.box > 0.0:
        raise ConfigError(f"--box is {options.box}; it must be a width in metres above 0.")
    fleet = load_fleet(options.fleet)
    if options.vehicle not in fleet.enabled_names:
        raise ConfigError(
            f"'{options.vehicle}' is no enabled vehicle of '{fleet.fleet.name}': {', '.join(fleet.enabled_names)}."
        )
    if not options.headless and not sys.stdout.isatty():
        raise ConfigError("The console needs a terminal, and this output is none. Add --headless.")
    folder = Path(options.record or Path("flights") / datetime.datetime.now().strftime("%Y%m%d-%H%M%S")).absolute()
    if (folder / RECORD_NAME).exists():
        raise ConfigError(f"{folder}: this folder holds a flight already. Choose another with --record.")
    path = Path(options.fleet).absolute()
    steps = manoeuvre(fleet, options.vehicle, half_m=options.box, seed=options.seed)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if options.sitl:
            path = folder / "fleet.toml"
            path.write_text(_alone(fleet, options.vehicle), encoding="utf-8")
        (folder / "mission.py").write_text(mission_text(path, options.vehicle, steps), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror}). Choose another with --record.") from None
    settings = prepare(
        str(folder / "mission.py"),
        folder,
        fleet_path=str(path),
        law=None,
        is_simulated=options.sitl,
        has_free_ports=True,
        is_headless=options.headless,
        seed=options.seed,
    )
    say = clock_say() if not options.json else lambda line: print(line, file=sys.stderr, flush=True)
    status = asyncio.run(Flight(settings, say=say).fly())
    if status != EXIT_OK:
        print(f"The manoeuvre was not flown to its end; what there is lies in {folder}.", file=sys.stderr)
        return status
    return report(folder, None, options.vehicle, options.json)


def manoeuvre(
    fleet: FleetConfig, name: str, *, half_m: float = BOX_M, height_m: float = HEIGHT_M, seed: int = 0
) -> tuple[tuple[Vec3, float], ...]:
    """Goals and durations (0: as quick as the limits allow) of a zig-zag in a box about the vehicle's start.

    The box keeps clear of the fence and of the places where the others stand.

    Raises:
        ConfigError: there is no room for a box of 0.25 m to each side.
    """
    x, y, _ = fleet.vehicles[name].start_enu_m
    fence = fleet.fleet.geofence_m
    others = [fleet.vehicles[other].start_enu_m for other in fleet.enabled_names if other != name]
    apart_m = min((math.dist((x, y), other[:2]) for other in others), default=math.inf)
    apart_m -= parking_distance_m(fleet) + fleet.law.uncooperative_margin_m
    room_m = min(x - fence.x[0], fence.x[1] - x, y - fence.y[0], fence.y[1] - y) - 0.4
    half_m = min(half_m, room_m, apart_m)
    if not half_m >= 0.25:
        raise ConfigError(
            f"{fleet.path}: around the start of {name} there are {max(0.0, half_m):.2f} m to each side, the manoeuvre "
            "needs 0.25 m beside fence and neighbours. Move the start, or widen the fence."
        )
    height_m = min(height_m, fence.z[1] - 0.3)
    rng = np.random.default_rng(seed)
    steps: list[tuple[Vec3, float]] = []
    for index in range(MOVES):
        reach = half_m * float(rng.uniform(0.7, 1.0)) * (1.0 if index % 2 == 0 else -1.0)
        along_x = (index // 2) % 2 == 0
        goal = (round(x + reach * along_x, 3), round(y + reach * (not along_x), 3), height_m)
        steps.append((goal, 3.5 if index % 3 == 2 else 0.0))
    return tuple(steps)


def mission_text(fleet_path: Path, name: str, steps: Sequence[tuple[Vec3, float]]) -> str:
    """The manoeuvre as a mission file in Python: a goal that is not reached in time is no failure, but the next one."""
    height_m, listed = steps[0][0][2], "".join(f"    {step!r},\n" for step in steps)
    return f'''"""Identification of {name}: quick and slow moves about its start."""

from groundstation.missions.api import OrderFailed
from groundstation.orders.grammar import Intent

FLEET = {str(fleet_path)!r}
EXPECT = {{"all_landed": True}}
STEPS = [
{listed}]


async def mission(fleet):
    vehicle = fleet[{name!r}]
    await vehicle.takeoff({height_m!r})
    for goal, duration_s in STEPS:
        intent = Intent("move", (vehicle.name,), position_enu_m=goal, duration_s=duration_s)
        fleet.say(str(intent))
        begin_ns = fleet.client.now_ns()
        results = await (await fleet.client.submit(intent)).wait({_MOVE_TIMEOUT_S!r})
        if results[vehicle.name].phase not in ("done", "unfinished"):
            raise OrderFailed(intent, results)
        # where PX4's estimate says so early that it has arrived, the leg is flown to its end all the same
        await fleet.wait(max(0.0, max(duration_s, {_LEG_S!r}) - 1e-9 * (fleet.client.now_ns() - begin_ns)))
    await fleet.wait(2.0)
    await vehicle.land()
'''


def _alone(fleet: FleetConfig, name: str) -> str:
    """The fleet file with the others out of it."""
    data = tomllib.loads(fleet.text)
    for other, table in data["vehicles"].items():
        table["enabled"] = other == name
    return toml_text(data, f"Made from {fleet.path}: only {name} takes part.")


# -- from a record -------------------------------------------------------------------------------------------------


def report(folder: Path, fleet_path: str | None, name: str | None, is_json: bool) -> int:
    """Identify everybody who flew in a record, or one of them, and say it; the exit status."""
    path = record_path(folder)
    fleet = load_fleet(fleet_path or path.parent / "fleet.toml")
    names = fleet.enabled_names if name is None else (name,)
    if name is not None and name not in fleet.vehicles:
        raise ConfigError(f"'{name}' is no vehicle of fleet '{fleet.fleet.name}': {', '.join(fleet.vehicles)}.")
    logs, refusals = logs_of(path, fleet, names), dict[str, str]()
    flown: list[Flown] = []
    for one in names:
        if one not in logs:
            if name is not None or not logs:
                refusals[one] = "it did not fly in this record."
            continue
        try:
            flown.append(Flown(fleet.vehicles[one], identify(logs[one])))
        except TooLittleFlown as error:
            refusals[one] = str(error)
    for one, why in refusals.items():
        print(f"{one} was not identified: {why}", file=sys.stderr)
    if is_json:
        found = [{"vehicle": each.vehicle.name, **asdict(each.identified), "rows": rows(each)} for each in flown]
        print(json.dumps(found, indent=2))
    elif flown:
        print(page(flown))
    return EXIT_OK if flown else EXIT_FAILED


if __name__ == "__main__":
    raise SystemExit(main())
