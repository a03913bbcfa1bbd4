"""The ``covey`` command: the list of commands, and errors as sentences.

A command is a function in ``groundstation/commands``, which :data:`COMMANDS` names. The module of
a command is imported when the command is called. So a help page or an agent needs no library of
other commands.

A command may have parts: ``covey check`` is a command, and ``covey check vehicles`` is a part of
it. :data:`FORMER` holds the commands that became parts. These keep working under their old word.

Every error in a command line or in a file ends here as one sentence on standard error and an exit
status.
"""

from __future__ import annotations

import errno
import importlib
import inspect
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stderr, redirect_stdout
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from groundstation.missions.lasting_output import lasting_output
from onboard.bus.protocol import BusError, NoRouterError
from onboard.config.fleet import ConfigError
from onboard.exit_status import (
    EXIT_INTERRUPTED,
    EXIT_NO_ANSWER,
    EXIT_NO_READER,
    EXIT_OK,
    EXIT_WRONG_INPUT,
)
from onboard.plain_text import PlainStream, drawing, fitted, meant_words

if TYPE_CHECKING:
    from cyclopts import App, MissingArgumentError


class Command(NamedTuple):
    """One command, or a part of one."""

    name: str  # as it is typed
    help: str  # one sentence
    target: str  # module:function, or module:App, in groundstation.commands
    parts: tuple[Command, ...] = ()

    def load(self) -> tuple[ModuleType, object]:
        """Import the module of the command; return it and the function or App."""
        name, _, attribute = self.path.partition(":")
        module = importlib.import_module(name)
        return module, getattr(module, attribute)

    @property
    def path(self) -> str:
        """Module and name of the function or App, from the root of the project."""
        return f"groundstation.commands.{self.target}"


# The commands by purpose, in the order of ``covey --help``. The page fits a screen of 24 lines of
# 80 characters, so a sentence has at most 55 characters.
COMMANDS: dict[str, tuple[Command, ...]] = {
    "See": (
        Command("tui", "the console, attached to a fleet", "tui:tui"),
        Command(
            "web",
            "the fleet in a browser, live; web foxglove: in Foxglove",
            "web:web",
            parts=(
                Command(
                    "foxglove", "the fleet live in Foxglove or Lichtblick", "foxglove:foxglove"
                ),
            ),
        ),
        Command("replay", "a recorded flight in the console", "replay:replay"),
        Command("report", "a recorded flight as a page that plays it", "report:report"),
        Command("log", "recorded flights: list, info, export for other programs", "log:app"),
        Command("plot", "figures of a recorded flight", "plot:plot"),
        Command("incident", "what went wrong in a flight, and why", "incident:incident"),
    ),
    "Fly": (
        Command(
            "demo",
            "the paper's experiment, simulated; demo gallery: more",
            "demo:demo",
            parts=(
                Command(
                    "gallery",
                    "missions worth flying, each in seconds of simulated time",
                    "gallery:gallery",
                ),
            ),
        ),
        Command(
            "fly",
            "fly a mission, TOML or Python; fly script: any script",
            "fly:fly",
            parts=(
                Command(
                    "script",
                    "a Python script that connects with a fleet, also one of Crazyswarm",
                    "run:run",
                ),
            ),
        ),
        Command("order", "one order to a flying fleet, from a shell or a script", "order:order"),
    ),
    "Prepare": (
        Command("init", "a commented fleet file and a first mission", "init:init"),
        Command(
            "import",
            "a show of Skybrush, or CSVs, made into a mission",
            "import_:import_",
            parts=(
                Command(
                    "fence",
                    "the fence of a QGroundControl .plan or GeoJSON, for a fleet file",
                    "fence:fence",
                ),
                Command(
                    "spots",
                    "take-off spots where the vehicles stand, for a fleet file",
                    "spots:spots",
                ),
            ),
        ),
    ),
    "Check": (
        Command(
            "check",
            "is it right: files, vehicles, computer, network, keys?",
            "check:check",
            parts=(
                Command(
                    "vehicles",
                    "go or no-go of every vehicle, check by check",
                    "preflight:preflight",
                ),
                Command(
                    "computer",
                    "whether this computer and the fleet's network are fit",
                    "doctor:doctor",
                ),
                Command(
                    "attack",
                    "what gets into an emulated copy of a fleet, and by whom it is tried",
                    "attack:attack",
                ),
                Command(
                    "endpoint",
                    "whether a MAVLink endpoint behaves as a real PX4",
                    "sitl_check:sitl_check",
                ),
            ),
        ),
        Command(
            "evidence", "what a fleet shows when all fails, for an authority", "evidence:evidence"
        ),
    ),
    "Vehicles": (
        Command("agent", "one vehicle's agent, also as a service of systemd", "agent:agent"),
        Command("px4", "PX4's parameters and state; what a version changes", "px4:px4"),
        Command(
            "identify", "lag, drag, hover throttle and tilt error of a vehicle", "identify:identify"
        ),
    ),
    "Network": (
        Command("keys", "lock a fleet's bus; its keys issued, listed, renewed", "keys:keys"),
        Command("router", "a router of the bus, for fleets on several networks", "router:router"),
        Command("mocap", "the relay from a motion capture to the fleet's bus", "mocap:mocap"),
        Command(
            "corrections",
            "RTK corrections for the fleet, from a cable, NTRIP, TCP",
            "corrections:corrections",
        ),
    ),
    "Simulation": (
        Command(
            "sitl",
            "emulated PX4s for a fleet file",
            "sitl:sitl",
            parts=(
                Command(
                    "truth",
                    "ground truth of real PX4s with SIH, for verdicts",
                    "sitl_truth:sitl_truth",
                ),
            ),
        ),
        Command("simulate", "the law over many perturbed flights, seeded", "simulate:simulate"),
    ),
}

