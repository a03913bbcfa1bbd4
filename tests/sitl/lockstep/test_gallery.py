"""Every mission of the gallery is flown as it stands and passes what it expects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from groundstation.shows.gallery import ACCIDENTS, GALLERY, gallery_mission, sentence_of
from sitl.lockstep.flight import Lockstep

ROOT = Path(__file__).parents[3]
FLOWN_ELSEWHERE = ("paper", "above")  # in test_flight, and in test_above_each_other
MISSIONS = [name for name in GALLERY if name not in FLOWN_ELSEWHERE]


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", MISSIONS)
def test_a_mission_of_the_gallery_passes(
    name: str, lockstep: Callable[..., Lockstep], tmp_path: Path
) -> None:
    mission = gallery_mission(name, tmp_path)
    assert mission.expect.min_separation_m is not None
    verdict = lockstep(mission.fleet).fly(mission)
    assert verdict.passed, verdict.sentences


def test_each_has_a_sentence_and_a_picture() -> None:
    for name in (*GALLERY, *ACCIDENTS):
        assert sentence_of(name).count(": ") >= 1
        assert (ROOT / f"docs/figures/gallery-{name}.png").exists()
