"""The commands of covey, their options and a sentence for each, printed from the command line."""

from __future__ import annotations

import re
from typing import Any

from cyclopts import App

from groundstation import cli


def commands() -> str:
    """Print docs/commands.md: a table for each group of ``covey --help``."""
    front = cli.front_page(is_whole=True)
    lines: list[str] = []
    for group, listed in cli.COMMANDS.items():
        lines += [f"## {group}", "", "| command | options | what it does |", "|---|---|---|"]
        for command in listed:
            app = front[command.name]
            lines += _rows([command.name], app)
        lines.append("")

    lines += ["## Former words", "", "They go on working. Each names its new words.", ""]
    lines += ["| former | now |", "|---|---|"]
    for old, new in cli.FORMER.items():
        lines.append(f"| `covey {old}` | `covey {' '.join(new)}` |")
    return "\n".join(lines)


def _rows(words: list[str], app: App) -> list[str]:
    """Return the row of a command, if it can be called itself, and the rows of its parts."""
    rows = []
    if app.default_command is not None:
        summary = _summary(app)
        options = ", ".join(_options(app))
        rows.append(f"| `covey {' '.join(words)}` | {options} | {summary}{_page(app)} |")
    for name in sorted(name for name in app if not name.startswith("-")):
        rows += _rows([*words, name], app[name])
    return rows


def _summary(app: App) -> str:
    text = app.default_command.__doc__ or ""
    return " ".join(text.partition("\n\n")[0].split())


def _options(app: App) -> list[str]:
    options = []
    for argument in app.assemble_argument_collection():
        if not argument.show:
            continue
        name = argument.names[0] if argument.names else ""
        is_flag = argument.hint is bool
        if is_flag or not name.startswith("-"):
            options.append(_code(name))
        else:
            options.append(_code(f"{name} {_placeholder(argument)}"))
    return options


def _placeholder(argument: Any) -> str:
    if argument.parameter.metavar:
        return str(argument.parameter.metavar)
    choices = argument.get_choices(force=True)
    if choices:
        return "|".join(choices)
    kind = str(argument.hint)
    return {"<class 'int'>": "N", "<class 'float'>": "X"}.get(kind, "VALUE")


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|")


def _page(app: App) -> str:
    """Return links to the pages that the command's help names."""
    pages = dict.fromkeys(re.findall(r"docs/([\w-]+\.md)", str(app.help_epilogue or "")))
    links = ", ".join(f"[{page.removesuffix('.md')}]({page})" for page in pages)
    return f" More: {links}" if links else ""
