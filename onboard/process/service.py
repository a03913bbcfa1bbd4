"""``covey agent install|status|logs``: the agent as a systemd service on a drone's computer."""

from __future__ import annotations

import argparse
import getpass
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_OK, EXIT_WRONG_INPUT

VERBS = ("install", "status", "logs")
_MARK = "# Written by covey agent install"  # first line of the unit files of this module
_SYSTEM_FOLDER = Path("/etc/systemd/system")
SYSTEMD_RUNS = Path("/run/systemd/system")  # exists if systemd booted this computer: sd_booted(3)

# properties that the status needs: systemctl(1), show
_SHOWN_PROPERTIES = (
    "LoadState",
    "ActiveState",
    "SubState",
    "StatusText",
    "NRestarts",
    "Result",
    "ExecMainStatus",
    "MainPID",
)
# systemd's property ``SubState`` -> words, for a service that is neither running nor stopped
_IN_TRANSITION = {
    "start": "is starting: its first tick has not run yet",
    "stop-sigterm": "is stopping: in flight it lands first",
}
# systemd's property ``Result`` -> why a service is not running, in words
_ENDED_BECAUSE = {
    "watchdog": "its control loop hung",
    "oom-kill": "it took too much memory",
    "success": "it was stopped",
}


@dataclass(frozen=True, slots=True)
class Service:
    """One vehicle's agent as a service of systemd."""

    fleet_path: str
    fleet_name: str
    vehicle: str
    is_user: bool  # managed by the user's systemd instead of the system's

    @property
    def unit(self) -> str:
        """Name of the unit."""
        return f"covey-agent-{self.fleet_name}-{self.vehicle}.service"

    @property
    def path(self) -> Path:
        """Path of the unit file."""
        if not self.is_user:
            return _SYSTEM_FOLDER / self.unit

        folder = Path.home() / ".config"
        configured = os.environ.get("XDG_CONFIG_HOME")
        if configured:
            folder = Path(configured)
        return folder / "systemd" / "user" / self.unit

    @property
    def manager_options(self) -> list[str]:
        """Options of systemctl and journalctl that select the user's or the system's systemd."""
        if self.is_user:
            return ["--user"]
        return []

    def systemctl(self, *words: str) -> list[str]:
        """Return a command line of systemctl for this service's systemd."""
        return ["systemctl", *self.manager_options, *words]


def unit_text(service: Service, arguments: Sequence[str] = ()) -> str:
    """Return the text of the unit file, with ``arguments`` for the agent."""
    command = [
        sys.executable,
        "-m",
        "onboard",
        "--fleet",
        service.fleet_path,
        "--vehicle",
        service.vehicle,
        *arguments,
    ]

    # lines that only a system unit has, and the target that starts the service
    system_lines = ""
    target = "default"
    if not service.is_user:
        system_lines = _template("agent_system.conf").substitute(user=_user())
        target = "multi-user"

    return _template("agent.service").substitute(
        vehicle=service.vehicle,
        fleet=service.fleet_name,
        command=" ".join(_quoted(word) for word in command),
        folder=_escaped(str(Path(service.fleet_path).parent)),
        name=service.unit.removesuffix(".service"),
        system=system_lines,
        target=target,
    )


def _user() -> str:
    """Return the user that the agent runs as: the caller of this command, even with sudo."""
    caller = os.environ.get("SUDO_USER")
    if os.geteuid() == 0 and caller:
        return caller
    return getpass.getuser()


def _template(name: str) -> Template:
    """Return a template from a file in this package."""
    return Template(resources.files(__package__).joinpath(name).read_text(encoding="utf-8"))


def _escaped(text: str) -> str:
    """Return a text for a unit file, where % starts a specifier."""
    return text.replace("%", "%%")


def _quoted(word: str) -> str:
    """Return a word for the line ExecStart, where systemd expands % and $ and splits at spaces."""
    safe = _escaped(word).replace("$", "$$")
    if shlex.quote(word) == word:
        return safe
    inside = safe.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{inside}"'


# -- install ---------------------------------------------------------------------------------------


def install(service: Service, arguments: Sequence[str], *, prints: bool, starts: bool) -> int:
    """Write the unit file after systemd has verified it, and return the exit status.

    On a computer without systemd it is written without verification.

    Args:
        service: service to install.
        arguments: options for the agent.
        prints: whether to print the unit file instead.
        starts: whether the service starts now and at every boot.
    """
    text = unit_text(service, arguments)
    if prints:
        print(text, end="")
        return EXIT_OK

    problem = _write_unit(service, text)
    if problem:
        return _fail(problem)
    print(f"{service.path} is written.")

    start = shlex.join(service.systemctl("enable", "--now", service.unit))
    failure = _reload_systemd(service, starts=starts)
    if failure:
        return _fail(f"{failure} The unit stays; when systemd runs, type: {start}")

    if starts:
        print(f"{service.unit} runs, now and after every boot.")
    else:
        print(f"Start it, now and at every boot, with: {start}")
    if service.is_user:
        print(
            "Without a login it starts at boot only after: "
            f"sudo loginctl enable-linger {getpass.getuser()}"
        )
    return EXIT_OK


