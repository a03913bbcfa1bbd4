"""Who still runs with an authority that was replaced."""

from __future__ import annotations

import datetime
import shutil
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.keys.authority import folder_of
from groundstation.keys.running import keep_former, running_authorities
from groundstation.keys.secured_fleet import renew_authority, secure_fleet
from groundstation.processes.free_ports import toml_text, with_free_ports
from onboard.bus.session import BusSession
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import NodeRole

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"


@contextmanager
def _agent(fleet: FleetConfig, name: str) -> Iterator[None]:
    with _node(fleet, name, fleet.vehicles[name].agent):
        yield


@contextmanager
def _node(fleet: FleetConfig, name: str, endpoint: str) -> Iterator[None]:
    session = BusSession(
        namespace=fleet.namespace,
        node=name,
        listen=[endpoint],
        credentials=credentials_of(fleet, name),
    )
    session.start()
    try:
        yield
    finally:
        session.stop()


def test_a_node_that_was_forgotten_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paper = load_fleet(PAPER)
    file = tmp_path / "fleet.toml"
    file.write_text(toml_text(with_free_ports(tomllib.loads(paper.text), paper)), encoding="utf-8")
    fleet = secure_fleet(str(file), datetime.datetime.now(datetime.UTC))
    with _agent(fleet, "mav0"):
        assert main(["keys", "init", str(file), "--force"]) == 0
        with _agent(fleet, "mav1"):
            capsys.readouterr()
            assert main(["keys", "list", str(file), "--running"]) == 1
    rows = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()[-3:])
    assert rows["mav0"].startswith("RUNS ON with a former authority")
    assert rows["mav1"] == "runs with the present authority"
    assert rows["mav2"].startswith("does not answer")
    assert {
        oct(path.stat().st_mode & 0o777) for path in (tmp_path / "keys-former").rglob("*.key")
    } == {"0o600"}


def test_a_mocap_relay_that_was_forgotten_is_found_although_all_vehicles_answer(
    tmp_path: Path,
) -> None:
    paper = load_fleet(PAPER)
    file = tmp_path / "fleet.toml"
    file.write_text(toml_text(with_free_ports(tomllib.loads(paper.text), paper)), encoding="utf-8")
    fleet = secure_fleet(str(file), datetime.datetime.now(datetime.UTC))
    with ExitStack() as nodes:
        nodes.enter_context(_node(fleet, NodeRole.MOCAP.value, fleet.pose_endpoints[0]))
        assert main(["keys", "init", str(file), "--force"]) == 0
        for name in fleet.enabled_names:
            nodes.enter_context(_agent(fleet, name))

        authorities = running_authorities(fleet)

    assert authorities == {**dict.fromkeys(fleet.enabled_names, "present"), "mocap": "former"}


def test_a_former_authority_is_not_overwritten_after_an_older_one_was_removed(
    tmp_path: Path,
) -> None:
    fleet = _secured(tmp_path)
    keep_former(fleet)
    keep_former(fleet)
    former = tmp_path / "keys-former"
    shutil.rmtree(former / "1")
    kept = (former / "2" / "viewer.pem").read_bytes()

    renew_authority(fleet, datetime.datetime.now(datetime.UTC))
    keep_former(fleet)

    assert (former / "2" / "viewer.pem").read_bytes() == kept
    assert (former / "4" / "viewer.pem").read_bytes() != kept


def test_a_fleet_of_which_nobody_answers_is_told_by_the_exit_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = _secured(tmp_path)
    monkeypatch.setattr("groundstation.commands.keys.running_authorities", lambda _: {})
    assert main(["keys", "list", fleet.path, "--running"]) == EXIT_NO_ANSWER

    (folder_of(fleet) / "mav0.pem").write_text("damaged", encoding="utf-8")
    assert main(["keys", "list", fleet.path, "--running"]) == EXIT_FAILED


def test_a_folder_of_another_name_beside_former_authorities_is_left_alone(tmp_path: Path) -> None:
    fleet = _secured(tmp_path)
    keep_former(fleet)
    (tmp_path / "keys-former" / "1 (copy)").mkdir()

    keep_former(fleet)

    assert (tmp_path / "keys-former" / "2" / "viewer.pem").exists()


def test_a_former_authority_that_was_kept_in_part_is_left_out(tmp_path: Path) -> None:
    fleet = _secured(tmp_path)
    keep_former(fleet)
    (tmp_path / "keys-former" / "1" / "viewer.key").unlink()

    assert running_authorities(fleet, wait_s=0.1) == {}


def _secured(folder: Path) -> FleetConfig:
    paper = load_fleet(PAPER)
    file = folder / "fleet.toml"
    file.write_text(toml_text(with_free_ports(tomllib.loads(paper.text), paper)), encoding="utf-8")
    return secure_fleet(str(file), datetime.datetime.now(datetime.UTC))