# Commands that became a part of another one: the old word, and the words that replace it.
FORMER: dict[str, tuple[str, ...]] = {
    "attack": ("check", "attack"),
    "doctor": ("check", "computer"),
    "foxglove": ("web", "foxglove"),
    "gallery": ("demo", "gallery"),
    "preflight": ("check", "vehicles"),
    "run": ("fly", "script"),
    "secure": ("keys", "secure"),
    "sitl-check": ("check", "endpoint"),
    "sitl-truth": ("sitl", "truth"),
}

# Commands that run until they are stopped. They end when nobody reads their output any more; all
# others go on to their own exit status.
_UNTIL_STOPPED = ("agent", "corrections", "mocap", "router", "sitl", "web")

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_HELP_WORDS = ("--help", "-h")
_COMPLETION_WORD = "--install-completion"
# The line of bash that the library writes splits file names at spaces, and puts a space after
# folders. The function below replaces it.
_BASH_FILES_OF_LIBRARY = 'COMPREPLY=( $(compgen -f -- "${cur}") )'
_BASH_FILES = """\
_covey_files() {
  compopt -o filenames
  mapfile -t COMPREPLY < <(compgen -f -- "${cur}")
}

"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status.

    Args:
        argv: the words after ``covey``; without them those of the process.
    """
    words = list(sys.argv[1:] if argv is None else argv)

    # The option is accepted anywhere in the command line, since every command that draws obeys it.
    if "--ascii" in words:
        words.remove("--ascii")
        os.environ["COVEY_ASCII"] = "1"

    current = current_words(words)
    output: AbstractContextManager[None] = lasting_output(BrokenPipeError)
    if current and current[0] in _UNTIL_STOPPED:
        output = nullcontext()

    with (
        output,
        redirect_stdout(PlainStream(sys.stdout)),
        redirect_stderr(PlainStream(sys.stderr)),
        warnings.catch_warnings(),
    ):
        # numpy warns when a number in a file overflows. Covey refuses such numbers in its own
        # words.
        warnings.simplefilter("ignore", RuntimeWarning)
        return _run_in_sentences(words)


def _run_in_sentences(words: list[str]) -> int:
    """Run one command and write its errors as sentences; return the exit status."""
    try:
        status = _run(words)
        sys.stdout.flush()
        return status
    except NoRouterError as error:
        _refuse(str(error))
        return EXIT_NO_ANSWER
    except (ConfigError, BusError) as error:
        # Something typed or configured is wrong, or an endpoint is already in use.
        return _refuse(str(error))
    except ImportError as error:
        library = _missing_library(error)
        if library is None:
            raise
        _, version_word = _version().split(maxsplit=1)
        wheel = f"covey-{version_word}-py3-none-any.whl"
        return _refuse(
            f"this command needs '{library}'. Install the wheel with all of it:"
            f" pip install '{wheel}[all]'"
        )
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader has read enough, as in `covey sitl FILE | head`.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_NO_READER
    except OSError as error:
        # An agent's log keeps the traceback; so does whatever is no matter of a file.
        is_of_file = error.filename is not None or error.errno in _NO_ROOM
        if words[:1] == ["agent"] or not is_of_file:
            raise
        return _refuse(_file_sentence(error))