def _write_unit(service: Service, text: str) -> str:
    """Write the unit file. Return why this failed, or an empty text."""
    problems = verify(service, text)
    if problems:
        return (
            f"systemd does not accept the unit: {problems} Nothing was written; please report this."
        )

    path = service.path
    try:
        problem = _replacement_problem(path, text)
        if problem:
            return problem
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason: str | None = str(error)
        if isinstance(error, OSError):
            reason = error.strerror
        return (
            f"{path} cannot be written ({reason}): use sudo, or --user for a service of your own."
        )
    return ""


def _replacement_problem(path: Path, text: str) -> str:
    """Return why a text must not replace a unit file; empty if it may, or if there is no file."""
    if not path.is_symlink() and not path.exists():
        return ""

    written = ""
    if not path.is_symlink():
        written = path.read_text(encoding="utf-8")
    if not written.startswith(_MARK):
        return f"{path} was not written by covey agent install: move it away, or rename the fleet."

    if _owner(written) != _owner(text):
        return (
            f"{path} is the service {_owner(written)}. The service {_owner(text)} would have the "
            "same name, so nothing was written. Rename the fleet or the vehicle."
        )
    return ""


def _owner(text: str) -> str:
    """Return the vehicle and the fleet of a unit file of this module, from its first line."""
    first_line, *_ = text.splitlines()
    owner, _, _ = first_line.removeprefix(_MARK).partition(";")
    return owner.strip()


def _reload_systemd(service: Service, *, starts: bool) -> str:
    """Let systemd read its units again, and start this service if ``starts``.

    Returns:
        the first failure in a sentence; empty if there is none.
    """
    commands = [service.systemctl("daemon-reload")]
    if starts:
        commands.append(service.systemctl("enable", service.unit))
        commands.append(service.systemctl("restart", service.unit))

    for command in commands:
        failure = _run(command)
        if failure:
            return failure
    return ""


# -- status ----------------------------------------------------------------------------------------


def status(service: Service) -> int:
    """Print the state of the service in a sentence, and return the exit status."""
    if shutil.which("systemctl") is None:
        return _fail(
            "This computer has no systemd (systemctl is not found): "
            "start the agent with covey agent."
        )

    properties = [f"--property={name}" for name in _SHOWN_PROPERTIES]
    command = [*service.systemctl("show", service.unit), *properties]
    shown = subprocess.run(command, capture_output=True, text=True, check=False)
    if shown.returncode != 0:
        return _fail(f"systemd does not answer ({_reason(shown)}).")

    values: dict[str, str] = {}  # property -> value
    for line in shown.stdout.splitlines():
        name, _, value = line.partition("=")
        values[name] = value
    if values.get("LoadState") == "not-found":
        return _fail(
            f"{service.unit} is not installed: type covey agent install with the same options."
        )

    restart_words = ""
    restarts = values.get("NRestarts", "")
    if restarts not in ("", "0"):
        restart_words = f", restarted {restarts} times"

    if values.get("ActiveState") == "active":
        text = values.get("StatusText")
        if not text:
            text = "no status yet"
        print(f"{service.unit} runs (process {values.get('MainPID')}{restart_words}): {text}.")
        return EXIT_OK

    in_transition = _IN_TRANSITION.get(values.get("SubState", ""))
    if in_transition is not None:
        print(f"{service.unit} {in_transition}.")
        return EXIT_FAILED

    result = values.get("Result", "")
    unknown = f"{result}, exit status {values.get('ExecMainStatus')}"
    reason = _ENDED_BECAUSE.get(result, unknown)
    print(
        f"{service.unit} does not run ({values.get('ActiveState')}{restart_words}): {reason}. "
        "See covey agent logs."
    )
    return EXIT_FAILED


# -- logs ------------------------------------------------------------------------------------------


