"""What `covey check` says about corrections: the source, its files, and nothing without."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from groundstation.network.corrections_findings import corrections_findings
from onboard.config.corrections import CorrectionsConfig
from onboard.config.fleet import FleetConfig, load_fleet

NTRIP = CorrectionsConfig(
    source="ntrip", address="caster:2101", mountpoint="NEAR", user="ada", password_file="pass.txt"
)


def fleet_with(tmp_path: Path, corrections: CorrectionsConfig | None) -> FleetConfig:
    fleet = load_fleet("px4-sitl")
    return msgspec.structs.replace(
        fleet, path=str(tmp_path / "fleet.toml"), corrections=corrections
    )


def test_a_fleet_without_corrections_hears_nothing_about_them(tmp_path: Path) -> None:
    assert corrections_findings(fleet_with(tmp_path, None)) == []


def test_the_source_is_named_with_the_command_that_looks_at_it(tmp_path: Path) -> None:
    (tmp_path / "pass.txt").write_text("secret\n")
    (tmp_path / "pass.txt").chmod(0o600)
    [note] = corrections_findings(fleet_with(tmp_path, NTRIP))
    assert note.status == "note"
    assert "the caster caster:2101, mountpoint NEAR" in note.sentence
    assert "covey corrections --fleet" in note.sentence
    assert "secret" not in note.sentence


@pytest.mark.parametrize(
    ("corrections", "words"),
    [
        (NTRIP, "'corrections.password_file' names pass.txt, which is not there"),
        (
            CorrectionsConfig(source="file", address="base.rtcm"),
            "'corrections.address' names base.rtcm, which is not there",
        ),
    ],
)
def test_a_file_that_is_missing_is_a_warning(
    tmp_path: Path, corrections: CorrectionsConfig, words: str
) -> None:
    warning, _ = corrections_findings(fleet_with(tmp_path, corrections))
    assert warning.status == "warning"
    assert words in warning.sentence


@pytest.mark.parametrize(
    ("text", "mode", "words"),
    [
        ("secret\n", 0o644, "can be read by other users of this computer (mode 644)"),
        ("\n", 0o600, "has no password in its first line"),
    ],
)
def test_a_password_file_that_would_be_refused_is_a_warning(
    tmp_path: Path, text: str, mode: int, words: str
) -> None:
    (tmp_path / "pass.txt").write_text(text)
    (tmp_path / "pass.txt").chmod(mode)
    warning, _ = corrections_findings(fleet_with(tmp_path, NTRIP))
    assert warning.status == "warning"
    assert words in warning.sentence
    assert "secret" not in warning.sentence


def test_corrections_that_nobody_takes_are_a_warning(tmp_path: Path) -> None:
    indoors = msgspec.structs.replace(load_fleet("paper"), corrections=NTRIP)
    [warning] = corrections_findings(indoors)
    assert warning.sentence.startswith("No vehicle takes the corrections.")