def _file_sentence(error: OSError) -> str:
    """Return what is wrong with a file or folder, and what to do."""
    if error.errno in _NO_ROOM:
        return f"nothing more can be written ({error.strerror}). Make room, and start again."
    return (
        f"{error.filename}: this file or folder cannot be used ({error.strerror}). "
        "Name another place, or give yourself the right to use it."
    )


def _missing_library(error: ImportError) -> str | None:
    """Return the library that is not installed; None when a module of the project is missing."""
    # The library of the front page wraps the error of a command's module.
    missing = error if isinstance(error, ModuleNotFoundError) else error.__cause__
    if not isinstance(missing, ModuleNotFoundError) or not missing.name:
        return None
    package, _, _ = missing.name.partition(".")
    if package in ("onboard", "groundstation", "sitl"):
        return None
    return missing.name


def _run(words: list[str]) -> int:
    words = current_words(words, says_so=True)
    first = words[0] if words else ""

    if not words or first in _HELP_WORDS:
        print(front_text())
        return EXIT_OK if words else EXIT_WRONG_INPUT
    if first == "agent" and not (_is_help(words) and find_spec("cyclopts")):
        # The computer of a drone has only the base libraries, and not those of the front page.
        agent: Callable[[list[str]], int] = importlib.import_module("onboard.agent.main").main
        return agent(words[1:])
    if first == "bench":
        return _refuse_bench(words[1:])
    if not first.startswith("-") and find_command(first) is None:
        return _refuse_unknown(first)

    from cyclopts import CycloptsError, MissingArgumentError, UnusedCliTokensError

    app = front_page(words)
    try:
        status = app(words)
    except CycloptsError as error:
        called = " ".join(["covey", *(error.command_chain or command_words(words))])
        sentence = str(error)
        if isinstance(error, UnusedCliTokensError):
            unused = " ".join(error.unused_tokens or ())
            sentence = f"too many words: {unused}."
        elif isinstance(error, MissingArgumentError):
            sentence = _missing_sentence(error)
        return _refuse(f"{sentence} '{called} --help' says more.")

    if status is None:  # a page of help, or a command without its part
        is_asked = any(word.startswith("-") for word in words)
        return EXIT_OK if is_asked else EXIT_WRONG_INPUT
    return int(status)


def _missing_sentence(error: MissingArgumentError) -> str:
    """Return a sentence about a word that is missing, or about an option without its value."""
    name = "a word"
    if error.argument is not None:
        name = error.argument.name
    if name.startswith("-"):
        return f"the value of {name} is missing."
    return f"{name} is missing."


def _is_help(words: list[str]) -> bool:
    return any(word in _HELP_WORDS for word in words)


def _refuse_bench(words: list[str]) -> int:
    name = words[0] if words else "NAME"
    options = words[1:]
    arguments = f' ARGS="{" ".join(options)}"' if options else ""
    return _refuse(
        f"benchmarks are no part of the product. In a clone, type: make bench-{name}{arguments}"
    )


def _refuse_unknown(name: str) -> int:
    names = [command.name for commands in COMMANDS.values() for command in commands]
    meant = meant_words(name, names)
    return _refuse(f"there is no command '{name}'.{meant} 'covey --help' says more.")


def current_words(words: list[str], *, says_so: bool = False) -> list[str]:
    """Return a command line in which a former command is replaced by its present words.

    Args:
        words: the words after ``covey``.
        says_so: whether a line on standard error names the new words.
    """
    if not words or words[0] not in FORMER:
        return words

    new = FORMER[words[0]]
    if says_so:
        sentence = (
            f"'covey {words[0]}' is 'covey {' '.join(new)}' now; the old word goes on working."
        )
        print(f"covey: {sentence}", file=sys.stderr)
    return [*new, *words[1:]]


def find_command(name: str) -> Command | None:
    """Return the command of a name, if there is one."""
    for commands in COMMANDS.values():
        for command in commands:
            if command.name == name:
                return command
    return None


def command_words(words: list[str]) -> list[str]:
    """Return those of the words that name a command or a part of one."""
    command = find_command(words[0]) if words else None
    if command is None:
        return []
    if len(words) > 1 and any(part.name == words[1] for part in command.parts):
        return words[:2]
    return words[:1]


