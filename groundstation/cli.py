"""The ``covey`` command: the list of commands, and errors as sentences. A command is imported when
it is called.

Start with: covey demo
Shell completion: covey --install-completion
ASCII instead of line drawings: covey --ascii COMMAND, or COVEY_ASCII=1

Exit status: 0 all came true; 1 an expectation failed; 2 wrong input, nothing started; 10 nobody
answered; 50 mixed results per vehicle; 130 interrupted. Ctrl-C lands; a second one ends the
processes that were started.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from keyword import iskeyword
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from onboard.bus.protocol import BusError, NoRouterError
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_INTERRUPTED, EXIT_NO_ANSWER, EXIT_OK, EXIT_WRONG_INPUT
from onboard.plain_text import PlainStream, drawing

if TYPE_CHECKING:
    from cyclopts import App, Group


class Command(NamedTuple):
    """One line of ``covey --help``.

    The command is the function or App of the same name in its module.
    """

    name: str
    group: str
    help: str
    file: str = ""  # where it stands in another command's file

    @property
    def module(self) -> str:
        """Module of the command."""
        return f"groundstation.commands.{self.file or self.function}"

    @property
    def function(self) -> str:
        """Name of the function or App in the module."""
        return self.name.replace("-", "_") + ("_" if iskeyword(self.name) else "")


_GROUPS = (
    "Fly and operate",
    "Before a flight",
    "After a flight",
    "Simulation",
    "On a drone, in a lab",
    "Help",
)
_FLY, _BEFORE, _AFTER, _SIMULATION, _DRONE, _HELP = _GROUPS
COMMANDS = (
    Command("demo", _FLY, "the paper's experiment in simulation, on free ports"),
    Command("fly", _FLY, "fly a mission, TOML or Python"),
    Command("run", _FLY, "a Python script that connects with a fleet, also one of Crazyswarm"),
    Command("gallery", _FLY, "missions worth flying, each in seconds of simulated time"),
    Command("tui", _FLY, "the console, attached to a fleet"),
    Command("web", _FLY, "the console in a browser of this machine"),
    Command("order", _FLY, "one order to a flying fleet, from a shell or a script"),
    Command("init", _BEFORE, "a commented fleet file and a first mission, from a few questions"),
    Command("import", _BEFORE, "a show of Skybrush, or CSVs, made into a mission"),
    Command("check", _BEFORE, "whether fleet or mission files are right and can be flown"),
    Command("preflight", _BEFORE, "go or no-go of every vehicle, check by check"),
    Command(
        "secure",
        _BEFORE,
        "lock a fleet's bus: keys for every node, endpoints that use them",
        "keys",
    ),
    Command("keys", _BEFORE, "the keys of a fleet's bus: issued, listed, renewed, replaced"),
    Command(
        "doctor", _BEFORE, "whether this computer and the fleet's network are fit", "network.doctor"
    ),
    Command(
        "attack",
        _BEFORE,
        "what gets into an emulated copy of a fleet, by whom it is tried",
        "network.attack",
    ),
    Command("px4", _BEFORE, "PX4's parameters and state, and what another version of it changes"),
    Command("replay", _AFTER, "a recorded flight in the console"),
    Command("plot", _AFTER, "figures of a recorded flight"),
    Command(
        "identify",
        _AFTER,
        "a vehicle's lag, drag, hover throttle and tilt error, flown or from a record",
    ),
    Command("simulate", _SIMULATION, "the law over many perturbed flights, seeded"),
    Command("sitl", _SIMULATION, "emulated PX4s for a fleet file"),
    Command("sitl-check", _SIMULATION, "whether a MAVLink endpoint behaves as a real PX4"),
    Command("sitl-truth", _SIMULATION, "ground truth of real PX4s with SIH, for verdicts"),
    Command("agent", _DRONE, "one vehicle's agent, also as a service of systemd"),
    Command(
        "router",
        _DRONE,
        "a router of the fleet's bus, for fleets on several networks",
        "network.router",
    ),
    Command("mocap", _DRONE, "the relay from a motion capture to the fleet's bus"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if "--ascii" in words:  # wherever it stands: every command that has a console understands it
        words.remove("--ascii")
        os.environ["COVEY_ASCII"] = "1"
    with redirect_stdout(PlainStream(sys.stdout)), redirect_stderr(PlainStream(sys.stderr)):
        return _run_in_sentences(words)


def _run_in_sentences(words: list[str]) -> int:
    """Run one command, with errors as sentences."""
    try:
        return _run(words)
    except NoRouterError as error:
        _refuse(str(error))
        return EXIT_NO_ANSWER
    # what was written or configured is wrong, or an endpoint is taken
    except (ConfigError, BusError) as error:
        return _refuse(str(error))
    except ImportError as error:
        # The front page's library wraps the error of a command's module.
        missing = error if isinstance(error, ModuleNotFoundError) else error.__cause__
        name = missing.name or "" if isinstance(missing, ModuleNotFoundError) else ""
        if not name or name.partition(".")[0] in ("onboard", "groundstation", "sitl"):
            raise
        wheel = f"covey-{_version().split()[1]}-py3-none-any.whl"
        return _refuse(
            f"this command needs '{name}'. Install the wheel with all of it: pip install '{wheel}[all]'"
        )
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader has read enough, as in `covey check FILE | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return EXIT_OK


def _run(words: list[str]) -> int:
    if words[:1] == ["agent"]:  # a drone's computer has the base libraries only
        agent: Callable[[list[str]], int] = importlib.import_module("onboard.agent.main").main
        return agent(words[1:])
    if words[:1] == ["bench"]:
        arguments = f' ARGS="{" ".join(words[2:])}"' if words[2:] else ""
        return _refuse(
            f"benchmarks are no part of the product. In a clone, type: make bench-{words[1] if words[1:] else 'NAME'}"
            f"{arguments}"
        )
    from cyclopts import CycloptsError

    app = front_page(words[0] if words else "")
    try:
        status = app(words)
    except CycloptsError as error:
        return _refuse(f"{error} '{' '.join(['covey', *_path(words)])} --help' says more.")
    if status is None:  # a page of help, or a command group without its command
        return EXIT_OK if any(word.startswith("-") for word in words) else EXIT_WRONG_INPUT
    return int(status)


def _path(words: list[str]) -> list[str]:
    """The command that was meant, if there is one of that name."""
    return words[:1] if words and any(command.name == words[0] for command in COMMANDS) else []


def front_page(called: str) -> App:
    """All commands, of which only the one ``called`` is imported now; the others when their help is
    asked for.
    """
    from cyclopts import App, Parameter
    from rich.console import Console

    app = App(
        name="covey",
        help="Fleet ground station for PX4 multirotors that fly close together.",
        help_format="plaintext",
        help_epilogue=_epilogue(sys.modules[__name__]),
        version=_version,
        group_commands=_group(_HELP),
        default_parameter=Parameter(negative="", show_default=_default),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,
        console=Console(file=drawing(sys.stdout)),
    )
    for command in COMMANDS:
        if command.name != called:
            path = f"{command.module}:{command.function}"
            app.command(path, name=command.name, group=_group(command.group), help=command.help)
            continue
        module = importlib.import_module(command.module)
        target = getattr(module, command.function)
        if isinstance(target, App):
            target.help_epilogue = _epilogue(module)
            app.command(target)
        else:
            app.command(target, name=command.name, help_epilogue=_epilogue(module))
    app.register_install_completion_command()
    return app


def _epilogue(module: ModuleType) -> str:
    """Return what stands below the options: the end of a module's docstring, and what it computes."""
    text = (module.__doc__ or "").partition("\n\n")[2].strip()
    return "\n\n".join(filter(None, (text, getattr(module, "MORE_HELP", ""))))


@cache
def _group(name: str) -> Group:
    from cyclopts import Group

    return Group(name, sort_key=_GROUPS.index(name))


def _default(value: object) -> str | None:
    """Return a default as the help shows it; flags, lists and what is left open have none."""
    return (
        None
        if isinstance(value, bool | tuple | None)
        else f"{value:g}"
        if isinstance(value, float)
        else str(value)
    )


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"covey {version('covey')}"
    except PackageNotFoundError:
        return "covey (not installed)"


def _refuse(sentence: str) -> int:
    print(f"covey: {sentence}", file=sys.stderr)
    return EXIT_WRONG_INPUT
