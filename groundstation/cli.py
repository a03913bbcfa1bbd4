"""The ``covey`` command: parses, imports what a command needs only then, and turns errors into sentences."""

from __future__ import annotations

import argparse
import asyncio
import datetime
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from onboard.config.fleet import ConfigError

EXIT_OK, EXIT_WRONG_INPUT, EXIT_INTERRUPTED = 0, 2, 130
LAWS = ("covey", "paper", "off")
EXIT_HELP = (
    "Exit status: 0 all came true; 1 an expectation failed; 2 wrong input, nothing started; 10 nobody answered; "
    "50 mixed results per vehicle; 130 interrupted. Ctrl-C lands; a second one ends the processes that were started."
)
# commands with a command line of their own: what `covey --help` says of them, and whose main() takes the words after
_PASSED_ON = {
    "sitl": ("emulated PX4s for a fleet file", "sitl.server"),
    "agent": ("one vehicle's agent", "onboard.agent.main"),
    "mocap": ("the relay from a motion capture to the fleet's bus", "onboard.mocap.__main__"),
    "preflight": ("go or no-go of every vehicle, check by check", "groundstation.commands.preflight"),
    "px4": ("PX4's parameters: what this fleet needs and why, read and set", "groundstation.commands.px4"),
    "check": ("whether fleet or mission files are right and can be flown", "groundstation.commands.check"),
    "simulate": ("the law over many perturbed flights, seeded", "sitl.monte_carlo.command"),
    "sitl-check": ("whether a MAVLink endpoint behaves as a real PX4", "sitl.conformance.__main__"),
    "sitl-truth": ("ground truth of real PX4s with SIH, for verdicts", "sitl.sih_truth"),
    "identify": (
        "a vehicle's lag, drag, hover throttle and lean, flown or from a record",
        "groundstation.commands.identify",
    ),
    "order": ("one order to a flying fleet, from a shell or a script", "groundstation.commands.order"),
    "plot": ("figures of a recorded flight", "groundstation.commands.plot"),
    "replay": ("a recorded flight in the console", "groundstation.commands.replay"),
    "web": ("the console in a browser of this machine", "groundstation.commands.web"),
}
_BENCHES = {
    "lockstep": ("how much faster than time flights in lockstep are, and where the time goes", "tests.bench.lockstep"),
    "demo": ("fly the demo several times and write a table", "tests.bench.demo"),
    "console": ("what the console costs and how quickly it answers", "tests.bench.console"),
    "sitl": ("what the emulated PX4s cost", "tests.bench.sitl"),
    "responses": ("the emulator beside PX4: steps, closed loop, errors", "tests.bench.responses"),
    "silence": ("how soon the wire to PX4 is silent after an agent hangs", "tests.bench.silence.bench"),
    "agents": ("period, processor and memory of agents in flight", "tests.bench.agents"),
    "soak": ("memory, orders and late ticks of a long flight", "tests.bench.soak"),
    "law": ("the law beside other methods, and without each of its ideas", "tests.bench.peers.bench"),
}
_BUS_OPTIONS = {
    "delay_s": ("shortest time from sender to receiver", 0.001),
    "jitter_s": ("mean of what comes on top of it", 0),
    "loss": ("chance of each message to be lost", 0),
    "reorder": ("chance of each message to be overtaken", 0),
    "duplicate": ("chance of each message to come twice", 0),
}
_EXTRAS = {
    *("textual", "textual_serve", "aiohttp", "mcap", "zstandard", "pymavlink", "fastcrc", "rich", "matplotlib"),
    *("pyrvo", "daqp"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if "--ascii" in words:  # wherever it stands: every command that has a console understands it
        words.remove("--ascii")
        os.environ["COVEY_ASCII"] = "1"
    try:
        if words and words[0] in _PASSED_ON:
            return _pass_on(_PASSED_ON[words[0]][1], words[1:])
        if words and words[0] == "bench":
            return _bench(words[1:])
        options = _parser().parse_args(words)
        run: Callable[[argparse.Namespace], int] = options.run
        return run(options)
    except ConfigError as error:
        print(f"covey: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _EXTRAS:
            raise
        print(f"covey: this command needs '{error.name}'. Install it with: pip install 'covey[all]'", file=sys.stderr)
        return EXIT_WRONG_INPUT
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # who reads has seen enough, as in `covey check FILE | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return EXIT_OK


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="covey", description="Fleet ground station for PX4 multirotors that fly close together.", epilog=EXIT_HELP
    )
    parser.add_argument("--version", action="version", version=f"covey {_version()}")
    parser.add_argument("--ascii", action="store_true", help="draw consoles in ASCII, as COVEY_ASCII=1 does")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    demo = commands.add_parser("demo", help="the paper's experiment in simulation, on free ports", epilog=EXIT_HELP)
    demo.add_argument("--mission", metavar="FILE", help="fly this mission instead")
    _flight_options(demo)
    demo.set_defaults(run=_demo)

    fly = commands.add_parser("fly", help="fly a mission, TOML or Python", epilog=EXIT_HELP)
    fly.add_argument("mission", metavar="MISSION", help="mission file")
    fly.add_argument("--sitl", action="store_true", help="start the emulator and the agents too, on the file's ports")
    _flight_options(fly)
    fly.set_defaults(run=_fly)

    tui = commands.add_parser("tui", help="the console, attached to a fleet")
    tui.add_argument("--fleet", metavar="FILE", required=True, help="fleet file")
    tui.add_argument("--readonly", action="store_true", help="only watch: no order leaves it, not even land")
    tui.add_argument("--bell", action="store_true", help="ring the terminal's bell for every new alarm")
    tui.add_argument("--view", action="store_true", help="only watch: do not take control, not even of a free fleet")
    tui.add_argument(
        "--no-preview", action="store_true", help="send arm, take-off and moves without showing them ahead"
    )
    tui.set_defaults(run=_tui)

    for name, (text, _) in _PASSED_ON.items():
        commands.add_parser(name, help=text, add_help=False)
    commands.add_parser("bench", help=f"measure Covey: {', '.join(_BENCHES)}", add_help=False)
    return parser


def _flight_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fleet", metavar="FILE", help="fleet file instead of the mission's")
    parser.add_argument("--headless", action="store_true", help="no console: progress in lines, ends by itself")
    parser.add_argument("--record", metavar="DIR", help="flight folder (default: flights/<time>)")
    parser.add_argument("--law", choices=LAWS, help="avoidance law instead of the fleet file's (simulated flights)")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random in the emulator (default 0)")
    parser.add_argument("--lockstep", action="store_true", help="agents and emulator in one process, in simulated time")
    bus = parser.add_argument_group("the bus of a flight in lockstep")
    for name, (text, default) in _BUS_OPTIONS.items():
        bus.add_argument(f"--bus-{name.replace('_', '-')}", type=float, metavar="X", help=f"{text} (default {default})")


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("covey")
    except PackageNotFoundError:
        return "(not installed)"


def _demo(options: argparse.Namespace) -> int:
    mission = options.mission or str(_configs() / "missions" / "paper.toml")
    return _flight(options, mission, is_simulated=True, has_free_ports=True)


def _fly(options: argparse.Namespace) -> int:
    return _flight(options, options.mission, is_simulated=options.sitl, has_free_ports=False)


def _flight(options: argparse.Namespace, mission: str, *, is_simulated: bool, has_free_ports: bool) -> int:
    from groundstation.commands.flight import Flight, clock_say, prepare

    if options.seed < 0:
        raise ConfigError(f"--seed is {options.seed}; it must be 0 or more.")
    bus = {name: value for name in _BUS_OPTIONS if (value := getattr(options, f"bus_{name}")) is not None}
    if bus and not options.lockstep:
        raise ConfigError(f"--bus-{next(iter(bus)).replace('_', '-')} is for flights in lockstep. Add --lockstep.")
    if options.lockstep:
        return _lockstep(options, mission, bus)
    folder = Path(options.record) if options.record else _new_folder()
    settings = prepare(
        mission,
        folder.absolute() if options.record is None else folder,
        fleet_path=options.fleet,
        law=options.law,
        is_simulated=is_simulated,
        has_free_ports=has_free_ports,
        is_headless=options.headless,
        seed=options.seed,
    )
    return asyncio.run(Flight(settings, say=clock_say()).fly())


def _lockstep(options: argparse.Namespace, mission: str, bus: dict[str, float]) -> int:
    from groundstation.commands.flight import prepare
    from sitl.lockstep.bus import BusSettings
    from sitl.lockstep.command import fly_mission

    settings = prepare(
        mission,
        Path(options.record) if options.record else _new_folder().absolute(),
        fleet_path=options.fleet,
        law=options.law,
        is_simulated=True,
        has_free_ports=False,
        is_headless=True,
        seed=options.seed,
        needs_ports=False,
    )
    return fly_mission(settings.mission, settings.folder, seed=settings.seed, bus=BusSettings(**bus))


def _tui(options: argparse.Namespace) -> int:
    from groundstation.client.client import FleetClient
    from groundstation.client.read_only import ReadOnlyClient
    from groundstation.console.app import run_console
    from onboard.config.fleet import load_fleet

    fleet = load_fleet(options.fleet)
    if not (sys.stdout.isatty() or "TEXTUAL_DRIVER" in os.environ):  # in a browser the page is the terminal
        raise ConfigError("The console needs a terminal, and this output is none.")

    async def attach() -> int:
        client = FleetClient(fleet, operates=not (options.view or options.readonly))
        try:
            return await run_console(
                fleet,
                ReadOnlyClient(client) if options.readonly else client,
                connect=client.start,
                has_preview=not options.no_preview,
                title=f"fleet {fleet.fleet.name}",
                has_bell=options.bell,
            )
        finally:
            await client.stop()

    return asyncio.run(attach())


def _bench(words: list[str]) -> int:
    """``covey bench WHAT``: each benchmark has a module and a command line of its own."""
    if words and words[0] in _BENCHES:
        module = _BENCHES[words[0]][1]
        if module.startswith("tests."):
            _open_clone()
        return _pass_on(module, words[1:])
    width = max(map(len, _BENCHES))
    print("usage: covey bench WHAT [options]; covey bench WHAT --help says more.")
    print("\n".join(f"  {name:<{width}}  {text}" for name, (text, _) in _BENCHES.items()))
    return EXIT_OK if words and words[0] in ("-h", "--help") else EXIT_WRONG_INPUT


def _pass_on(module: str, words: list[str]) -> int:
    """A command with a command line of its own."""
    run: Callable[[list[str]], int] = importlib.import_module(module).main
    return run(words)


def _open_clone() -> None:
    """Make the clone's ``tests`` importable, where other people's methods live; an installed package has none."""
    root = Path(__file__).resolve().parent.parent
    if not (root / "tests" / "peers").is_dir():
        raise ConfigError(
            f"{root}: this benchmark lives in the tests of a clone, and here are none. Run it in a clone."
        )
    sys.path.insert(0, str(root))


def _configs() -> Path:
    folder = Path(__file__).resolve().parent.parent / "configs"
    if not folder.is_dir():
        raise ConfigError(f"{folder}: the example configurations are missing. Run this from a clone, or use covey fly.")
    return folder


def _new_folder() -> Path:
    return Path("flights") / datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
