"""All of covey check attack, on a fleet that flies: nothing gets in with keys, and without any each
try does.
"""

from __future__ import annotations

import json

import pytest

from groundstation.cli import main


@pytest.mark.long
@pytest.mark.timeout(900)
def test_nothing_gets_into_a_fleet_with_keys_and_everything_into_one_without(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status = main(["attack", "paper", "--long", "--json"])
    said = json.loads(capsys.readouterr().out)
    wrong = [one for one in said["tries"] if not one["is_right"]]
    assert not wrong
    assert len(said["tries"]) > 25
    assert sum(one["without_keys"] is True for one in said["tries"]) > 15
    assert said["separation_m"] > said["safety_distance_m"]
    assert said["loop_p99_ms"] < 25.0
    assert status == 0
