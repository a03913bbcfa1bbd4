"""The emulator's cost is measured, and what is measured is a whole vehicle at default rates."""

from __future__ import annotations

import json

import pytest

from tests.bench.sitl import main


@pytest.mark.long
def test_the_bench_counts_the_messages_of_both_links_and_their_cost(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--vehicles", "2", "--seconds", "1", "--json"]) == 0
    (cost,) = json.loads(capsys.readouterr().out)
    assert cost["vehicles"] == 2
    assert 0.0 < cost["physics_pct"] < cost["flying_pct"] < 50.0
    assert cost["datagrams_per_s"] == pytest.approx(405 + 57, rel=0.15)


@pytest.mark.parametrize("wrong", [["--vehicles", "none"], ["--vehicles", "0"], ["--seconds", "0"]])
def test_sizes_that_are_none_are_refused_in_words(
    wrong: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(wrong) == 2
    assert "give sizes as 3,10,50" in capsys.readouterr().err
