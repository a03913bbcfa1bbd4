"""``covey evidence``: what is wrong with the command line, before anything is flown."""

from __future__ import annotations

import shlex
from pathlib import Path

import msgspec
import pytest

from groundstation.cli import main
from groundstation.commands.evidence import _command
from groundstation.evidence.kept_flights import KeptFlights
from groundstation.evidence.provenance import provenance
from groundstation.mission_files.loading import load_mission
from onboard.config.fleet import load_fleet
from onboard.exit_status import EXIT_WRONG_INPUT
from sitl.lockstep.campaign.evidence_campaign import Campaign
from tests.groundstation.evidence.campaigns import evidence, flown


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--wind", "12"], "may fly in 8.1 m/s at most"),
        (["--wind", "3", "--quick", "--rounds", "2"], "Give --quick or --rounds"),
        (["--wind", "3", "--rounds", "0"], "--rounds is 0"),
        (["--wind", "3", "--jobs", "0"], "--jobs is 0"),
        (["--wind", "3", "--beside", "nowhere"], "evidence.json: there is no such file"),
        (["--wind", "3", "--beside", "folder"], "the folder of this evidence itself"),
        (["--wind", "3", "--only", "no such fault"], "--only is 'no such fault'"),
        ([], "--wind"),
    ],
)
def test_a_wrong_command_line_is_refused_in_a_sentence_and_writes_nothing(
    options, sentence, tmp_path, capsys, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status = main(["evidence", "paper", "paper", "--out", "folder", *options])
    assert status == EXIT_WRONG_INPUT
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "folder").exists()


def beside_of(folder: Path, *, wind: str = "3") -> None:
    """The folder of another machine's evidence for the example `paper`."""
    fleet = load_fleet("paper")
    mission = load_mission("paper", fleet)
    made_by = provenance(Path(fleet.path), Path(mission.path), mission)
    origin = {
        "fleet": made_by.config_hash,
        "files": ",".join(made_by.files.values()),
        "wind": wind,
        "Covey": "another",
    }
    folder.mkdir()
    flights = [flown(), flown("motor dead")]
    kept = KeptFlights(folder / "flights.jsonl", origin)
    kept.keep(flights[0])
    (folder / "evidence.json").write_bytes(msgspec.json.encode(evidence(fleet, flights)))


@pytest.mark.parametrize(
    ("wind", "sentence"),
    [("5", "another campaign (wind differs)"), ("3", "holds 1 of the 2 flights")],
)
def test_the_evidence_of_another_campaign_is_not_compared(
    wind: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    beside_of(tmp_path / "other", wind=wind)
    options = ["--wind", "3", "--out", str(tmp_path / "out"), "--beside", str(tmp_path / "other")]
    assert main(["evidence", "paper", "paper", *options]) == EXIT_WRONG_INPUT
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_command_in_the_evidence_is_one_that_a_shell_takes() -> None:
    campaign = Campaign(
        fleet_path="my fleets/a.toml",
        mission_path="it's mine.py",
        wind_m_s=3.0,
        rounds=1,
        only="motor dead",
    )
    assert shlex.split(_command(campaign, Path("ev dir"))) == [
        *("covey", "evidence", "my fleets/a.toml", "it's mine.py", "--wind", "3"),
        *("--rounds", "1", "--out", "ev dir", "--only", "motor dead"),
    ]
