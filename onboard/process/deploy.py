"""``covey agent deploy``: brings Covey onto each companion computer, with ssh and scp only.

It copies Covey's wheel, the fleet file, the user's own avoidance law if there is one, and the
vehicle's keys. Then it installs the wheel, and starts the agent's service.
"""

from __future__ import annotations

import argparse
import hashlib
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from onboard.config.file_reading import FLEET_FILE, read_bytes
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_MIXED, EXIT_OK, EXIT_WRONG_INPUT
from onboard.plain_text import fitted
from onboard.security.credentials import files_of
from onboard.security.mavlink_key import key_file

_FOLDER = "covey"  # Covey's folder in the home folder of the user on the companion
_COVEY = ".venv/bin/covey"  # command in that folder


def parser() -> argparse.ArgumentParser:
    """Return the command line of a deployment."""
    parser = argparse.ArgumentParser(
        prog="covey agent deploy",
        description="Copy wheel and fleet file to each vehicle's companion computer, "
        "and start its agent's service.",
        epilog="The computers are those of the fleet file's 'agent' endpoints. "
        "Exit status: 0 all; 1 none; 50 some.",
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
    """Deploy to each vehicle in turn; return the exit status."""
    arguments = parser().parse_args(words)
    try:
        fleet = load_fleet(arguments.fleet)
        names = fleet.select(arguments.vehicles)
        _check_folders(fleet)
        for wheel in arguments.wheel:
            if not Path(wheel).is_file():
                raise ConfigError(
                    f"{wheel}: there is no such file. Make the wheel in a clone: make wheel"
                )
    except ConfigError as error:
        print(fitted(f"covey: {error}", sys.stderr), file=sys.stderr)
        return EXIT_WRONG_INPUT

    failed = [name for name in names if not _run(fleet, name, arguments)]
    if failed and not arguments.status and not arguments.prints:
        print(_failure_words(fleet, names, failed), file=sys.stderr)

    if arguments.status and not arguments.prints:
        text = read_bytes(fleet.path, FLEET_FILE)
        fleet_hash = hashlib.sha256(text).hexdigest()[:12]
        print(f"The fleet file here is {fleet_hash}: all must have the same.")

    if not failed:
        return EXIT_OK
    if len(failed) == len(names):
        return EXIT_FAILED
    return EXIT_MIXED


def _failure_words(fleet: FleetConfig, names: Sequence[str], failed: Sequence[str]) -> str:
    """Return the lines that report a deployment that failed for some vehicles."""
    lines = []
    done = [name for name in names if name not in failed]
    if done:
        lines.append(f"Deployed: {', '.join(_at(fleet, name) for name in done)}.")

    lines.append(f"Not deployed: {', '.join(_at(fleet, name) for name in failed)}.")
    lines.append(
        "These may have a part of it, and fly with the others only once all have the same fleet "
        f"file. Do the same once more with --vehicles {','.join(failed)}"
    )
    return "\n".join(lines)


def _at(fleet: FleetConfig, name: str) -> str:
    """Return a vehicle's name with the host of its companion computer."""
    return f"{name} ({fleet.vehicles[name].host})"


def _check_folders(fleet: FleetConfig) -> None:
    """Refuse a fleet file if its folder of keys or of a law exists only on this computer."""
    folders = (
        ("fleet.keys", fleet.fleet.keys, "its keys", 'keys = "keys"'),
        ("law.folder", fleet.law.folder, "its law", 'folder = "laws"'),
    )
    for key, folder, content, example in folders:
        if PurePosixPath(folder).is_absolute():
            raise ConfigError(
                f"{fleet.path}: '{key}' is {folder!r}, a folder of this computer: no companion "
                f"would find {content} there. Deploy the fleet file that this one was made from, "
                f"or name a folder beside the fleet file, for instance {example}."
            )


def _run(fleet: FleetConfig, name: str, arguments: argparse.Namespace) -> bool:
    """Run or print the command lines for one companion, and return whether all succeeded."""
    if arguments.status:
        commands = _status_commands(fleet, name, arguments)
    else:
        commands = deployment(fleet, name, arguments)

    print(f"{name} on {fleet.vehicles[name].host}:", flush=True)
    for command in commands:
        if arguments.prints:
            print(f"  {shlex.join(command)}")
        elif subprocess.run(command, check=False).returncode != 0:
            print(f"covey: {name}: this failed: {shlex.join(command)}", file=sys.stderr)
            return False
    return True


def _ssh(fleet: FleetConfig, name: str, arguments: argparse.Namespace, line: str) -> list[str]:
    """Return the command line that runs a shell line in Covey's folder of one companion."""
    return ["ssh", "-t", "--", _ssh_target(fleet, name, arguments), f"cd {_FOLDER} && {line}"]


def _ssh_target(fleet: FleetConfig, name: str, arguments: argparse.Namespace) -> str:
    """Return ssh's destination for one companion, where an IPv6 address has no brackets."""
    target = _scp_target(fleet, name, arguments)
    return target.replace("[", "").replace("]", "")


def _scp_target(fleet: FleetConfig, name: str, arguments: argparse.Namespace) -> str:
    """Return scp's destination for one companion, HOST or USER@HOST, where an IPv6 address has
    brackets.
    """
    host = fleet.vehicles[name].host
    if arguments.login:
        return f"{arguments.login}@{host}"
    return host


def deployment(fleet: FleetConfig, name: str, arguments: argparse.Namespace) -> list[list[str]]:
    """Return the command lines that bring one companion up to date.

    Texts from the fleet file are quoted where the remote shell reads them.
    """
    ssh_target = _ssh_target(fleet, name, arguments)
    scp_target = _scp_target(fleet, name, arguments)

    keys: list[str] = []  # names of the vehicle's files in the folder of keys
    if fleet.has_keys:
        keys.extend(files_of(name))
    if fleet.vehicles[name].mavlink_signing:
        keys.append(key_file(name))

    keys_folder = shlex.quote(f"{_FOLDER}/{fleet.fleet.keys}")
    make_folders = f"mkdir -p {_FOLDER}"
    if keys:
        make_folders += f" && mkdir -p -m 700 {keys_folder}"
    commands = [["ssh", "--", ssh_target, make_folders]]

    commands.append(["scp", "--", fleet.path, f"{scp_target}:{_FOLDER}/fleet.toml"])
    if keys:
        paths = [str(Path(fleet.keys_folder) / file) for file in keys]
        # the remote folder is quoted, because older versions of scp pass it to a shell
        commands.append(["scp", "-p", "--", *paths, f"{scp_target}:{keys_folder}/"])

    # copy the module of the user's own law to the same place relative to the fleet file as here
    if fleet.own_law is not None and fleet.own_law.file is not None:
        law_folder = shlex.quote(f"{_FOLDER}/{fleet.law.folder}")
        commands.append(["ssh", "--", ssh_target, f"mkdir -p {law_folder}"])
        commands.append(["scp", "--", fleet.own_law.file, f"{scp_target}:{law_folder}/"])

    if arguments.wheel:
        commands.append(["scp", "--", *arguments.wheel, f"{scp_target}:{_FOLDER}/"])
        covey_wheel, *_ = arguments.wheel
        commands.append(_ssh(fleet, name, arguments, _installation(covey_wheel)))

    if arguments.user:
        sudo = ""
        options = " --user"
    else:
        sudo = "sudo "
        options = " --realtime"
    vehicle = shlex.quote(name)
    service = f"{sudo}{_COVEY} agent install --fleet fleet.toml --vehicle {vehicle}{options} --now"
    commands.append(_ssh(fleet, name, arguments, service))
    return commands


def _installation(wheel_path: str) -> str:
    """Return the shell line that installs the copied wheel.

    The first pip installs the wheel with its libraries. The second pip forces the installation of
    the wheel alone, because the first one does not replace an installed wheel of the same version.
    """
    wheel = shlex.quote(f"./{Path(wheel_path).name}")
    pip = ".venv/bin/pip install -q --find-links ."
    return f"python3 -m venv .venv && {pip} {wheel} && {pip} --force-reinstall --no-deps {wheel}"


def _status_commands(
    fleet: FleetConfig, name: str, arguments: argparse.Namespace
) -> list[list[str]]:
    """Return the command lines that print Covey's version, the fleet file's hash and the status."""
    version = ".venv/bin/pip show covey | grep Version"
    user = ""
    if arguments.user:
        user = " --user"
    agent = f"{_COVEY} agent status --fleet fleet.toml --vehicle {shlex.quote(name)}{user}"
    return [_ssh(fleet, name, arguments, f"{version}; sha256sum fleet.toml | cut -c1-12; {agent}")]
