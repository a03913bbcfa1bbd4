"""The agent as a systemd service: signs of life from live ticks only, and a unit that systemd
accepts.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import socket
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from onboard.agent.main import main
from onboard.process import service
from onboard.process.systemd import Notifier

MS = 1_000_000
PAPER = str(Path("configs/fleets/paper.toml").resolve())
OPTIONS = ["--fleet", PAPER, "--vehicle", "mav1", "--user"]


class Listener:
    """systemd's end of NOTIFY_SOCKET."""

    def __init__(self, folder: Path) -> None:
        self.path = str(folder / "notify")
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        self.socket.setblocking(False)

    def heard(self) -> list[str]:
        found = []
        while True:
            try:
                found.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                return found


@pytest.fixture
def listener(tmp_path: Path) -> Listener:
    return Listener(tmp_path)


def test_the_first_tick_says_ready_and_later_ones_that_it_lives_in_time_and_what_it_does(
    listener: Listener,
) -> None:
    life = Notifier({"NOTIFY_SOCKET": listener.path, "WATCHDOG_USEC": "2000000"})
    assert listener.heard() == []
    for tick in range(100):
        life.alive(tick * 20 * MS, "waiting")
    assert listener.heard() == ["READY=1\nWATCHDOG=1\nSTATUS=waiting"] + 2 * [
        "WATCHDOG=1\nSTATUS=waiting"
    ]
    life.alive(1999 * MS, "flying")
    assert listener.heard() == ["WATCHDOG=1\nSTATUS=flying"]


def test_without_a_socket_or_with_nobody_behind_it_nothing_happens(tmp_path: Path) -> None:
    Notifier({}).alive(0, "waiting")
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).alive(0, "waiting")


def test_a_full_queue_never_holds_up_the_tick_and_the_word_comes_later(listener: Listener) -> None:
    life = Notifier({"NOTIFY_SOCKET": listener.path})
    for tick in range(5000):
        life.alive(tick * 1000 * MS, "waiting")
    first = listener.heard()
    assert first[0].startswith("READY=1")
    life.alive(6_000_000 * MS, "waiting")
    assert listener.heard() == ["WATCHDOG=1\nSTATUS=waiting"]


def test_a_real_agent_gives_signs_of_life_while_its_loop_turns_and_none_while_it_is_stopped(
    listener: Listener, tmp_path: Path
) -> None:
    text = Path(PAPER).read_text(encoding="utf-8").replace('name = "paper"', 'name = "notify"')
    for old in ("7460", "7461", "7462", "14540"):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            text = text.replace(old, str(probe.getsockname()[1]))
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(text, encoding="utf-8")
    environ = {**os.environ, "NOTIFY_SOCKET": listener.path, "WATCHDOG_USEC": "600000"}
    command = [sys.executable, "-m", "onboard", "--fleet", str(fleet), "--vehicle", "mav0"]
    with subprocess.Popen(command, env=environ, stderr=subprocess.DEVNULL) as process:
        try:
            heard: list[str] = []
            end_s = time.monotonic() + 30.0
            while len(heard) < 4 and time.monotonic() < end_s and process.poll() is None:
                time.sleep(0.05)
                heard += listener.heard()
            assert heard[0] == "READY=1\nWATCHDOG=1\nSTATUS=waiting"
            assert "WATCHDOG=1" in heard[3]
            os.kill(process.pid, signal.SIGSTOP)
            time.sleep(0.2)
            listener.heard()
            time.sleep(1.0)
            assert listener.heard() == []
            os.kill(process.pid, signal.SIGCONT)
            time.sleep(1.0)
            assert listener.heard()
        finally:
            process.kill()
            process.wait(5)


def test_the_unit_is_shown_without_being_installed_and_has_watchdog_limits_and_this_python(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert main(["install", *OPTIONS, "--print", "--apply-params"]) == 0
    unit = capsys.readouterr().out
    for line in (
        "Type=notify",
        "WatchdogSec=2",
        "Restart=on-failure",
        "RestartPreventExitStatus=2",
        "MemoryMax=400M",
        "StandardOutput=journal",
        "WantedBy=default.target",
        f"ExecStart={sys.executable} -m onboard --fleet {PAPER} --vehicle mav1 --apply-params",
    ):
        assert line in unit.splitlines()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("user_id", "user"), [(0, "pilot"), (1000, "somebody")])
def test_the_agent_of_a_service_that_sudo_installs_runs_as_the_user_who_called_sudo(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, user_id: int, user: str
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: user_id)
    monkeypatch.setenv("LOGNAME", "root" if user_id == 0 else "somebody")
    monkeypatch.setenv("SUDO_USER", "pilot")
    assert main(["install", "--fleet", PAPER, "--vehicle", "mav1", "--print"]) == 0
    assert f"User={user}" in capsys.readouterr().out.splitlines()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not here")
@pytest.mark.parametrize("is_user", [True, False])
def test_systemd_accepts_the_unit_and_a_fleet_file_with_odd_letters_in_its_path(
    tmp_path: Path, is_user: bool
) -> None:
    folder = tmp_path / "50 % of $HOME"
    folder.mkdir()
    found = service.Service(str(folder / "fleet.toml"), "paper", "mav1", is_user)
    text = service.unit_text(found, ["--realtime"])
    assert service.verify(found, text) == ""
    assert "50 %% of $$HOME" in text
    assert service.verify(found, text.replace("Type=notify", "Type=nonsense")) != ""


