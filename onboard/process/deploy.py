"""``covey agent deploy``: wheel, fleet file and service onto each companion computer, by plain ssh
and scp.
"""

from __future__ import annotations

import argparse
import hashlib
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_MIXED, EXIT_OK, EXIT_WRONG_INPUT
from onboard.security.credentials import files_of
from onboard.security.mavlink_key import key_file

_FOLDER = "covey"  # in the home of the login
_COVEY = ".venv/bin/covey"


def parser() -> argparse.ArgumentParser:
    """Return the command line of a deployment."""
    parser = argparse.ArgumentParser(
        prog="covey agent deploy",
        description="Copy wheel and fleet file to each vehicle's companion computer, and start its agent's service.",
        epilog="The computers are those of the fleet file's 'agent' endpoints. Exit status: 0 all; 1 none; 50 some.",
    )
    parser.add_argument("--fleet", required=True, metavar="FILE", help="fleet file")
    parser.add_argument("--vehicles", metavar="NAMES", help="only these")
    parser.add_argument(
        "--wheel",
        action="append",
        default=[],
        metavar="FILE",
        help="Covey's wheel, then libraries'",
    )
    parser.add_argument("--login", metavar="USER", help="of the companions (default: ssh's own)")
    parser.add_argument(
        "--user", action="store_true", help="a service of that user: no root, no real-time priority"
    )
    parser.add_argument("--status", action="store_true", help="change nothing: say what runs where")
    parser.add_argument(
        "--print", action="store_true", dest="prints", help="show the commands, run none"
    )
    return parser


def main(words: Sequence[str]) -> int:
    """Deploy to each vehicle in turn; the exit status."""
    arguments = parser().parse_args(words)
    try:
        fleet = load_fleet(arguments.fleet)
        names = fleet.select(arguments.vehicles)
        missing = [wheel for wheel in arguments.wheel if not Path(wheel).is_file()]
        if missing:
            raise ConfigError(
                f"{missing[0]}: there is no such file. Make the wheel in a clone: make wheel"
            )
    except ConfigError as error:
        print(f"covey: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    failed = []
    for name in names:
        commands = (
            _status(fleet, name, arguments)
            if arguments.status
            else _deployment(fleet, name, arguments)
        )
        print(f"{name} on {fleet.vehicles[name].host}:", flush=True)
        for command in commands:
            if arguments.prints:
                print(f"  {shlex.join(command)}")
            elif subprocess.run(command, check=False).returncode != 0:
                failed.append(name)
                print(f"covey: {name}: this failed: {shlex.join(command)}", file=sys.stderr)
                break
    if arguments.status and not arguments.prints:
        text = Path(fleet.path).read_bytes()
        print(
            f"The fleet file here is {hashlib.sha256(text).hexdigest()[:12]}: all must have the same."
        )
    return EXIT_OK if not failed else EXIT_FAILED if len(failed) == len(names) else EXIT_MIXED


def _ssh(fleet: FleetConfig, name: str, arguments: argparse.Namespace, line: str) -> list[str]:
    return ["ssh", "-t", "--", _target(fleet, name, arguments), f"cd {_FOLDER} && {line}"]


def _target(fleet: FleetConfig, name: str, arguments: argparse.Namespace) -> str:
    host = fleet.vehicles[name].host
    return f"{arguments.login}@{host}" if arguments.login else host


def _deployment(fleet: FleetConfig, name: str, arguments: argparse.Namespace) -> list[list[str]]:
    """Command lines that bring one companion up to date."""
    target = _target(fleet, name, arguments)
    commands = [["ssh", "--", target, f"mkdir -p {_FOLDER}"]]
    commands.append(["scp", "--", fleet.path, f"{target}:{_FOLDER}/fleet.toml"])
    files = [*(files_of(name) if fleet.has_keys else ())]
    files += [key_file(name)] if fleet.vehicles[name].mavlink_signing else []
    if files:
        keys = [str(Path(fleet.keys_folder) / file) for file in files]
        commands[0][-1] += f" && mkdir -p -m 700 {_FOLDER}/{fleet.fleet.keys}"
        commands.append(["scp", "-p", "--", *keys, f"{target}:{_FOLDER}/{fleet.fleet.keys}/"])
    if arguments.wheel:
        commands.append(["scp", "--", *arguments.wheel, f"{target}:{_FOLDER}/"])
        wheel, pip = (
            shlex.quote(f"./{Path(arguments.wheel[0]).name}"),
            ".venv/bin/pip install -q --find-links .",
        )
        install = (
            f"python3 -m venv .venv && {pip} {wheel} && {pip} --force-reinstall --no-deps {wheel}"
        )
        commands.append(_ssh(fleet, name, arguments, install))
    sudo, options = ("", " --user") if arguments.user else ("sudo ", " --realtime")
    service = f"{sudo}{_COVEY} agent install --fleet fleet.toml --vehicle {name}{options} --now"
    return [*commands, _ssh(fleet, name, arguments, service)]


def _status(fleet: FleetConfig, name: str, arguments: argparse.Namespace) -> list[list[str]]:
    """Command lines that say what runs on one companion."""
    version = ".venv/bin/pip show covey | grep Version"
    user = " --user" if arguments.user else ""
    agent = f"{_COVEY} agent status --fleet fleet.toml --vehicle {name}{user}"
    return [_ssh(fleet, name, arguments, f"{version}; sha256sum fleet.toml | cut -c1-12; {agent}")]