def logs(service: Service, *, follows: bool, lines: int) -> int:
    """Print the service's journal; return the exit status."""
    if shutil.which("journalctl") is None:
        return _fail(
            "This computer has no journal (journalctl is not found): see the output of covey agent."
        )

    command = ["journalctl", *service.manager_options]
    command += ["--unit", service.unit, "--no-pager", "--lines"]

    probe = subprocess.run(
        [*command, "1", "--quiet", "--output=cat"], capture_output=True, text=True, check=False
    )
    is_empty = probe.returncode == 0 and not probe.stdout.strip()
    if is_empty and not SYSTEMD_RUNS.is_dir():
        return _fail(
            "systemd does not run on this computer, and the journal has nothing of "
            f"{service.unit}: see where the output of covey agent goes."
        )
    if is_empty and not follows:
        return _fail(
            f"The journal has nothing of {service.unit}: see covey agent status, or use sudo if "
            "the journal is not yours to read."
        )

    command.append(str(lines))
    if follows:
        command.append("--follow")
    return subprocess.run(command, check=False).returncode


# -- systemd's own tools ---------------------------------------------------------------------------


def verify(service: Service, text: str) -> str:
    """Return systemd's objections to the unit; empty if there are none, or without systemd."""
    if shutil.which("systemd-analyze") is None:
        return ""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / service.unit
        path.write_text(text, encoding="utf-8")

        # A user unit is also verified as a system unit, because the syntax is the same and the
        # user's systemd may not be running.
        command = ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", str(path)]
        verified = subprocess.run(command, capture_output=True, text=True, check=False)

    # only lines with this unit are kept; other lines are about other units or about systemd itself
    own = [line for line in verified.stderr.splitlines() if service.unit in line]
    return " ".join(own).replace(f"{folder}/", "")


def _run(command: Sequence[str]) -> str:
    """Run a command line, and return its failure in a sentence; empty if it succeeded."""
    program, *_ = command
    if shutil.which(program) is None:
        return f"This computer has no systemd ({program} is not found)."
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode == 0:
        return ""
    return f"{shlex.join(command)} failed: {_reason(ended)}."


def _reason(failed: subprocess.CompletedProcess[str]) -> str:
    """Return what a failed program wrote to stderr, in one line, or its exit status if it wrote
    nothing.
    """
    words = " ".join(failed.stderr.split()).rstrip(".")
    if words:
        return words
    return str(failed.returncode)


def _fail(sentence: str) -> int:
    """Print a sentence about wrong input or a missing systemd, and return the exit status."""
    print(f"agent: {sentence}", file=sys.stderr)
    return EXIT_WRONG_INPUT


# -- the command line ------------------------------------------------------------------------------


def parser() -> argparse.ArgumentParser:
    """Return the command line of the service."""
    parser = argparse.ArgumentParser(
        prog="covey agent",
        description="The agent as a systemd service: docs/deployment.md.",
        epilog="Exit status: 0 done, or it runs; 1 it does not run; "
        "2 wrong input, or systemd is not there.",
    )
    commands = parser.add_subparsers(dest="verb", metavar="COMMAND", required=True)

    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--fleet", required=True, metavar="FILE", help="fleet file")
    common.add_argument(
        "--vehicle", required=True, metavar="NAME", help="vehicle of the fleet file"
    )
    common.add_argument(
        "--user", action="store_true", help="a service of your own, which needs no root"
    )

    install = commands.add_parser("install", parents=[common], help="write the unit")
    install.add_argument("--print", action="store_true", help="only show the unit")
    install.add_argument("--now", action="store_true", help="start it too, now and at every boot")
    install.add_argument(
        "--apply-params", action="store_true", help="the agent sets PX4's required parameters"
    )
    install.add_argument(
        "--realtime", action="store_true", help="the agent's control loop takes precedence"
    )

    commands.add_parser("status", parents=[common], help="whether it runs")

    logs = commands.add_parser("logs", parents=[common], help="what it wrote")
    logs.add_argument("--follow", action="store_true", help="go on as it writes")
    logs.add_argument(
        "--lines", type=int, default=100, metavar="N", help="so many of the newest (default 100)"
    )
    return parser


def main(argv: Sequence[str]) -> int:
    """Run one of the commands, and return the exit status."""
    options = parser().parse_args(argv)
    try:
        fleet = load_fleet(options.fleet)
        names = fleet.select(options.vehicle)
    except ConfigError as error:
        return _fail(str(error))
    if len(names) != 1:
        return _fail(f"--vehicle {options.vehicle} must name one vehicle.")

    (name,) = names
    service = Service(
        fleet_path=str(Path(options.fleet).resolve()),
        fleet_name=fleet.fleet.name,
        vehicle=name,
        is_user=options.user,
    )
    match options.verb:
        case "install":
            flags = {"--apply-params": options.apply_params, "--realtime": options.realtime}
            arguments = [flag for flag, is_set in flags.items() if is_set]
            return install(service, arguments, prints=options.print, starts=options.now)
        case "status":
            return status(service)
        case _:
            return logs(service, follows=options.follow, lines=options.lines)