def test_installing_writes_the_unit_again_and_again_but_never_over_somebody_elses(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs(tmp_path, monkeypatch, systemctl="exit 0")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    path = tmp_path / "systemd" / "user" / "covey-agent-paper-mav1.service"
    assert main(["install", *OPTIONS]) == 0
    assert "systemctl --user enable --now covey-agent-paper-mav1.service" in capsys.readouterr().out
    assert path.read_text(encoding="utf-8").startswith("# Written by covey agent install")
    assert main(["install", *OPTIONS, "--now"]) == 0
    assert "runs, now and after every boot" in capsys.readouterr().out
    assert (tmp_path / "called").read_text().splitlines()[
        -1
    ] == "--user restart covey-agent-paper-mav1.service"
    path.write_text("[Service]\nExecStart=/bin/true\n", encoding="utf-8")
    assert main(["install", *OPTIONS]) == 2
    assert "was not written by covey agent install" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "[Service]\nExecStart=/bin/true\n"


def test_two_vehicles_whose_services_have_the_same_name_are_not_installed_over_each_other(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs(tmp_path, monkeypatch, systemctl="exit 0")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    written = Path(PAPER).read_text(encoding="utf-8")
    for fleet, vehicle in (("lab-a", "b"), ("lab", "a-b")):
        text = written.replace('name = "paper"', f'name = "{fleet}"').replace("mav0", vehicle)
        (tmp_path / f"{fleet}.toml").write_text(text, encoding="utf-8")

    first = ["install", "--fleet", str(tmp_path / "lab-a.toml"), "--vehicle", "b", "--user"]
    other = ["install", "--fleet", str(tmp_path / "lab.toml"), "--vehicle", "a-b", "--user"]
    assert main([*first, "--now"]) == 0
    path = tmp_path / "systemd" / "user" / "covey-agent-lab-a-b.service"
    unit = path.read_text(encoding="utf-8")
    called = (tmp_path / "called").read_text()

    assert main([*other, "--now"]) == 2
    said = capsys.readouterr().err
    assert "is the service for vehicle b of fleet lab-a. The service for vehicle a-b" in said
    assert path.read_text(encoding="utf-8") == unit
    assert (tmp_path / "called").read_text() == called
    assert main(first) == 0


def test_a_folder_that_cannot_be_written_says_so(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "systemd").write_text("a file where a folder should be")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert main(["install", *OPTIONS]) == 2
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("told", "code", "words"),
    [
        (
            "LoadState=loaded\nActiveState=active\nStatusText=flying\nNRestarts=1\nMainPID=7",
            0,
            "process 7, restarted 1",
        ),
        (
            "LoadState=loaded\nActiveState=failed\nResult=watchdog\nNRestarts=5",
            1,
            "its control loop hung",
        ),
        (
            "LoadState=loaded\nActiveState=inactive\nResult=success\nNRestarts=0",
            1,
            "it was stopped",
        ),
        (
            "LoadState=loaded\nActiveState=failed\nResult=exit-code\nExecMainStatus=2",
            1,
            "exit-code, exit status 2",
        ),
        (
            "LoadState=loaded\nActiveState=activating\nSubState=start\nResult=success",
            1,
            "is starting: its first tick has not run yet",
        ),
        (
            "LoadState=loaded\nActiveState=activating\nSubState=auto-restart\nResult=exit-code"
            "\nExecMainStatus=1\nNRestarts=3",
            1,
            "exit-code, exit status 1",
        ),
        (
            "LoadState=loaded\nActiveState=deactivating\nSubState=stop-sigterm\nResult=success",
            1,
            "is stopping: in flight it lands first",
        ),
        ("LoadState=not-found", 2, "is not installed"),
    ],
)
def test_the_status_is_a_sentence(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    told: str,
    code: int,
    words: str,
) -> None:
    programs(tmp_path, monkeypatch, systemctl=f"printf '%s\\n' {shlex.quote(told)}")
    assert main(["status", *OPTIONS]) == code
    said = capsys.readouterr()
    assert words in said.out + said.err


def test_the_log_is_the_journals_and_without_systemd_the_words_are_clear(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs(tmp_path, monkeypatch, journalctl='echo "journal of $*"')
    assert main(["logs", *OPTIONS, "--lines", "7"]) == 0
    assert (
        "journal of --user --unit covey-agent-paper-mav1.service --no-pager --lines 7"
        in capfd.readouterr().out
    )
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    assert main(["logs", *OPTIONS]) == 2
    assert main(["status", *OPTIONS]) == 2
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert main(["install", *OPTIONS]) == 2
    said = capfd.readouterr().err
    assert said.count("This computer has no") == 3
    assert main(["status", "--fleet", PAPER, "--vehicle", "nobody"]) == 2


@pytest.mark.parametrize("runs", [True, False])
def test_an_empty_journal_is_said_in_words_and_never_a_success(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: bool
) -> None:
    programs(tmp_path, monkeypatch, journalctl='echo "No journal files were found." >&2')
    monkeypatch.setattr(service, "SYSTEMD_RUNS", tmp_path if runs else tmp_path / "nothing")
    assert main(["logs", *OPTIONS]) == 2
    said = capfd.readouterr().err
    assert "has nothing of covey-agent-paper-mav1.service" in said
    assert ("systemd does not run on this computer" in said) is not runs
    assert "No journal files" not in said


def programs(folder: Path, monkeypatch: pytest.MonkeyPatch, **scripts: str) -> None:
    """Programs of these names that note how they were called, first in PATH."""
    place = folder / "bin"
    place.mkdir()
    for name, script in scripts.items():
        program = place / name
        program.write_text(
            f'#!/bin/sh\necho "$*" >> {shlex.quote(str(folder / "called"))}\n{script}\n'
        )
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{place}:{os.environ['PATH']}")
