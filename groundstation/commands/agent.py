"""``covey agent``: fly one vehicle of a fleet, or look after the service that does.

Examples:
  covey agent --fleet fleet.toml --vehicle mav1
  covey agent install --fleet fleet.toml --vehicle mav1 --now
  covey agent deploy --fleet fleet.toml --wheel covey.whl

Exit status: 0 done; 1 failed, or the service does not run; 2 wrong input;
50 deployed to some vehicles, not to all. docs/deployment.md says more.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from groundstation.commands.parameters import FILE_OR_TEXT, LAW_OR_TEXT
from onboard.agent.main import command_line, main
from onboard.process import deploy, service

# On a drone's computer, which has only the base libraries, argparse parses these commands. Here the
# same parsers define the options for cyclopts, so that each option is defined once.


def _command(parser: argparse.ArgumentParser, *verb: str) -> Callable[..., int]:
    """Return a function that has the options of a parser, and passes them to the agent as words.

    Cyclopts reads the options of a command from its signature, so the function gets a signature
    that is made from the parser.
    """

    def command(**values: object) -> int:
        words = list(verb)
        for name, value in values.items():
            words += _words("--" + name.replace("_", "-"), value)
        return main(words)

    parameters = list(_parameters(parser))
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__doc__ = parser.description
    return command


def _words(option: str, value: object) -> list[str]:
    """Return the words of an option and its value on the command line."""
    if value is None or value is False:
        return []
    if value is True:
        return [option]
    if not isinstance(value, tuple):
        return [option, str(value)]

    words = []
    for repeated_value in value:
        words += [option, str(repeated_value)]
    return words


def _parameters(parser: argparse.ArgumentParser) -> Iterator[inspect.Parameter]:
    """Yield the options of a parser as parameters of a function."""
    for action in parser._actions:
        if not action.option_strings or action.dest == "help":
            continue
        option = action.option_strings[-1]

        kind: Any = _kind_of(action)
        default: object = action.default
        is_repeatable = isinstance(action.default, list)  # true of these parsers
        if is_repeatable:
            kind = tuple[kind, ...]
            default = ()
        elif action.default is None and not action.required:
            kind = kind | None
        if action.required:
            default = inspect.Parameter.empty

        shown = Parameter(help=action.help)
        if action.metavar:
            takes_own_name = action.dest == "law"  # --law also takes the name of a user's own law
            shown = Parameter(
                help=action.help,
                metavar=str(action.metavar),
                show_choices=not takes_own_name,
                show_default=False,
            )
        yield inspect.Parameter(
            option.removeprefix("--").replace("-", "_"),
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[kind, shown],
        )


def _kind_of(action: argparse.Action) -> Any:
    """Return the type of the value that an option takes."""
    if action.nargs == 0:
        return bool
    if action.choices is not None:
        return Literal[tuple(action.choices)]
    if action.metavar == "FILE":
        return FILE_OR_TEXT
    if action.dest == "law":
        return LAW_OR_TEXT
    if action.type is not None:
        return action.type
    return str


def _service_parser(verb: str) -> argparse.ArgumentParser:
    """Return the parser of install, status or logs."""
    for action in service.parser()._actions:
        if isinstance(action, argparse._SubParsersAction):
            parser: argparse.ArgumentParser = action.choices[verb]
            parser.description = _SERVICE_HELP[verb]
            return parser
    raise LookupError(verb)


_SERVICE_HELP = {
    "install": "Write the unit of a systemd service for one vehicle's agent.",
    "status": "Say whether the service of one vehicle's agent runs.",
    "logs": "Print what the service of one vehicle's agent wrote.",
}

agent = App(name="agent", help=command_line().description)
agent.default(_command(command_line()))
for _verb in service.VERBS:
    agent.command(_command(_service_parser(_verb), _verb), name=_verb)
agent.command(_command(deploy.parser(), "deploy"), name="deploy")
