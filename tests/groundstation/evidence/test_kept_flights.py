"""A campaign that was stopped goes on, and no line of another one is counted."""

from __future__ import annotations

import resource

import pytest

from groundstation.evidence.kept_flights import KeptFlights
from onboard.config.fleet import ConfigError
from tests.groundstation.evidence.campaigns import flown

ORIGIN = {"fleet": "a", "wind": "4"}


def test_flights_are_read_again_and_a_line_that_was_cut_is_dropped(tmp_path) -> None:
    path = tmp_path / "flights.jsonl"
    kept = KeptFlights(path, ORIGIN)
    kept.keep(flown())
    kept.keep(flown(number=1))
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])

    again = KeptFlights(path, ORIGIN)
    assert list(again.flown.values()) == [flown()]
    again.keep(flown(number=1))
    assert path.read_bytes() == whole


def test_a_disk_that_is_full_when_a_campaign_goes_on_costs_no_flight(tmp_path) -> None:
    path = tmp_path / "flights.jsonl"
    kept = KeptFlights(path, ORIGIN)
    for number in range(3):
        kept.keep(flown(number=number))
    whole = path.read_bytes()

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) // 2, before[1]))
    try:
        with pytest.raises(ConfigError, match="cannot be written"):
            KeptFlights(path, ORIGIN)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)

    assert path.read_bytes() == whole
    assert list(tmp_path.iterdir()) == [path]
    assert len(KeptFlights(path, ORIGIN).flown) == 3


def test_flights_of_another_campaign_are_refused_with_what_differs(tmp_path) -> None:
    path = tmp_path / "flights.jsonl"
    KeptFlights(path, ORIGIN)
    with pytest.raises(ConfigError, match=r"another campaign \(wind differs\)"):
        KeptFlights(path, {**ORIGIN, "wind": "5"})


@pytest.mark.parametrize("text", ["", "no json\n", "[1, 2]\n"])
def test_a_file_of_somebody_else_is_refused(tmp_path, text) -> None:
    path = tmp_path / "flights.jsonl"
    path.write_text(text)
    with pytest.raises(ConfigError, match="does not begin with a line of covey evidence"):
        KeptFlights(path, ORIGIN)
