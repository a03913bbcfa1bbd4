"""The default folder of a flight: its own, and none for a flight that is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.flights.flight_settings import flight_folder
from onboard.config.fleet import ConfigError


def test_flights_that_start_in_one_second_get_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with flight_folder(None) as first, flight_folder(None) as second, flight_folder(None) as third:
        assert len({first, second, third}) == 3
        assert all(folder.is_dir() for folder in (first, second, third))
        (second / "flight.mcap").touch()

    assert list((tmp_path / "flights").iterdir()) == [second]


def test_a_refused_flight_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["fly", "paper", "--lockstep", "--law", "orcaa"]) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_flight_that_cannot_get_a_folder_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flights").touch()
    with pytest.raises(ConfigError, match="cannot be written"), flight_folder(None):
        pass
