"""Deployment over ssh and scp, which are scripts here: they run what they are told on this
machine's own folders.
"""

from __future__ import annotations

import datetime
import os
import shlex
from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation.keys.secured_fleet import secure_fleet
from groundstation.starter.starter_files import Answers, starter
from onboard.agent.main import main
from onboard.config.fleet import load_fleet
from onboard.process.deploy import deployment, parser

SSH = """#!/bin/sh
while [ "$1" != -- ]; do shift; done
echo "ssh $2" >> "$COVEY_TEST/log"
[ "$2" = pi@10.0.0.12 ] && exit 255
cd "$COVEY_TEST" && PATH="$COVEY_TEST/bin:$PATH" exec sh -c "$3"
"""
SCP = """#!/bin/sh
shift; for last; do :; done
echo "scp $*" >> "$COVEY_TEST/log"
case "$last" in pi@10.0.0.12:*) exit 1;; esac
while [ $# -gt 1 ]; do cp "$1" "$COVEY_TEST/${last#*:}"; shift; done
"""
NOTHING = '#!/bin/sh\necho "$(basename $0) $*" >> "$COVEY_TEST/log"\n'


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A lab of two, of which the second does not answer."""
    (tmp_path / "lab.toml").write_text(
        starter(Answers(vehicles=2, companions="10.0.0.11")).fleet_text
    )
    (tmp_path / "covey-1-py3-none-any.whl").write_text("wheel")
    remote = tmp_path / "covey/.venv/bin"
    for folder, name, text in (
        (tmp_path / "bin", "ssh", SSH),
        (tmp_path / "bin", "scp", SCP),
        (tmp_path / "bin", "sudo", NOTHING),
        (tmp_path / "bin", "python3", NOTHING),
        (remote, "pip", NOTHING),
        (remote, "covey", NOTHING),
    ):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    monkeypatch.setenv("COVEY_TEST", str(tmp_path))
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_each_companion_gets_wheel_fleet_file_and_service_and_one_that_fails_is_named(
    lab: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = [
        "deploy",
        "--fleet",
        "lab.toml",
        "--login",
        "pi",
        "--wheel",
        "covey-1-py3-none-any.whl",
    ]
    assert main(words) == 50
    assert (lab / "covey/fleet.toml").read_text() == (lab / "lab.toml").read_text()
    assert (lab / "covey/covey-1-py3-none-any.whl").exists()
    log = (lab / "log").read_text()
    assert (
        "sudo .venv/bin/covey agent install --fleet fleet.toml --vehicle mav0 --realtime --now"
        in log
    )
    assert (
        "pip install -q --find-links . --force-reinstall --no-deps ./covey-1-py3-none-any.whl"
        in log
    )
    said = capfd.readouterr().err
    assert "mav1: this failed: ssh -- pi@10.0.0.12" in said
    assert "\nDeployed: mav0 (10.0.0.11).\nNot deployed: mav1 (10.0.0.12).\n" in said
    assert "once more with --vehicles mav1" in said


def test_an_ipv6_address_has_brackets_for_scp_and_none_for_ssh(lab: Path) -> None:
    text = (lab / "lab.toml").read_text()
    (lab / "lab.toml").write_text(text.replace("10.0.0.11", "[fd00::1]"))
    arguments = parser().parse_args(["--fleet", "lab.toml", "--login", "pi"])
    commands = deployment(load_fleet("lab.toml"), "mav0", arguments)

    assert [command[0] for command in commands] == ["ssh", "scp", "ssh"]
    assert "pi@fd00::1" in commands[0]
    assert commands[1][-1] == "pi@[fd00::1]:covey/fleet.toml"
    assert "pi@fd00::1" in commands[2]


def test_the_status_says_what_runs_where_and_the_hash_that_all_must_have(
    lab: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (lab / "covey/fleet.toml").write_text((lab / "lab.toml").read_text())
    assert main(["deploy", "--fleet", "lab.toml", "--status", "--vehicles", "mav0"]) == 0
    out = capfd.readouterr().out
    (here,) = [
        line.split()[5].rstrip(":")
        for line in out.splitlines()
        if line.startswith("The fleet file here")
    ]
    assert out.count(here) == 2
    assert "covey agent status --fleet fleet.toml --vehicle mav0" in (lab / "log").read_text()


def test_print_runs_nothing_and_a_missing_wheel_is_a_sentence(
    lab: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["deploy", "--fleet", "lab.toml", "--print"]) == 0
    assert "scp -- lab.toml 10.0.0.12:covey/fleet.toml" in capfd.readouterr().out
    assert not (lab / "log").exists()
    assert main(["deploy", "--fleet", "lab.toml", "--wheel", "none.whl"]) == 2
    assert "make wheel" in capfd.readouterr().err


def test_a_fleet_file_runs_no_command_on_a_companion(
    lab: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    written = (lab / "lab.toml").read_text().replace("tcp/", "quic/")
    for folder in ("keys; touch X #", "$(touch X)", "../../../etc"):
        (lab / "lab.toml").write_text(written.replace("[fleet]", f'[fleet]\nkeys = "{folder}"'))
        assert main(["deploy", "--fleet", "lab.toml"]) == 2
        assert "'fleet.keys' is " in capfd.readouterr().err
    assert not (lab / "log").exists()


def test_a_folder_of_keys_reaches_the_remote_shell_in_quotes(lab: Path) -> None:
    fleet = secure_fleet("lab.toml", datetime.datetime.now(datetime.UTC))
    hostile = replace(fleet, fleet=replace(fleet.fleet, keys="keys; touch X #"))  # past the loader
    make_folder, _, copy_keys, *_ = deployment(
        hostile, "mav0", parser().parse_args(["--fleet", "lab.toml"])
    )
    assert shlex.split(make_folder[-1])[-1] == "covey/keys; touch X #"
    assert shlex.split(copy_keys[-1])[-1].endswith(":covey/keys; touch X #/")


def test_keys_of_this_computer_only_are_not_deployed(
    lab: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    secure_fleet("lab.toml", datetime.datetime.now(datetime.UTC))
    text = (lab / "lab.toml").read_text()
    (lab / "lab.toml").write_text(text.replace("[fleet]", f'[fleet]\nkeys = "{lab}/keys"'))
    assert main(["deploy", "--fleet", "lab.toml"]) == 2
    assert "a folder of this computer" in capfd.readouterr().err


def test_a_law_of_this_computer_only_is_not_deployed(
    lab: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = (lab / "lab.toml").read_text()
    (lab / "lab.toml").write_text(text.replace("[law]\n", f'[law]\nfolder = "{lab}"\n'))
    assert main(["deploy", "--fleet", "lab.toml"]) == 2
    said = capfd.readouterr().err
    assert "'law.folder' is" in said
    assert "a folder of this computer" in said
    assert not (lab / "log").exists()


@pytest.mark.parametrize("folder", [".", "laws"])
def test_the_module_of_an_own_law_is_copied_to_where_the_companion_looks(
    lab: Path, folder: str
) -> None:
    (lab / folder).mkdir(exist_ok=True)
    module = lab / folder / "mine.py"
    module.write_text("def law(memory, inputs):\n    return memory, inputs.baseline\n")
    named = f'[law]\nname = "mine:law"\nfolder = "{folder}"\n'
    text = (lab / "lab.toml").read_text()
    assert "[law]\n" in text
    lines = [line for line in text.split("\n") if not line.startswith('name = "covey"')]
    (lab / "lab.toml").write_text("\n".join(lines).replace("[law]\n", named))

    assert main(["deploy", "--fleet", "lab.toml", "--login", "pi", "--vehicles", "mav0"]) == 0
    assert (lab / "covey" / folder / "mine.py").read_text() == module.read_text()
    deployed = load_fleet(lab / "covey/fleet.toml")
    assert deployed.config_hash == load_fleet(lab / "lab.toml").config_hash
    assert deployed.own_law is not None
    assert deployed.own_law.file == str(lab / "covey" / folder / "mine.py")