def front_text() -> str:
    """Return the page of ``covey --help``: a line for each command, on one screen."""
    lines = ["covey COMMAND: a ground station for PX4 multirotors. More: covey COMMAND --help"]
    for group, commands in COMMANDS.items():
        title = group
        for command in commands:
            lines.append(f"{title:<12}{command.name:<12}{command.help}")
            title = ""
    return "\n".join(lines)


def front_page(words: Sequence[str] = (), *, is_whole: bool = False) -> App:
    """Return the app with all commands; only the called one is imported.

    Args:
        words: the command line; its first words are the command that is called.
        is_whole: import all of them, for the completion of a shell or for a document.
    """
    from cyclopts import App, Parameter
    from rich.console import Console

    class FrontPage(App):
        """The commands, with a completion of bash that offers file names where no option fits."""

        def generate_completion(self, **options: object) -> str:
            script = super().generate_completion(**options)  # type: ignore[arg-type]
            if "\ncomplete -F " not in script:
                return script
            script = script.replace("\ncomplete -F ", "\ncomplete -o default -F ")
            return _BASH_FILES + script.replace(_BASH_FILES_OF_LIBRARY, "_covey_files")

    app = FrontPage(
        name="covey",
        help="Fleet ground station for PX4 multirotors that fly close together.",
        help_format="plaintext",
        version=_version,
        default_parameter=Parameter(negative="", show_default=_default),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,
        console=Console(file=drawing(sys.stdout)),
    )
    called = list(words[:2])
    is_whole = is_whole or called[:1] == [_COMPLETION_WORD]
    for commands in COMMANDS.values():
        for command in commands:
            if is_whole or called[:1] == [command.name]:
                _add_with_parts(app, command, called[1:], is_whole=is_whole)
            else:
                app.command(command.path, name=command.name, help=command.help)
    app.register_install_completion_command()
    return app


def _add_with_parts(app: App, command: Command, called: list[str], *, is_whole: bool) -> None:
    """Import a command and add it with its parts; only the called part is imported."""
    from cyclopts import App

    if not command.parts:
        _add(app, command)
        return

    command_app = App(name=command.name, help_epilogue=None)
    module, function = command.load()
    command_app.help_epilogue = _epilogue(module)
    command_app.help = _description(function)
    command_app.default(function)  # type: ignore[call-overload]
    for part in command.parts:
        if is_whole or called == [part.name]:
            _add(command_app, part)
        else:
            command_app.command(part.path, name=part.name, help=part.help)
    app.command(command_app)


def _add(app: App, command: Command) -> None:
    """Add a command that is a function, or an App that holds further commands."""
    from cyclopts import App

    module, target = command.load()
    if isinstance(target, App):
        target.help_epilogue = _epilogue(module)
        app.command(target)
    else:
        app.command(  # type: ignore[call-overload]
            target,
            name=command.name,
            help=_description(target),
            help_epilogue=_epilogue(module),
        )


def _description(function: object) -> str:
    """Return the text above the options of a command: its docstring without the arguments."""
    docstring = inspect.getdoc(function) or ""
    description, _, _ = docstring.partition("\n\nArgs:")
    return _for_any_width(description)


def _epilogue(module: ModuleType) -> str:
    """Return the text below the options of a command.

    It is the docstring of the module without its first paragraph, and MORE_HELP of the module.
    """
    _, _, further_paragraphs = (module.__doc__ or "").partition("\n\n")
    texts = [further_paragraphs.strip(), getattr(module, "MORE_HELP", "")]
    return _for_any_width("\n\n".join(text for text in texts if text))


def _for_any_width(text: str) -> str:
    """Return a text with each paragraph on one line, which the terminal breaks where it must.

    A paragraph with indented lines stays as it is: it is a list.
    """
    paragraphs = []
    for paragraph in text.split("\n\n"):
        is_list = "\n " in paragraph
        paragraphs.append(paragraph if is_list else " ".join(paragraph.splitlines()))
    return "\n\n".join(paragraphs)


def _default(value: object) -> str | None:
    """Return a default value as the help shows it, or None for flags, lists and None."""
    if isinstance(value, bool | tuple | None):
        return None
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"covey {version('covey')}"
    except PackageNotFoundError:
        return "covey (not installed)"


def _refuse(sentence: str) -> int:
    print(fitted(f"covey: {sentence}", sys.stderr), file=sys.stderr)
    return EXIT_WRONG_INPUT
